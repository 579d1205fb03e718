"""The compiled loops of ``_kernel.c``, where they were compiled and nobody asked for numpy's.

They are what runs. The functions of numpy beside every use are the definition and the test's oracle, and do
the work where the package was installed without a compiler: more slowly, to the same result within rounding.
``SKINBAKE_KERNEL=numpy`` in the environment asks for those.
"""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType

logger = logging.getLogger(__name__)


def _loaded() -> ModuleType | None:
    if os.environ.get("SKINBAKE_KERNEL") == "numpy":
        return None
    try:
        from skinbake.gradients import _kernel  # noqa: PLC0415  (it may not be there)
    except ImportError as error:
        logger.info("without its compiled loops (%s): large meshes take many times as long", error)
        return None
    return _kernel


compiled = _loaded()
"""The compiled module, or None."""
