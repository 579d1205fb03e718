"""Bake skin-weight gradients into glTF files, for correct lighting on skinned characters.

After Tarini, Panozzo, Sorkine-Hornung, *Accurate and Efficient Lighting for Skinned Models*,
Computer Graphics Forum 33(2), 2014, doi:10.1111/cgf.12330.

``joint_dual_quaternions`` prepares joint matrices on the host for the shaders of ``--method dqs``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skinbake.geometry.host import joint_dual_quaternions

__version__ = "0.1.0"
__all__ = ["__version__", "joint_dual_quaternions"]


def __getattr__(name: str) -> Any:
    """Import a function when it is asked for: numpy would double the time of the command line's --help."""
    if name == "joint_dual_quaternions":
        from skinbake.geometry.host import joint_dual_quaternions  # noqa: PLC0415

        return joint_dual_quaternions
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
