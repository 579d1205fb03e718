"""The attributes that hold α and β: their own, or texture coordinates with two numbers each."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import Encoding, Layout
from skinbake.format.metadata import slot_names
from skinbake.gltf.json_access import JsonObject

TEXCOORD = re.compile(r"TEXCOORD_(\d+)")

CUSTOM_NAMES = (("_CUSTOM0", "_CUSTOM1"), ("_CUSTOM2", "_CUSTOM3"))
"""α and β by influence set, as CUSTOM0 … CUSTOM3 of Godot after 4.6 (godotengine/godot#120040)."""


class GradientFormat(NamedTuple):
    """The storage of α and β in one file; scale is the encoding's, in 1 / length unit of POSITION."""

    encoding: Encoding = Encoding.FLOAT32
    layout: Layout = Layout.ATTRIBUTES
    scale: float = 0.0

    @property
    def noted(self) -> JsonObject:
        """Return the members of the metadata for this storage; the default storage has none."""
        note: JsonObject = {} if self.layout is Layout.ATTRIBUTES else {"layout": str(self.layout)}
        return note | (
            {"encoding": str(self.encoding), "scale": self.scale} if self.encoding.is_scaled else {}
        )


def noted_format(note: JsonObject) -> GradientFormat:
    """Return the storage in the metadata; ValueError if a name is unknown."""
    return GradientFormat(
        Encoding(note.get("encoding", Encoding.FLOAT32)),
        Layout(note.get("layout", Layout.ATTRIBUTES)),
        note.get("scale", 0.0),
    )


def free_texcoords(attributes: Iterable[str], count: int) -> list[str]:
    """Return the names of ``count`` texture coordinate sets after the existing ones.

    glTF numbers them without a gap, so the new ones begin after the last.
    """
    taken = (int(found[1]) for name in attributes if (found := TEXCOORD.fullmatch(name)))
    first = max(taken, default=-1) + 1
    return [f"TEXCOORD_{number}" for number in range(first, first + count)]


def added_slot_names(note: JsonObject) -> list[str]:
    """Return the attributes that hold α or β by the metadata, without names that no bake gives them."""
    if note.get("layout") == Layout.TEXCOORD:
        return [name for name in slot_names(note) if TEXCOORD.fullmatch(name)]
    return [name for name in slot_names(note) if name.startswith("_")]


def of_alpha_and_beta(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the texture coordinate sets of α and of β, out of K − 1; the middle one holds both."""
    half = len(names) // 2
    return list(names[: half + 1]), list(names[half:])


def paired(alpha: npt.NDArray[Any], beta: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Return α and β, each (V, K − 1), side by side as K − 1 arrays (V, 2)."""
    numbers = np.concatenate([alpha, beta], axis=1)
    return [numbers[:, start : start + 2] for start in range(0, numbers.shape[1], 2)]


def unpaired(pairs: Sequence[npt.NDArray[Any]]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return α and β, each (V, K − 1), from the arrays of ``paired``."""
    numbers = np.concatenate(pairs, axis=1)
    return numbers[:, : len(pairs)], numbers[:, len(pairs) :]
