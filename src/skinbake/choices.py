"""Every enumeration of the command line, the Python API and the file format, once.

The members are strings, spelt as a user types them and as the metadata of a bake hold them.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TypeVar

from skinbake.errors import ChoiceError

MemberT = TypeVar("MemberT", bound=StrEnum)


def member_of(kind: type[MemberT], value: str, name: str) -> MemberT:
    """Return a member by its value; ``name`` is the option's. Raises ChoiceError where there is none."""
    try:
        return kind(value)
    except ValueError as error:
        raise ChoiceError(f"{option_of(name)} {value}: expected one of {', '.join(kind)}") from error


def option_of(name: str) -> str:
    """Return how the command line spells an option of the Python API."""
    return "--" + name.replace("_", "-")


class Weighting(StrEnum):
    """How the triangles at a vertex are weighted when their gradients are averaged."""

    MAX = "max"
    """1 / (|e1|² |e2|²) of the corner's edges (Max 1999)."""
    ANGLE = "angle"
    AREA = "area"
    ANGLE_AREA = "angle-area"


class Neighbours(StrEnum):
    """What becomes of a joint that the neighbours of a vertex have, and the vertex has not."""

    ADOPT = "adopt"
    """The vertex takes it into a free slot, at weight 0."""
    DROP = "drop"


class Frame(StrEnum):
    """Where the tangent frame of a bake comes from: TANGENT, or NORMAL alone."""

    TANGENT = "tangent"
    NORMAL = "normal"


class FrameChoice(StrEnum):
    """Which ``Frame`` a bake is asked for; ``auto`` takes TANGENT where it is good enough."""

    AUTO = "auto"
    TANGENT = "tangent"
    NORMAL = "normal"


class Weld(StrEnum):
    """Which primitives are one surface: those of one mesh, or all that one skin draws."""

    MESH = "mesh"
    SKIN = "skin"


class Encoding(StrEnum):
    """How α and β are stored: as floats, or as normalised integers of 16 or 8 bits."""

    FLOAT32 = "float32"
    SNORM16 = "snorm16"
    PACKED8 = "packed8"

    @property
    def is_scaled(self) -> bool:
        """Tell whether values are relative to scales, and normalised integers."""
        return self is not Encoding.FLOAT32


class Layout(StrEnum):
    """Which attributes hold α and β."""

    ATTRIBUTES = "attributes"
    """α and β of each influence set in an attribute of its own, under names of one's choice."""
    TEXCOORD = "texcoord"
    """α1 α2 | α3 β1 | β2 β3 in TEXCOORD_n: for engines that pass no other attributes."""
    CUSTOM = "custom"
    """As ``attributes``, under the names that Godot passes on."""


class Scheme(StrEnum):
    """How geometry is compressed in the output: as in the input, not at all, by Draco, by meshopt."""

    KEEP = "keep"
    NONE = "none"
    DRACO = "draco"
    MESHOPT = "meshopt"


class Method(StrEnum):
    """How joint motions are blended: as matrices or as dual quaternions."""

    LBS = "lbs"
    DQS = "dqs"


class Lighting(StrEnum):
    """How the normal follows: by number, algorithms 1 and 4, 2, 3 and 5, and 6."""

    APPROXIMATED = "approximated"
    DIRECT = "direct"
    ACCURATE = "accurate"
    EXACT = "exact"


class Baseline(StrEnum):
    """The standard normal that algorithm 1 stands for under linear blend skinning."""

    BLENDED = "blended"
    """(Σ w M) n, the paper's own and three.js's."""
    INVERSE_TRANSPOSE = "inverse-transpose"
    """(Σ w M)⁻ᵀ n, as Bevy."""
    COFACTOR = "cofactor"
    """(Σ w cof M) n, as Filament."""


class PoseKind(StrEnum):
    """Where the poses come from in which lighting is measured."""

    ANIMATION = "animation"
    RANDOM = "random"
    REST = "rest"


class Language(StrEnum):
    """The shading languages."""

    GLSL = "glsl"
    WGSL = "wgsl"


class Morphs(StrEnum):
    """What the frame follows under morph targets; none: the text has no function for them."""

    NONE = "none"
    NORMAL = "normal"
    TANGENT = "tangent"
