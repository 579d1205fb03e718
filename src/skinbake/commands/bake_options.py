"""The options of a bake: values that exist, and no two that contradict each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from skinbake.choices import (
    BAKE_RANGES,
    SLOTS_PER_SET,
    Encoding,
    FrameChoice,
    Gradients,
    Layout,
    Neighbours,
    Scheme,
    Weighting,
    Weld,
    check_range,
    member_of,
    option_of,
)
from skinbake.errors import ChoiceError
from skinbake.format.baked import AttributeNames

if TYPE_CHECKING:
    from skinbake.lighting.poses_to_fit import PoseSource

ENUMERATIONS = {
    "gradients": Gradients,
    "weighting": Weighting,
    "weld": Weld,
    "neighbours": Neighbours,
    "frame": FrameChoice,
    "compress": Scheme,
    "encoding": Encoding,
    "layout": Layout,
}

HIGHEST_MESHOPT_LEVEL = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckedOptions:
    """The options of ``skinbake bake``, under the same names. They are checked when they are given.

    crease_angle is in degrees. Enumerations may be given by their values. fit_poses are ``animations``,
    ``random:N`` and files, which are read at once. Raises ChoiceError for a value that does not exist and for
    options that contradict each other, and InputError for a file that cannot be read.
    """

    gradients: Gradients = Gradients.RIG
    fit_poses: tuple[PoseSource, ...] = ()
    weighting: Weighting = Weighting.MAX
    crease_angle: float = 15.0
    weld: Weld = Weld.MESH
    neighbours: Neighbours = Neighbours.ADOPT
    frame: FrameChoice = FrameChoice.AUTO
    limit_influences: int | None = None
    generate_normals: bool = False
    alpha_name: str | None = None
    beta_name: str | None = None
    compress: Scheme = Scheme.KEEP
    compress_level: int | None = None
    position_bits: int | None = None
    normal_bits: int | None = None
    texcoord_bits: int | None = None
    encoding: Encoding = Encoding.FLOAT32
    layout: Layout = Layout.ATTRIBUTES
    require_baked: bool = False
    warnings_as_errors: bool = False

    def __post_init__(self) -> None:
        for name, kind in ENUMERATIONS.items():
            object.__setattr__(self, name, member_of(kind, getattr(self, name), name))
        object.__setattr__(self, "fit_poses", _pose_sources(self))
        _check(self)

    @property
    def attribute_names(self) -> AttributeNames:
        """Return the patterns of the attributes' names."""
        usual = AttributeNames()
        return AttributeNames(self.alpha_name or usual.alpha, self.beta_name or usual.beta)


def _pose_sources(options: CheckedOptions) -> tuple[PoseSource, ...]:
    """Return the sources of the poses, the file's own clips if none is named."""
    if options.gradients is not Gradients.POSES:
        if options.fit_poses:
            raise ChoiceError("--fit-poses needs --gradients poses")
        return ()
    from skinbake.lighting.poses_to_fit import ANIMATIONS, pose_source  # it poses: half a second of imports

    return tuple(map(pose_source, options.fit_poses or (ANIMATIONS,)))


def _check(options: CheckedOptions) -> None:
    """Raise ChoiceError for a number that an option cannot be, and for options that contradict each other."""
    _check_ranges(options)
    _check_names(options)
    _check_compression(options)


def _check_ranges(options: CheckedOptions) -> None:
    for name, numbers in BAKE_RANGES.items():
        check_range(name, getattr(options, name), numbers)
    if options.limit_influences is not None and options.neighbours is Neighbours.EXTEND:
        raise ChoiceError("--limit-influences contradicts --neighbours extend, which adds influences")
    if (options.limit_influences or 0) % SLOTS_PER_SET:
        raise ChoiceError(
            f"--limit-influences {options.limit_influences}: expected a multiple of 4, "
            "because glTF stores influences in sets of 4"
        )


def _check_names(options: CheckedOptions) -> None:
    for name in ("alpha_name", "beta_name"):
        pattern = getattr(options, name)
        if pattern is None:
            continue
        if not pattern.startswith("_") or "{set}" not in pattern:
            raise ChoiceError(
                f"{option_of(name)} {pattern}: expected a name that begins with an underscore, as glTF "
                "wants, and contains {set}"
            )
        if options.layout is not Layout.ATTRIBUTES:
            raise ChoiceError(
                f"{option_of(name)} needs --layout attributes; {options.layout} has fixed names"
            )
    if options.attribute_names.alpha == options.attribute_names.beta:
        raise ChoiceError("--alpha-name and --beta-name must differ")


def _check_compression(options: CheckedOptions) -> None:
    """Raise ChoiceError for bits, a level or a layout that the compression cannot use."""
    bits = (options.position_bits, options.normal_bits, options.texcoord_bits)
    if any(count is not None for count in bits) and options.compress is not Scheme.DRACO:
        raise ChoiceError("--position-bits, --normal-bits and --texcoord-bits need --compress draco")
    level = options.compress_level
    if level is not None and options.compress is Scheme.NONE:
        raise ChoiceError("--compress-level contradicts --compress none, which compresses nothing")
    if options.compress is Scheme.MESHOPT and level is not None and level > HIGHEST_MESHOPT_LEVEL:
        raise ChoiceError(f"--compress-level of meshopt is at most {HIGHEST_MESHOPT_LEVEL}")
    if options.layout is Layout.TEXCOORD and options.encoding is not Encoding.FLOAT32:
        raise ChoiceError(
            f"--layout texcoord needs --encoding float32, not {options.encoding}: only float texture "
            "coordinates of glTF may be negative"
        )
