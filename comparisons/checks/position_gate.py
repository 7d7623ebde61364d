"""Absolute positions that the filter's gate rejected: bad ones, or a filter that is locked out?

A filter that is too sure of a wrong place rejects one good position after the other. Alone it
cannot tell that from bad positions. The smoother has not used them either, and knows what came
later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.estimates.estimate import Estimate
from ekf_reference.models.position import PositionFixes, PositionModel


@dataclass(frozen=True)
class RejectedFixes:
    """Positions that the gate rejected.

    given: how many were given. number: (R,) which of them were rejected. streak: (R,) how many in a
    row each is one of. unfit: (R,) whether the same gate at the smoother's optimum rejects it, too.
    """

    LONG: ClassVar[int] = 5
    """Rejected positions in a row that chance does not explain."""

    given: int
    number: Index
    streak: Index
    unfit: NDArray[np.bool_]

    @property
    def in_streaks(self) -> int:
        """How many are in streaks of LONG or more."""
        return int(np.count_nonzero(self.streak >= self.LONG))

    @property
    def longest(self) -> int:
        """The longest streak."""
        return int(self.streak.max(initial=0))

    @property
    def unfit_count(self) -> int:
        """How many do not fit the smoother's optimum."""
        return int(np.count_nonzero(self.unfit))

    @property
    def remarks(self) -> list[str]:
        """What the streaks mean, where there are any."""
        count, fit = len(self.number), len(self.number) - self.unfit_count
        if not self.in_streaks:
            return []
        return [
            f"the filter's gate rejected {count} of {self.given} positions, {self.in_streaks} of "
            f"them in series of {self.LONG} or more in a row (longest {self.longest}); {fit} of "
            "the rejected positions fit the smoother's optimum, so the filter should have used "
            "them (ekf.gps_recovery re-admits such positions); "
            f"{self.unfit_count} do not fit it, so these positions or the smoother are wrong"
        ]


def rejected_fixes(run: EkfRun, smoothed: Estimate) -> RejectedFixes | None:
    """Return what the gate rejected, None where no positions were given.

    smoothed: the smoother's estimate from what the filter used, at the filter's epochs.
    """
    given, count = run.positions, len(run.fix_number) + run.rejected_fixes
    if given is None or not count:
        return None
    number = np.setdiff1d(np.arange(count), run.fix_number)
    model, at = PositionModel(given.antenna_m), run.timeline.position_epoch[number]
    unfit = [
        normalised_squared(model, pose, covariance, given.position_m[g], given.covariance[g])
        > PositionFixes().gate
        for g, pose, covariance in zip(
            number, smoothed.pose[at], smoothed.pose_covariance[at], strict=True
        )
    ]
    return RejectedFixes(count, number, streaks(number), np.array(unfit, dtype=bool))


def normalised_squared(
    model: PositionModel, pose: Array, covariance: Array, z: Array, noise: Array
) -> float:
    """Return nu^T S^-1 nu of a position z (2,) with R (2, 2) at a pose (3,), (3, 3)."""
    expected, jacobian = model.predict(pose)
    s = jacobian @ covariance @ jacobian.T + noise
    return float((z - expected) @ np.linalg.solve(s, z - expected))


def streaks(number: Index) -> Index:
    """Return for each of ascending numbers (R,) how many without a gap it is one of."""
    if not len(number):
        return number
    which = np.cumsum(np.diff(number, prepend=number[0]) > 1)
    length: Index = np.bincount(which)[which]
    return length
