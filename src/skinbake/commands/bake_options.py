"""The options of a bake: values that exist, and no two that contradict each other."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from skinbake.choices import (
    SLOTS_PER_SET,
    CorrectiveAim,
    Encoding,
    FrameChoice,
    Gradients,
    Layout,
    Neighbours,
    Scheme,
    Weighting,
    Weld,
)
from skinbake.errors import ChoiceError, Chosen
from skinbake.format.baked import AttributeNames
from skinbake.format.note import GradientNote
from skinbake.gradients.baker import BakeSettings
from skinbake.options import BAKE, By, checked, defaults

if TYPE_CHECKING:
    from skinbake.format.character import Character
    from skinbake.truth.fit_poses import PoseSource

USUAL = defaults(BAKE, By.OVERRIDE)

HIGHEST_MESHOPT_LEVEL = 3


ONLY_FOR_GRADIENTS = (
    "layout",
    "alpha_name",
    "beta_name",
    "limit_influences",
    "morph_frames",
    "blend",
)
"""The options that say how α and β are stored, or that belong to them."""

NOT_WITH_CORRECTIVES = {
    "generate_normals": ": correctives change the normals of a file, so store NORMAL in it first",
    **dict.fromkeys(
        ("compress", "compress_level", "position_bits", "normal_bits", "texcoord_bits"),
        ": correctives keep the compression of a file, so change it first",
    ),
}
"""Options that a bake of correctives refuses, and what to do."""

ONLY_FOR_AIM = "gradients", "fit_poses", "weighting", "crease_angle", "weld", "neighbours"
"""The options that say what α and β are. Correctives read them if they aim at α and β."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BakeOptions:
    """The options of ``skinbake bake``, under the same names. They are checked when they are given.

    crease_angle is in degrees. Enumerations may be given by their values. fit_poses are ``animations``,
    ``random:N`` and files, which are read at once. character is that of ``--one-character``, whose files have
    been read. Raises ChoiceError for a value that does not exist and for
    options that contradict each other, and InputError for a file that cannot be read.
    """

    gradients: Gradients = USUAL["gradients"]
    fit_poses: tuple[PoseSource, ...] = USUAL["fit_poses"]
    weighting: Weighting = USUAL["weighting"]
    crease_angle: float = USUAL["crease_angle"]
    weld: Weld = USUAL["weld"]
    neighbours: Neighbours = USUAL["neighbours"]
    frame: FrameChoice = USUAL["frame"]
    limit_influences: int | None = USUAL["limit_influences"]
    generate_normals: bool = USUAL["generate_normals"]
    morph_normals: bool = USUAL["morph_normals"]
    morph_frames: bool = USUAL["morph_frames"]
    blend: str | None = USUAL["blend"]
    correctives: int | Literal["auto"] | None = USUAL["correctives"]
    clips: tuple[str, ...] = USUAL["clips"]
    clips_own_weights: bool = USUAL["clips_own_weights"]
    corrective_aim: CorrectiveAim = USUAL["corrective_aim"]
    alpha_name: str | None = USUAL["alpha_name"]
    beta_name: str | None = USUAL["beta_name"]
    compress: Scheme = USUAL["compress"]
    compress_level: int | None = USUAL["compress_level"]
    position_bits: int | None = USUAL["position_bits"]
    normal_bits: int | None = USUAL["normal_bits"]
    texcoord_bits: int | None = USUAL["texcoord_bits"]
    encoding: Encoding = USUAL["encoding"]
    layout: Layout = USUAL["layout"]
    leave_under: float | None = USUAL["leave_under"]
    require_baked: bool = USUAL["require_baked"]
    warnings_as_errors: bool = USUAL["warnings_as_errors"]
    character: Character | None = None

    def __post_init__(self) -> None:
        # The sources of poses may have been read already.
        given = {name: getattr(self, name) for name in USUAL if name != "fit_poses"}
        for name, value in checked(BAKE, given).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "fit_poses", self._pose_sources())
        # Influences come in sets.
        if self.limit_influences is not None and self.neighbours is Neighbours.EXTEND:
            extend = Chosen("neighbours", Neighbours.EXTEND)
            raise ChoiceError("limit_influences", reason=(" contradicts ", extend, ", which adds influences"))
        if self.limit_influences is not None and self.limit_influences % SLOTS_PER_SET:
            multiple = f"a multiple of {SLOTS_PER_SET}"
            expected = f"{multiple}, because glTF stores influences in sets of {SLOTS_PER_SET}"
            raise ChoiceError("limit_influences", self.limit_influences, expected)
        self._check_names()
        # Bits, levels and layouts that the compression cannot use.
        for name in ("position_bits", "normal_bits", "texcoord_bits"):
            if getattr(self, name) is not None and self.compress is not Scheme.DRACO:
                raise ChoiceError(name, reason=(" needs ", Chosen("compress", Scheme.DRACO)))
        level, scheme = self.compress_level, Chosen("compress", self.compress)
        if level is not None and self.compress is Scheme.NONE:
            raise ChoiceError(
                "compress_level", reason=(" contradicts ", scheme, ", which compresses nothing")
            )
        if self.compress is Scheme.MESHOPT and level is not None and level > HIGHEST_MESHOPT_LEVEL:
            reason = (f": expected at most {HIGHEST_MESHOPT_LEVEL} with ", scheme)
            raise ChoiceError("compress_level", level, reason=reason)
        if self.layout is Layout.TEXCOORD and self.encoding is not Encoding.FLOAT32:
            why = f", not {self.encoding}: only float texture coordinates of glTF may be negative"
            needed = Chosen("encoding", Encoding.FLOAT32)
            raise ChoiceError("layout", self.layout, reason=(" needs ", needed, why))
        self._check_correctives()

    def _pose_sources(self) -> tuple[PoseSource, ...]:
        """Return the sources of the poses, none for the file's own clips."""
        given = self.fit_poses
        if isinstance(given, str | bytes) or not isinstance(given, Collection):
            raise ChoiceError("fit_poses", given, "a list of names")
        if not len(given):
            return ()
        if self.gradients is Gradients.SURFACE:
            raise ChoiceError("fit_poses", reason=(" needs ", Chosen("gradients", Gradients.FITTED)))
        from skinbake.truth.fit_poses import pose_source  # it poses: half a second of imports

        return tuple(map(pose_source, given))

    def _check_names(self) -> None:
        """Refuse names of attributes that glTF or the layout does not allow."""
        for name, pattern in (("alpha_name", self.alpha_name), ("beta_name", self.beta_name)):
            if pattern is None:
                continue
            if not pattern.startswith("_") or "{set}" not in pattern:
                expected = "a name that begins with an underscore, as glTF wants, and contains {set}"
                raise ChoiceError(name, pattern, expected)
            if self.layout is not Layout.ATTRIBUTES:
                needed = Chosen("layout", Layout.ATTRIBUTES)
                raise ChoiceError(name, reason=(" needs ", needed, f"; {self.layout} has fixed names"))
        if self.attribute_names.alpha == self.attribute_names.beta:
            raise ChoiceError("alpha_name", reason=(" and ", Chosen("beta_name"), " must differ"))
        if self.blend is not None and not self.blend.startswith("_"):
            expected = "an attribute whose name begins with an underscore, as glTF wants"
            raise ChoiceError("blend", self.blend, expected)

    def _check_correctives(self) -> None:
        """Refuse options of correctives without them, and others that correctives do not read."""
        if self.correctives is None:
            needed = Chosen("correctives", "auto")
            self._refuse("clips", "clips_own_weights", "corrective_aim", reason=(" needs ", needed))
            return
        chosen = Chosen("correctives", self.correctives)
        self._refuse(*ONLY_FOR_GRADIENTS, reason=(" contradicts ", chosen, ", which adds no α and β"))
        for name, advice in NOT_WITH_CORRECTIVES.items():
            self._refuse(name, reason=(" contradicts ", chosen, advice))
        if self.corrective_aim is CorrectiveAim.TRUTHS:
            needed = Chosen("corrective_aim", CorrectiveAim.GRADIENTS)
            self._refuse(*ONLY_FOR_AIM, reason=(" with ", chosen, " needs ", needed))

    def _refuse(self, *names: str, reason: tuple[str | Chosen, ...]) -> None:
        """Raise ChoiceError for the first of these options that differs from its default."""
        for name in names:
            if getattr(self, name) != USUAL[name]:
                raise ChoiceError(name, reason=reason)

    @property
    def attribute_names(self) -> AttributeNames:
        """Return the patterns of the attributes' names."""
        usual = AttributeNames()
        return AttributeNames(self.alpha_name or usual.alpha, self.beta_name or usual.beta)

    @property
    def settings(self) -> BakeSettings:
        """Return the options of the gradients."""
        return BakeSettings(self.weighting, math.radians(self.crease_angle), self.neighbours, self.frame)

    @property
    def note(self) -> GradientNote:
        """What the note of a primitive says of the options."""
        return GradientNote(
            weighting=self.weighting,
            crease_angle=round(float(self.crease_angle), 6),
            neighbours=self.neighbours,
            weld=self.weld,
        )

    @property
    def bits(self) -> dict[str, int]:
        """Return the numbers of bits to which Draco quantises, by attribute."""
        bits = {"POSITION": self.position_bits, "NORMAL": self.normal_bits, "TEXCOORD_0": self.texcoord_bits}
        return {name: count for name, count in bits.items() if count is not None}


DEFAULTS, OF_SURFACE = BakeOptions(), BakeOptions(gradients=Gradients.SURFACE)
"""A bake without options; and the α and β that are made soonest, for what only measures or welds by them."""
