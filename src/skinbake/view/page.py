"""Assemble the page: a model, what is known of it, and the texts of its shaders, in one HTML file."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skinbake.files import Bytes
from skinbake.geometry.skinned import FloatArray, IntArray
from skinbake.version import __version__
from skinbake.view.sources import filled_page
from skinbake.view.texts import packed_texts


@dataclass(frozen=True, slots=True, eq=False)
class OtherGradients:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A model to show: its name, a GLB that needs no other file, and the findings about it.

    others are the α and β of the other kind. findings are the members of the page's object ``given``: JSON.
    """

    name: str
    glb: Sequence[Bytes]
    others: Sequence[OtherGradients] = ()
    findings: dict[str, Any] = field(default_factory=dict)


def page(shown: Shown) -> bytes:
    """Return the page as UTF-8. Names of the model are text in it, whatever they hold."""
    given = {"name": shown.name, "other": _others(shown.others), **shown.findings}
    filled = filled_page(
        {
            "version": html.escape(__version__),
            "title": html.escape(shown.name),
            "model": base64.b64encode(b"".join(shown.glb)).decode(),
            "texts": as_data(packed_texts()),
            "given": as_data(given),
        }
    )
    return filled.encode("utf-8", "backslashreplace")


def as_data(content: Any) -> str:
    """Return JSON that may stand in a script element: nothing in it can end the element, or open another."""
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _others(others: Sequence[OtherGradients]) -> dict[str, Any]:
    return {
        "primitives": [
            {
                "kind": other.kind,
                "mesh": other.mesh,
                "primitive": other.primitive,
                "frame": other.frame,
                "alpha": _numbers(other.alpha),
                "beta": _numbers(other.beta),
                "joints": None if other.joints is None else _numbers(other.joints),
                "weights": None if other.weights is None else _numbers(other.weights),
            }
            for other in others
        ]
    }


def _numbers(values: FloatArray | IntArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()
