"""The options of ``skinbake verify``, as values that its parts read."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from skinbake.choices import (
    VERIFY_RANGES,
    Baseline,
    Method,
    PoseKind,
    Truth,
    check_range,
    member_of,
    pose_choice,
)
from skinbake.lighting.poses import PoseRequest


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
    def of(
        cls,
        *,
        methods: Iterable[Method | str] = (),
        poses: str = PoseKind.ANIMATION,
        samples: int | None = None,
        angle: float = 30.0,
        seed: int = 0,
        baseline: Baseline | str = Baseline.BLENDED,
        truth: Truth | str | None = None,
        **others: Any,
    ) -> VerifyOptions:
        """Return the options that the words and numbers of a user stand for; others are fields.

        poses is ``animation``, ``random``, ``random:N`` or ``rest``. angle is in degrees. Raises ChoiceError
        for a value that does not exist.
        """
        numbers = {"samples": samples, "angle": angle, "seed": seed, **others}
        for name, allowed in VERIFY_RANGES.items():
            check_range(name, numbers.get(name), allowed)
        kind, count = pose_choice(poses)
        return cls(
            methods=tuple(dict.fromkeys(member_of(Method, method, "method") for method in methods)),
            poses=PoseRequest(kind, count or samples, math.radians(angle), seed),
            baseline=member_of(Baseline, baseline, "baseline"),
            truth=None if truth is None else member_of(Truth, truth, "truth"),
            **others,
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
