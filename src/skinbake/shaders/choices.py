"""The choices for a shader, and the one of the six algorithms that follows from them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from skinbake.choices import SLOTS_PER_SET, Encoding, Frame, Language, Layout, Lighting, Method, Morphs, Stage
from skinbake.errors import ChoiceError, Chosen
from skinbake.options import SHADER

OPTIONS = [one for one in SHADER if one.name in {"frame", "encoding", "layout"}]

CUSTOM_SETS = 2
"""The number of influence sets of the custom layout: Godot after 4.6 reads `_CUSTOM0` to `_CUSTOM3`."""

CAPS = (1e-6, 1e6)
"""The smallest and the largest cap: the shaders square it in float32."""

AT_RUN_TIME = {"three", "babylon", "godot", "playcanvas", "galacean", "bevy"}
"""The targets whose code reads all but the lighting from the file when it runs."""

ALGORITHMS = {
    (Method.LBS, Lighting.STANDARD): 1,
    (Method.LBS, Lighting.DIRECT): 2,
    (Method.LBS, Lighting.ACCURATE): 3,
    (Method.DQS, Lighting.STANDARD): 4,
    (Method.DQS, Lighting.ACCURATE): 5,
    (Method.DQS, Lighting.EXACT): 6,
}
"""The numbers of ``skinning.rest.Algorithm``; a missing pair does not exist."""

BLENDED = {Lighting.STANDARD: 4, Lighting.ACCURATE: 6}
"""For blended skinning, the number of its dual quaternions; ``blended.LINEAR`` names what goes with it."""

BEST = {Method.LBS: Lighting.ACCURATE, Method.DQS: Lighting.EXACT, Method.BLEND: Lighting.ACCURATE}
"""The lighting with the smallest error of each method, without inverting a matrix."""


@dataclass(frozen=True, slots=True)
class AttributeText:
    """Names of the attributes of α and β by influence set, in the spelling of the file ``file``.

    In the texcoord layout these are the sets that hold any of α, and any of β. The last set of α is the first
    set of β. blend is the attribute of blend weights.
    """

    file: str
    alpha: tuple[str, ...]
    beta: tuple[str, ...]
    blend: str | None = None


@dataclass(frozen=True, slots=True)
class ShaderRequest:
    """What is asked of a shader. None leaves the choice to the baked file, or to the default.

    influences N ≥ 1. cap limits the correction of t' and b' to cap × |T t|, None is off. With
    ``mirrored_joints`` the normal is turned by the sign of det T. With ``scaled_joints``, dual quaternions
    take joints that scale, shear or mirror. encoding and layout are the storage of α and β. ``morphs`` is the
    direction that the frame follows under morph targets. With ``normal_map`` the text has what mapped normals
    need, too. ``stage`` COMPUTE is a whole pass over buffers in place of functions.
    """

    language: Language
    method: Method = Method.LBS
    lighting: Lighting | None = None
    influences: int | None = None
    frame: Frame | None = None
    cap: float | None = None
    mirrored_joints: bool = False
    scaled_joints: bool = False
    target: str = "plain"
    encoding: Encoding | None = None
    layout: Layout | None = None
    morphs: Morphs | None = None
    normal_map: bool = False
    stage: Stage = Stage.VERTEX

    def decided(self, **known: Any) -> ShaderChoices:
        """Return the choices of a request, of what is known of a file, and of the defaults."""
        asked = {one.name: getattr(self, one.name) for one in fields(ShaderRequest)}
        asked = {name: value for name, value in asked.items() if value is not None}
        return ShaderChoices(**{"lighting": BEST[self.method], **known, **asked})


@dataclass(frozen=True, slots=True)
class ShaderChoices(ShaderRequest):
    """One shader: every choice that changes its text. Raises ChoiceError for choices that exclude each other.

    attributes None means the default names of bake. scale is that of the encoding if the file is known, in
    1 / length unit of POSITION.
    """

    lighting: Lighting = Lighting.ACCURATE
    influences: int = 4
    frame: Frame = Frame.NORMAL
    encoding: Encoding = Encoding.FLOAT32
    layout: Layout = Layout.ATTRIBUTES
    morphs: Morphs = Morphs.NONE
    attributes: AttributeText | None = None
    scale: float | None = None

    def __post_init__(self) -> None:
        legal = [light for method, light in ALGORITHMS if method is self.method] or list(BLENDED)
        if self.lighting not in legal:
            why = f" has no {self.lighting} lighting; take {', '.join(legal[:-1])} or {legal[-1]}"
            raise ChoiceError("method", self.method, reason=(why,), also=("lighting",))
        if self.influences < 1:
            raise self._refusal("influences", ": a vertex needs at least one")
        for option in OPTIONS:
            option.checked(getattr(self, option.name))
        if self.layout == Layout.CUSTOM and self.influence_sets > CUSTOM_SETS:
            why = f": it holds {CUSTOM_SETS * SLOTS_PER_SET} influences, not {self.influences}"
            raise self._refusal("layout", why)
        if self.layout == Layout.TEXCOORD and self.encoding != Encoding.FLOAT32:
            needed = Chosen("encoding", Encoding.FLOAT32)
            raise self._refusal("layout", " needs ", needed, f", not {self.encoding}")
        if self.cap is not None and not self.is_corrected:
            why = f" is for accurate and exact lighting; {self.lighting} has no correction"
            raise ChoiceError("cap", reason=(why,), also=("lighting",))
        if self.cap is not None and not CAPS[0] <= self.cap <= CAPS[1]:
            raise self._refusal("cap", f" is not in the range {CAPS[0]:g} to {CAPS[1]:g} of a shader")
        if self.morphs is Morphs.TANGENT and self.frame != Frame.TANGENT:
            frame, needed = Chosen("frame", self.frame), Chosen("morphs", Morphs.NORMAL)
            wanted = Chosen("frame", Frame.TANGENT)
            raise self._refusal("morphs", " needs ", wanted, "; ", frame, " needs ", needed)
        if self.normal_map and not self.is_corrected:
            why = f" is for accurate and exact lighting, not {self.lighting}"
            raise ChoiceError("normal_map", reason=(why,), also=("lighting",))
        if self.scaled_joints and self.algorithm != 6:
            dual = Method.DQS if self.method is Method.LBS else self.method
            method, lighting = Chosen("method", dual), Chosen("lighting", BEST[dual])
            why = f", not {self.method} {self.lighting}"
            raise ChoiceError("scaled_joints", reason=(" needs ", method, " ", lighting, why))
        if self.mirrored_joints and not self.crosses:
            method, lighting = Chosen("method", Method.LBS), Chosen("lighting", Lighting.ACCURATE)
            why = f", not {self.method} {self.lighting}"
            raise ChoiceError("mirrored_joints", reason=(" needs ", method, " ", lighting, why))

        self._check_pass()

    def _check_pass(self) -> None:
        """Raise ChoiceError for what blended skinning and a compute pass have no text for."""
        if self.method is Method.BLEND:
            if self.target != "plain":
                raise self._refusal("method", " needs ", Chosen("target", "plain"), f", not {self.target}")
            if self.normal_map:
                other = ": leave it out, or light the mesh by ", Chosen("method", "lbs"), " or dqs"
                raise self._refusal("method", " contradicts ", Chosen("normal_map"), *other)
            if self.stage is Stage.COMPUTE:
                raise self._refusal("method", " contradicts ", Chosen("stage", Stage.COMPUTE))
        if self.stage is not Stage.COMPUTE:
            return
        if self.target != "plain":
            raise self._refusal("stage", " needs ", Chosen("target", "plain"), f", not {self.target}")
        if self.normal_map:
            raise self._refusal("stage", " contradicts ", Chosen("normal_map"))

    def _refusal(self, option: str, *reason: str | Chosen) -> ChoiceError:
        """Return the error about the value of an option."""
        return ChoiceError(option, getattr(self, option), reason=reason)

    @property
    def algorithm(self) -> int:
        """Return the number of the algorithm, 1 … 6."""
        if self.method is Method.BLEND:
            return BLENDED[self.lighting]
        return ALGORITHMS[self.method, self.lighting]

    @property
    def is_corrected(self) -> bool:
        """Tell whether t' and b' are T t and T b plus a correction (algorithms 3, 5, 6, and their blend)."""
        return self.lighting in (Lighting.ACCURATE, Lighting.EXACT)

    @property
    def crosses(self) -> bool:
        """Tell whether joints may mirror and n' is t' × b', which then points inside."""
        return (self.method is not Method.DQS and self.is_corrected) or self.scaled_joints

    @property
    def reads_gradients(self) -> bool:
        """Tell whether α and β are read (in all algorithms except 1 and 4); one influence alone has none."""
        return self.lighting is not Lighting.STANDARD and self.influences > 1

    @property
    def influence_sets(self) -> int:
        """Return the number of sets of four influences."""
        return -(-self.influences // SLOTS_PER_SET)

    @property
    def decodes(self) -> bool:
        """Tell whether α and β are read as integers relative to scales."""
        return self.reads_gradients and self.encoding != Encoding.FLOAT32

    @property
    def assembles(self) -> bool:
        """Tell whether α and β are read from texture coordinates."""
        return self.reads_gradients and self.layout == Layout.TEXCOORD

    @property
    def pair_names(self) -> tuple[str, ...]:
        """Return the texture coordinate sets that hold α and β, K − 1 of them.

        Without a file, they are the sets after the only one of the primitive itself.
        """
        if self.attributes is not None:
            return (*self.attributes.alpha, *self.attributes.beta[1:])
        return tuple(f"TEXCOORD_{number}" for number in range(1, SLOTS_PER_SET * self.influence_sets))

    @property
    def words(self) -> str:
        """Return the choices in a few words, for people."""
        capped = "" if self.cap is None else f", cap {self.cap:g}"
        mirrored = ", joints that scale" if self.scaled_joints else ""
        mirrored += ", mirrored joints" if self.mirrored_joints else ""
        mapped = ", normal maps" if self.normal_map else ""
        mapped += ", a compute pass" if self.stage is Stage.COMPUTE else ""
        if self.target in AT_RUN_TIME:
            return (
                f"{self.target}, {self.method.upper()} {self.lighting}{capped}{mirrored}; it reads frame, "
                "encoding and layout from each file"
            )
        morphed = "" if self.morphs is Morphs.NONE else f", morph targets by {self.morphs}"
        return (
            f"{self.target} {self.language.upper()}, {self.method.upper()} {self.lighting}, "
            f"{self.influences} influences, {self.frame} frame{capped}{mirrored}{morphed}{mapped}"
            f"{self.storage_words}"
        )

    @property
    def storage_words(self) -> str:
        """Return the storage of α and β in words to append, if it is not the default."""
        words = [str(self.encoding)] if self.decodes else []
        words += (
            [f"{self.layout} layout"] if self.reads_gradients and self.layout != Layout.ATTRIBUTES else []
        )
        return "".join(f", {word}" for word in words)

    @property
    def stem(self) -> str:
        """Return the name of the template and function of the algorithm, without the prefix."""
        return f"{self.method}_{'scaled' if self.scaled_joints else self.lighting}"

    @property
    def both(self) -> tuple[ShaderChoices, ShaderChoices]:
        """Return, for blended skinning, the choices of linear blending and of dual quaternions alone."""
        best = Lighting.EXACT if self.is_corrected else Lighting.STANDARD
        mirrored = self.mirrored_joints and self.scaled_joints
        return (
            replace(self, method=Method.LBS, scaled_joints=False),
            replace(self, method=Method.DQS, lighting=best, mirrored_joints=mirrored),
        )
