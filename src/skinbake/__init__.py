"""Bake skin-weight gradients into glTF files, for correct lighting on skinned characters.

After Tarini, Panozzo, Sorkine-Hornung, *Accurate and Efficient Lighting for Skinned Models*,
Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330.

``bake``, ``verify``, ``inspect`` and ``strip`` do the work of the commands of these names. ``normals``
returns the normals of a pose, to test a port of the shader.
``weight_gradients`` computes α and β of arrays. ``joint_dual_quaternions`` and ``joint_scaled_motions``
prepare joint matrices on the host for the shaders of ``--method dqs``. docs/python.md shows how they are
used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from skinbake.version import __version__

if TYPE_CHECKING:
    from skinbake.api import (
        BakeOptions,
        WeightGradients,
        bake,
        inspect,
        normals,
        strip,
        verify,
        weight_gradients,
    )
    from skinbake.errors import (
        ChoiceError,
        InputError,
        OutputError,
        SkinbakeError,
        UnsupportedFeatureError,
    )
    from skinbake.geometry.dual_quaternions import joint_dual_quaternions, joint_scaled_motions
    from skinbake.report.normals import PosedNormals

__all__ = [
    "BakeOptions",
    "ChoiceError",
    "InputError",
    "OutputError",
    "PosedNormals",
    "SkinbakeError",
    "UnsupportedFeatureError",
    "WeightGradients",
    "__version__",
    "bake",
    "inspect",
    "joint_dual_quaternions",
    "joint_scaled_motions",
    "normals",
    "strip",
    "verify",
    "weight_gradients",
]

_HOMES = {
    "PosedNormals": "skinbake.report.normals",
    "joint_dual_quaternions": "skinbake.geometry.dual_quaternions",
    "joint_scaled_motions": "skinbake.geometry.dual_quaternions",
}


def __getattr__(name: str) -> Any:
    """Import a function when it is asked for: numpy would double the time of the command line's --help."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = "skinbake.errors" if name.endswith("Error") else _HOMES.get(name, "skinbake.api")
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return list(__all__)
