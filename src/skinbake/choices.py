"""Every enumeration of the command line, the Python API and the file format, once.

The members are strings, spelt as a user types them and as the metadata of a bake hold them.
"""

from __future__ import annotations

import os
from enum import StrEnum

from skinbake.errors import ChoiceError

SLOTS_PER_SET = 4
"""The influences in one set of glTF: JOINTS_n and WEIGHTS_n."""


def numpy_asked_for() -> bool:
    """Tell whether the environment asks for numpy instead of compiled loops. Raises ChoiceError."""
    asked = os.environ.get("SKINBAKE_KERNEL", "")
    if asked not in {"", "numpy"}:
        reason = f' is "{asked}" in the environment: expected numpy, or nothing for compiled loops'
        raise ChoiceError("SKINBAKE_KERNEL", reason=(reason,))
    return asked == "numpy"


class Gradients(StrEnum):
    """The α and β of a bake: the slopes of the weights, or numbers that light a coarse mesh better."""

    SURFACE = "surface"
    """The gradients of the weights on the surface, as in the paper."""
    FITTED = "fitted"
    """Numbers fitted to poses of the clips and to small turns of all joints (docs/fitted.md)."""


class Weighting(StrEnum):
    """The weights of the triangles at a vertex in the mean of their gradients."""

    MAX = "max"
    """1 / (|e1|² |e2|²) of the corner's edges (Max 1999)."""
    ANGLE = "angle"
    AREA = "area"
    ANGLE_AREA = "angle-area"


class Neighbours(StrEnum):
    """The treatment of a joint that the neighbours of a vertex have, and the vertex does not have."""

    ADOPT = "adopt"
    """The vertex takes it into a free slot, with a weight too small to see."""
    EXTEND = "extend"
    """A primitive gets a further influence set if one of its vertices has too few free slots."""
    DROP = "drop"


READERS_OF_FOUR = "three.js, PlayCanvas, Galacean, Godot and Bevy"
"""The engines for which an influence set of ``Neighbours.EXTEND`` is one too many."""


class Frame(StrEnum):
    """The source of the tangent frame of a bake: TANGENT, or NORMAL alone."""

    TANGENT = "tangent"
    NORMAL = "normal"


class FrameChoice(StrEnum):
    """The requested ``Frame`` of a bake; ``auto`` takes TANGENT if it is good enough."""

    AUTO = "auto"
    TANGENT = "tangent"
    NORMAL = "normal"


class Weld(StrEnum):
    """The primitives that are one surface: all of one mesh, or all that the same skins draw."""

    MESH = "mesh"
    SKIN = "skin"


class Encoding(StrEnum):
    """The number types of α and β: floats, or normalised integers of 16 or 8 bits."""

    FLOAT32 = "float32"
    SNORM16 = "snorm16"
    PACKED8 = "packed8"

    @property
    def is_scaled(self) -> bool:
        """Tell whether values are normalised integers, relative to scales."""
        return self is not Encoding.FLOAT32


class Layout(StrEnum):
    """The attributes that hold α and β."""

    ATTRIBUTES = "attributes"
    """α and β of each influence set in their own attributes, with names of the user's choice."""
    TEXCOORD = "texcoord"
    """α1 α2 | α3 β1 | β2 β3 in TEXCOORD_n: for engines that pass no other attributes."""
    CUSTOM = "custom"
    """As ``attributes``, with the names that Godot after 4.6 passes to shaders."""


class CorrectiveAim(StrEnum):
    """The normals that correctives are fitted to: the true ones, or the normals of α and β."""

    TRUTHS = "truths"
    GRADIENTS = "gradients"


class Scheme(StrEnum):
    """The compression of geometry in the output: as in the input, none, Draco, meshopt."""

    KEEP = "keep"
    NONE = "none"
    DRACO = "draco"
    MESHOPT = "meshopt"


class Method(StrEnum):
    """The blending of joint motions: as matrices, as dual quaternions, or by each vertex between the two."""

    LBS = "lbs"
    DQS = "dqs"
    BLEND = "blend"


class Lighting(StrEnum):
    """The computation of the normal: algorithms 1 and 4, 2, 3 and 5, and 6."""

    STANDARD = "standard"
    """The lighting of common engines; the paper calls it approximated."""
    DIRECT = "direct"
    ACCURATE = "accurate"
    EXACT = "exact"


class Baseline(StrEnum):
    """The standard normal of algorithm 1 under linear blend skinning."""

    BLENDED = "blended"
    """(Σ w M) n, as in the paper and in three.js."""
    INVERSE_TRANSPOSE = "inverse-transpose"
    """(Σ w M)⁻ᵀ n, as in Bevy."""
    COFACTOR = "cofactor"
    """(Σ w cof M) n, as in Filament."""


class Truth(StrEnum):
    """By which measurement of the deformed mesh a normal is called true (docs/lighting.md)."""

    TRIANGLES = "triangles"
    """The angle-weighted normal of the triangles (Thürmer and Wüthrich 1998). Formulas agree with it best."""
    TANGENTS = "tangents"
    """The normal of the surface's own derivatives along t0 and b0."""
    RELIEF = "relief"
    """The normal that a normal map shows: that of a relief over the surface, skinned with it."""


USUAL_TRUTHS = Truth.TRIANGLES, Truth.TANGENTS
"""The truths by which verify always measures. The first stands alone where one figure must do."""


class PoseKind(StrEnum):
    """The source of the poses of a lighting measurement; ``animations`` is ``animation`` too."""

    ANIMATION = "animation"
    RANDOM = "random"
    REST = "rest"

    @classmethod
    def _missing_(cls, value: object) -> PoseKind | None:
        return cls.ANIMATION if value == f"{cls.ANIMATION}s" else None


POSES_EXPECTED = "animation, random, random:N with N of at least 1, or rest"


def pose_choice(value: str) -> tuple[PoseKind, int | None]:
    """Return the poses that a value of ``--poses`` stands for, and N of random:N. Raises ValueError."""
    word, colon, number = value.partition(":")
    count = int(number) if number.isdecimal() and number.isascii() else 0
    is_known = any(word == kind for kind in PoseKind) or word == f"{PoseKind.ANIMATION}s"
    if not is_known or (colon and (word != PoseKind.RANDOM or not count)):
        raise ValueError(f"{value}: expected {POSES_EXPECTED}")
    return PoseKind(word), count or None


class Language(StrEnum):
    """The shading languages."""

    GLSL = "glsl"
    WGSL = "wgsl"
    HLSL = "hlsl"


class Stage(StrEnum):
    """What the text of a shader is for: functions for a vertex stage, or a whole compute pass."""

    VERTEX = "vertex"
    COMPUTE = "compute"


class Morphs(StrEnum):
    """What the frame follows under morph targets; none: the text has no function for them."""

    NONE = "none"
    NORMAL = "normal"
    TANGENT = "tangent"
    FRAMES = "frames"
    """The differential of the targets, by six numbers."""
    FRAMES_NORMAL = "frames-normal"
    """The differential by four numbers, and the normal."""

    @property
    def moves_frame(self) -> bool:
        """Tell whether the frame is moved by numbers of ``bake --morph-frames``."""
        return self in (Morphs.FRAMES, Morphs.FRAMES_NORMAL)
