"""The fuzzer of the compiled loops knows their arguments."""

from __future__ import annotations

import numpy as np
import pytest

from fuzz.native import arrays, kernel, loops


@pytest.mark.slow
@pytest.mark.parametrize("executions", [kernel.executions, loops.executions], ids=["bake", "verify"])
def test_the_loops_take_the_arguments_as_they_are(executions: object) -> None:
    assert callable(executions)
    assert sum(executions(seed) for seed in range(5)) >= 5 * arrays.VARIATIONS * 5


def test_a_missing_argument_is_no_refusal() -> None:
    def loop(positions: np.ndarray, chains: np.ndarray) -> None: ...

    call = (loop, {"positions": np.zeros(3)}, True)
    with pytest.raises(TypeError, match="chains"):
        arrays.varied([call], np.random.default_rng(0))


def test_a_refused_value_is_no_find() -> None:
    def loop(positions: np.ndarray) -> None:
        raise ValueError("too few positions")

    assert arrays.varied([(loop, {"positions": np.zeros(3)}, True)], np.random.default_rng(0)) == 40
