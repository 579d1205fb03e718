"""The fit against a formula: on a smooth tube with smooth weights the gradients of the surface are right."""

from __future__ import annotations

import pytest

from benchmarks.analytic_truth import KINDS, grown
from skinbake.choices import Gradients

LOST = 1.09
"""The error that a fit to turns may leave on a smooth surface, relative to the gradients of the surface."""


@pytest.mark.parametrize("size", [(17, 24), (24, 32)])
def test_the_fit_loses_little_on_a_smooth_tube(size: tuple[int, int]) -> None:
    surface, rig = (
        grown(KINDS["smooth"], *size, gradients=kind) for kind in (Gradients.SURFACE, Gradients.FITTED)
    )
    assert rig.accurate < LOST * surface.accurate
    assert surface.accurate < 0.1 * surface.standard


def test_the_fit_gains_on_a_steep_tube() -> None:
    surface, rig = (
        grown(KINDS["steep"], 17, 24, gradients=kind) for kind in (Gradients.SURFACE, Gradients.FITTED)
    )
    assert rig.accurate < 0.9 * surface.accurate
