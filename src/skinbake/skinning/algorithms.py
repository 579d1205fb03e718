"""The six algorithms by number: 1–5 of Tarini et al. 2014 (supplemental material), 6 of ``dqs.exact``.

4–6 have two forms: of rigid joints (``dqs``), and of joints that scale, shear or mirror (``dqs_scaled``).
"""

from __future__ import annotations

from enum import IntEnum


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
