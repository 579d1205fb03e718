"""The operations of verify on every vertex in every pose: compiled loops, or whole arrays of numpy.

Only this module chooses between them, by the same rule as ``gradients.kernel``. ``by_loops`` calls the loops
of ``_loops.c``. ``by_numpy`` has the definitions. They are the oracle of the tests. They also do the work,
several times more slowly, if the package was installed without a compiler.
"""

from __future__ import annotations

from skinbake.choices import numpy_asked_for

__all__ = [
    "angles",
    "blend",
    "blended_normals",
    "class_sums",
    "count_errors",
    "dqs_normals",
    "dqs_positions",
    "gradient_rows",
    "true_normals",
]

try:
    if numpy_asked_for():
        raise ImportError("SKINBAKE_KERNEL asks for numpy")
    from skinbake.truth.by_loops import (
        angles,
        blend,
        blended_normals,
        class_sums,
        count_errors,
        dqs_normals,
        dqs_positions,
        gradient_rows,
        true_normals,
    )
except ImportError as error:
    from logging import getLogger  # it takes some milliseconds

    logger = getLogger(__name__)
    logger.info("without its compiled loops (%s): verify takes several times as long", error)
    from skinbake.truth.by_numpy import (
        angles,
        blend,
        blended_normals,
        class_sums,
        count_errors,
        dqs_normals,
        dqs_positions,
        gradient_rows,
        true_normals,
    )

IS_COMPILED = blend.__module__.endswith("by_loops")
"""Whether the compiled loops were chosen. The last digits of figures depend on it."""
