"""What a shader is asked to be, and which of the six algorithms that makes it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from skinbake.errors import ChoiceError

FRAMES = ("tangent", "normal")
SLOTS_PER_SET = 4


class Language(StrEnum):
    """The shading languages."""

    GLSL = "glsl"
    WGSL = "wgsl"


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


class Morphs(StrEnum):
    """What the frame follows under morph targets; none: the text has no function for them."""

    NONE = "none"
    NORMAL = "normal"
    TANGENT = "tangent"


ALGORITHMS = {
    (Method.LBS, Lighting.APPROXIMATED): 1,
    (Method.LBS, Lighting.DIRECT): 2,
    (Method.LBS, Lighting.ACCURATE): 3,
    (Method.DQS, Lighting.APPROXIMATED): 4,
    (Method.DQS, Lighting.ACCURATE): 5,
    (Method.DQS, Lighting.EXACT): 6,
}
"""The numbers of ``replay.Algorithm``; a pair that is missing does not exist."""

BEST = {Method.LBS: Lighting.ACCURATE, Method.DQS: Lighting.EXACT}
"""The lighting of least error that each method has without inverting a matrix."""


@dataclass(frozen=True, slots=True)
class AttributeText:
    """Names of α's and β's attributes by influence set, as the file of this name spells them."""

    file: str
    alpha: tuple[str, ...]
    beta: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ShaderChoices:
    """One shader: every choice that changes its text.

    influences N ≥ 1. cap limits the correction of t' and b' to cap × |T t|, None is off. With
    ``mirrored_joints`` the normal is turned by the sign of det M[s0]. attributes None stands for bake's usual
    names. ``morphs`` says what the frame follows under morph targets. Raises ChoiceError for choices that
    exclude each other.
    """

    language: Language
    method: Method = Method.LBS
    lighting: Lighting = Lighting.ACCURATE
    influences: int = 4
    frame: str = "normal"
    cap: float | None = None
    mirrored_joints: bool = False
    target: str = "plain"
    attributes: AttributeText | None = None
    morphs: Morphs = Morphs.NONE

    def __post_init__(self) -> None:
        if (self.method, self.lighting) not in ALGORITHMS:
            legal = " or ".join(light for method, light in ALGORITHMS if method is self.method)
            raise ChoiceError(f"--method {self.method} has no {self.lighting} lighting; take {legal}")
        if self.influences < 1:
            raise ChoiceError(f"--influences {self.influences}: a vertex needs at least one")
        if self.frame not in FRAMES:
            raise ChoiceError(f"--frame {self.frame} is neither {' nor '.join(FRAMES)}")
        if self.cap is not None and not self.is_corrected:
            raise ChoiceError(f"--cap is for accurate and exact lighting; {self.lighting} corrects nothing")
        if self.morphs is Morphs.TANGENT and self.frame != "tangent":
            raise ChoiceError(f"--morphs tangent needs --frame tangent; --frame {self.frame} takes normal")
        if self.mirrored_joints and not self.crosses:
            raise ChoiceError(
                f"--mirrored-joints turns the normal of --method lbs --lighting accurate, "
                f"not of {self.method} {self.lighting}"
            )

    @property
    def algorithm(self) -> int:
        """Return the algorithm's number, 1 … 6."""
        return ALGORITHMS[self.method, self.lighting]

    @property
    def is_corrected(self) -> bool:
        """Tell whether t' and b' are T t and T b plus a correction (algorithms 3, 5, 6)."""
        return self.lighting in (Lighting.ACCURATE, Lighting.EXACT)

    @property
    def crosses(self) -> bool:
        """Tell whether joints may mirror and n' is t' × b', which then points inside (algorithm 3)."""
        return self.algorithm == 3

    @property
    def reads_gradients(self) -> bool:
        """Tell whether α and β are read (all but 1 and 4); with one influence there are none."""
        return self.lighting is not Lighting.APPROXIMATED and self.influences > 1

    @property
    def influence_sets(self) -> int:
        """Return how many sets of four hold the influences."""
        return -(-self.influences // SLOTS_PER_SET)

    @property
    def words(self) -> str:
        """Return the choices in a few words, for people."""
        capped = "" if self.cap is None else f", cap {self.cap:g}"
        mirrored = ", mirrored joints" if self.mirrored_joints else ""
        morphed = "" if self.morphs is Morphs.NONE else f", morph targets by {self.morphs}"
        return (
            f"{self.language.upper()} for {self.target}, {self.method.upper()} {self.lighting}, "
            f"{self.influences} influences, {self.frame} frame{capped}{mirrored}{morphed}"
        )

    @property
    def stem(self) -> str:
        """Return the name of the algorithm's template and function, without the prefix."""
        return f"{self.method}_{self.lighting}"
