"""The page of encodings counts the models that it speaks of."""

from __future__ import annotations

from benchmarks.encoding_table import Measured, largest
from skinbake.choices import Encoding


def row(turned: tuple[float, float] | None) -> dict[Encoding, Measured]:
    return {encoding: Measured(8, turned, None) for encoding in Encoding}


def test_a_model_without_a_figure_is_named_and_not_counted() -> None:
    lines = list(largest({"a.glb": row((0.1, 0.2)), "flat.glb": row(None), "b.glb": row((0.3, 0.4))}))
    assert lines[0].startswith("Of the corpus, 3 models can be baked. `bake` measures no angle on flat.glb: ")
    assert lines[2] == "The largest angles by which normals turn, over 2 models:"
    assert lines[4:] == [f"- {encoding}: 0.3000° / 0.4000° (b.glb)" for encoding in ("snorm16", "packed8")]


def test_models_that_all_have_figures_are_counted_once() -> None:
    lines = list(largest({"a.glb": row((0.1, 0.2))}))
    assert lines[0] == "The largest angles by which normals turn, over 1 model:"
