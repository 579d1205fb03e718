"""The six algorithms by number: 1–5 of Tarini et al. 2014 (supplemental material), 6 of ``dqs.exact``.

4–6 have two forms: of rigid joints (``dqs``), and of joints that scale, shear or mirror (``dqs_scaled``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, TypeAlias

from skinbake.skinning import dqs, dqs_scaled, lbs
from skinbake.skinning.components import LineMark, PosedVertex, RestVertex
from skinbake.skinning.rest import Options


class Algorithm(IntEnum):
    """Numbers and names; 1–3 are linear blend skinning, 4–6 dual quaternion skinning.

    The standard lighting of 1 and 4 is called approximated in the paper.
    """

    LBS_STANDARD = 1
    LBS_DIRECT = 2
    LBS_ACCURATE = 3
    DQS_STANDARD = 4
    DQS_ACCURATE = 5
    DQS_EXACT = 6

    @property
    def uses_dual_quaternions(self) -> bool:
        """Tell whether it is dual quaternion skinning."""
        return self >= Algorithm.DQS_STANDARD


# The second argument has an entry for each slot: Rows for 1–3, dual quaternions for 4–6; Rows also for
# joints that scale.
Steps: TypeAlias = Callable[[RestVertex, Sequence[Any], Options, LineMark], PosedVertex]

STEPS: dict[Algorithm, Steps] = {
    Algorithm.LBS_STANDARD: lbs.standard,
    Algorithm.LBS_DIRECT: lbs.direct,
    Algorithm.LBS_ACCURATE: lbs.accurate,
    Algorithm.DQS_STANDARD: dqs.standard,
    Algorithm.DQS_ACCURATE: dqs.accurate,
    Algorithm.DQS_EXACT: dqs.exact,
}

SCALED_STEPS: dict[Algorithm, Steps] = {
    Algorithm.DQS_STANDARD: dqs_scaled.standard,
    Algorithm.DQS_ACCURATE: dqs_scaled.accurate,
    Algorithm.DQS_EXACT: dqs_scaled.exact,
}
