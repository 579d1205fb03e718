"""What the options of a bake must be: values that exist, and no two that contradict each other."""

from __future__ import annotations

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
    option_of,
)
from skinbake.errors import ChoiceError

if TYPE_CHECKING:
    from skinbake.commands.bake import Baker
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


def pose_sources(baker: Baker) -> tuple[PoseSource, ...]:
    """Return the sources of the poses, the file's own clips if none is named."""
    if baker.gradients is not Gradients.POSES:
        if baker.fit_poses:
            raise ChoiceError("--fit-poses needs --gradients poses")
        return ()
    from skinbake.lighting.poses_to_fit import ANIMATIONS, pose_source  # it poses: half a second of imports

    return tuple(map(pose_source, baker.fit_poses or (ANIMATIONS,)))


def check_options(baker: Baker) -> None:
    """Raise ChoiceError for a number that an option cannot be, and for options that contradict each other."""
    _check_ranges(baker)
    _check_names(baker)
    _check_compression(baker)


def _check_ranges(baker: Baker) -> None:
    for name, numbers in BAKE_RANGES.items():
        check_range(name, getattr(baker, name), numbers)
    if baker.limit_influences is not None and baker.neighbours is Neighbours.EXTEND:
        raise ChoiceError("--limit-influences contradicts --neighbours extend, which adds influences")
    if (baker.limit_influences or 0) % SLOTS_PER_SET:
        raise ChoiceError(
            f"--limit-influences {baker.limit_influences}: expected a multiple of 4, "
            "because glTF stores influences in sets of 4"
        )


def _check_names(baker: Baker) -> None:
    for name in ("alpha_name", "beta_name"):
        pattern = getattr(baker, name)
        if pattern is None:
            continue
        if not pattern.startswith("_") or "{set}" not in pattern:
            raise ChoiceError(
                f"{option_of(name)} {pattern}: expected a name that begins with an underscore, as glTF "
                "wants, and contains {set}"
            )
        if baker.layout is not Layout.ATTRIBUTES:
            raise ChoiceError(f"{option_of(name)} needs --layout attributes; {baker.layout} has fixed names")
    if baker.attribute_names.alpha == baker.attribute_names.beta:
        raise ChoiceError("--alpha-name and --beta-name must differ")


def _check_compression(baker: Baker) -> None:
    """Raise ChoiceError for bits, a level or a layout that the compression cannot use."""
    bits = (baker.position_bits, baker.normal_bits, baker.texcoord_bits)
    if any(count is not None for count in bits) and baker.compress is not Scheme.DRACO:
        raise ChoiceError("--position-bits, --normal-bits and --texcoord-bits need --compress draco")
    level = baker.compress_level
    if level is not None and baker.compress is Scheme.NONE:
        raise ChoiceError("--compress-level contradicts --compress none, which compresses nothing")
    if baker.compress is Scheme.MESHOPT and level is not None and level > HIGHEST_MESHOPT_LEVEL:
        raise ChoiceError(f"--compress-level of meshopt is at most {HIGHEST_MESHOPT_LEVEL}")
    if baker.layout is Layout.TEXCOORD and baker.encoding is not Encoding.FLOAT32:
        raise ChoiceError(
            f"--layout texcoord needs --encoding float32, not {baker.encoding}: only float texture "
            "coordinates of glTF may be negative"
        )
