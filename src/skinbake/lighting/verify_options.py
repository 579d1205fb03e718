"""The options of ``skinbake verify``, as values that its parts read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from skinbake.choices import Baseline, Truth, pose_choice
from skinbake.lighting.poses import PoseRequest
from skinbake.options import VERIFY, By, checked, defaults


@dataclass(frozen=True, slots=True)
class VerifyOptions:
    """The options of ``skinbake verify``.

    methods are the requested ones. If empty: LBS, and DQS if the joints are rigid. Limits are degrees, or a
    factor, of the accurate lighting. None sets no limit. They are checked by the named truth, or, if it is
    None, by each truth.
    """

    methods: tuple[str, ...] = ()
    poses: PoseRequest = field(default_factory=PoseRequest)
    max_mean_error: float | None = None
    max_p95_error: float | None = None
    min_gain: float | None = None
    require_baked: bool = False
    warnings_as_errors: bool = False
    cap: float | None = None
    baseline: Baseline = Baseline.BLENDED
    truth: Truth | None = None

    @classmethod
    def of(cls, **given: Any) -> VerifyOptions:
        """Return the options that the words and numbers of a user stand for, under the names of verify's.

        poses is ``animation``, ``random``, ``random:N`` or ``rest``. angle is in degrees. Raises ChoiceError
        for a value that does not exist.
        """
        words = checked(VERIFY, {**defaults(VERIFY, By.OVERRIDE), **given})
        kind, count = pose_choice(words.pop("poses"))
        samples, angle = words.pop("samples"), math.radians(words.pop("angle"))
        return cls(
            methods=tuple(dict.fromkeys(words.pop("methods"))),
            poses=PoseRequest(kind, count or samples, angle, words.pop("seed")),
            **words,
        )

    @property
    def limits(self) -> list[str]:
        """Return the options of the limits that are set."""
        given = {
            "--max-mean-error": self.max_mean_error,
            "--max-p95-error": self.max_p95_error,
            "--min-gain": self.min_gain,
        }
        return [option for option, limit in given.items() if limit is not None]
