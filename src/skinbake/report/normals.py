"""The normals of a file in one pose: as arrays, and as JSON lines that any language reads."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

from skinbake.choices import Method
from skinbake.errors import printable
from skinbake.geometry.skinned import Float64Array

SCHEMA = "skinbake.normals/1"


@dataclass(frozen=True, slots=True, eq=False)
class PosedNormals:
    """The normals of one primitive in one pose, as one skin draws it.

    Vectors are in the space of the scene, in which glTF moves skinned meshes, and have unit length. One that
    does not exist is NaN.

    Attributes
    ----------
    mesh, primitive, skin : int
        The numbers of the primitive and of the skin in the file.
    node : int or None
        The node that draws it, if the mesh has morph targets.
    clip : str or None
        The name of the clip, None for random poses.
    time : float
        The time in the clip, or in the random poses, in seconds.
    method : str
        ``lbs`` or ``dqs``.
    positions : ndarray (V, 3) float64
        The skinned positions.
    normals : dict of ndarray (V, 3) float64
        By lighting: ``standard`` and ``accurate``, for ``dqs`` ``exact`` too. In a file with correctives
        ``corrected`` for ``lbs``, and ``accurate`` is what α and β would give.
    truths : dict of ndarray (V, 3) float64
        The true normals ``triangles`` and ``tangents`` (docs/lighting.md).
    joint_matrices : ndarray (J, 4, 4) float64
        The joint matrices of the pose: global transform × inverse bind matrix.
    morph_weights : ndarray (N,) float64
        The weights of the morph targets, correctives included.

    """

    mesh: int
    primitive: int
    skin: int
    node: int | None
    clip: str | None
    time: float
    method: Method
    positions: Float64Array
    normals: Mapping[str, Float64Array]
    truths: Mapping[str, Float64Array]
    joint_matrices: Float64Array
    morph_weights: Float64Array

    @property
    def pose(self) -> str:
        """Return the pose in words."""
        clip = "random poses (no clip moves it)"
        if self.clip is not None:
            clip = f'clip "{printable(self.clip)}"'
        return f"{clip} at {self.time:.9g} s"

    @property
    def numbers(self) -> int:
        """Return how many numbers the line has."""
        each = 1 + len(self.normals) + len(self.truths)
        return each * self.positions.size + self.joint_matrices.size + self.morph_weights.size


def line(name: str, posed: PosedNormals) -> bytes:
    """Return the line of a primitive of a file (docs/reference/json.md).

    Vectors follow each other in flat arrays. Matrices are by column, as in glTF.
    """
    head = {
        "schema": SCHEMA,
        "file": name,
        **{key: getattr(posed, key) for key in ("mesh", "primitive", "skin", "node", "clip", "time")},
        "method": str(posed.method),
    }
    members = {
        "positions": _text(posed.positions),
        "normals": _texts(posed.normals),
        "truths": _texts(posed.truths),
        "joint_matrices": _text(posed.joint_matrices.transpose(0, 2, 1)),
        "morph_weights": _text(posed.morph_weights),
    }
    return f"{json.dumps(head)[:-1]}, {_object(members)[1:]}\n".encode("ascii")


def _text(values: Float64Array) -> str:
    """Return numbers with nine digits, enough for float32. JSON has no NaN and no infinity: they are null."""
    numbers = (f"{one:.9g}" if math.isfinite(one) else "null" for one in values.ravel().tolist())
    return f"[{','.join(numbers)}]"


def _texts(values: Mapping[str, Float64Array]) -> str:
    return _object({key: _text(one) for key, one in values.items()})


def _object(members: Mapping[str, str]) -> str:
    return "{" + ", ".join(f'"{key}": {text}' for key, text in members.items()) + "}"
