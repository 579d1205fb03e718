"""Assemble the page: a model, what is known of it, and the texts of its shaders, in one HTML file."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from skinbake.files import Bytes
from skinbake.geometry.skinned import FloatArray, IntArray
from skinbake.version import __version__
from skinbake.view.sources import filled_page
from skinbake.view.texts import packed_texts


class OtherGradients(NamedTuple):
    """α and β (V, K − 1) of a kind that the file does not hold for a primitive: ``surface`` or ``fitted``.

    joints (V, K) and weights (V, K) are the influences that they belong to, None if they are the file's own.
    frame is that of α and β.
    """

    kind: str
    mesh: int
    primitive: int
    frame: str
    alpha: FloatArray
    beta: FloatArray
    joints: IntArray | None = None
    weights: FloatArray | None = None


def page(
    name: str, glb: Sequence[Bytes], others: Sequence[OtherGradients], findings: Mapping[str, Any]
) -> bytes:
    """Return the page of a model as UTF-8. Names of the model are text in it, whatever they hold.

    ``glb`` needs no other file. others are the α and β of the other kind. findings are the members of the
    page's object ``given``: JSON.
    """
    given = {"name": name, "other": {"primitives": list(map(_other, others))}, **findings}
    filled = filled_page(
        {
            "version": html.escape(__version__),
            "title": html.escape(name),
            "model": base64.b64encode(b"".join(glb)).decode(),
            "texts": as_data(packed_texts()),
            "given": as_data(given),
        }
    )
    return filled.encode("utf-8", "backslashreplace")


def as_data(content: Any) -> str:
    """Return JSON that may stand in a script element: nothing in it can end the element, or open another."""
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _other(other: OtherGradients) -> dict[str, Any]:
    """Return α and β as JSON, with arrays as the bytes of floats in base64."""
    arrays = {name: value for name, value in other._asdict().items() if isinstance(value, np.ndarray)}
    floats = (np.ascontiguousarray(values, dtype="<f4").tobytes() for values in arrays.values())
    coded = (base64.b64encode(data).decode() for data in floats)
    return other._asdict() | dict(zip(arrays, coded, strict=True))
