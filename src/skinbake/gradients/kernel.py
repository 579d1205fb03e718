"""The operations that visit every vertex, triangle or corner: compiled loops, or whole arrays of numpy.

Only this module chooses between them. Callers write ``kernel.bake_surface(…)`` and need not know the choice.
``by_loops`` calls the loops of ``_kernel.c``. ``by_numpy`` has the definitions. They are the oracle of the
tests. They also do the work if the package was installed without a compiler: more slowly, with the same
result within rounding. ``SKINBAKE_KERNEL=numpy`` in the environment selects them.
"""

from __future__ import annotations

from skinbake.choices import numpy_asked_for

__all__ = ["bake_surface", "label_equal_rows", "mark_proper", "normalise_influences"]

try:
    if numpy_asked_for():
        raise ImportError("SKINBAKE_KERNEL asks for numpy")
    from skinbake.gradients.by_loops import (
        bake_surface,
        label_equal_rows,
        mark_proper,
        normalise_influences,
    )
except ImportError as error:
    from logging import getLogger  # it takes some milliseconds

    logger = getLogger(__name__)
    logger.info("without its compiled loops (%s): large meshes take many times as long", error)
    from skinbake.gradients.by_numpy import (
        bake_surface,
        label_equal_rows,
        mark_proper,
        normalise_influences,
    )

IS_COMPILED = bake_surface.__module__.endswith("by_loops")
"""Whether the compiled loops were chosen. The last bits of results depend on it."""
