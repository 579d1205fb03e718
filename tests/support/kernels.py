"""The kernel's operations by numpy, where the compiled ones were chosen."""

from __future__ import annotations

import pytest

from skinbake.gradients import by_numpy, kernel


def use_numpy(patch: pytest.MonkeyPatch) -> None:
    """Let everything that bakes use numpy, until the patch is undone."""
    for operation in kernel.__all__:
        patch.setattr(kernel, operation, getattr(by_numpy, operation))
    patch.setattr(kernel, "IS_COMPILED", False)
