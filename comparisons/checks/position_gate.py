"""Absolute positions that the filter's gate rejected: bad ones, or a filter that is locked out?

A filter that is too sure of a wrong place rejects one good position after the other. Alone it
cannot tell that from bad positions. The smoother has not used them either, and knows what came
later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Poses
from comparisons.statistics import squared_distance
from comparisons.words import Cause, Explanation
from ekf_reference.models.position import PositionFixes, PositionModel

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


@dataclass(frozen=True)
class RejectedFixes:
    """Positions that the gate rejected.

    given: how many were given. number: (R,) which of them were rejected. streak: (R,) how many in a
    row each is one of. unfit: (R,) whether the same gate at the smoother's optimum rejects it, too.
    fit: what would make them fit, in words; empty where nothing known does, or need not.
    """

    LONG: ClassVar[int] = 5
    """Rejected positions in a row that chance does not explain."""

    given: int
    number: Index
    streak: Index
    unfit: NDArray[np.bool_]
    fit: str = ""

    @property
    def contradict(self) -> bool:
        """Whether most of all positions do not fit the optimum."""
        return 2 * self.unfit_count > self.given

    @property
    def causes(self) -> list[Cause]:
        """Positions that speak against all else are a disagreement, whoever is wrong."""
        if not self.contradict:
            return []
        evidence = (
            f"{self.unfit_count} of {self.given} positions contradict what odometry and landmarks "
            "say, and were rejected"
        )
        hint = "check the positions' frame, antenna, clock and sigma, and the start"
        if self.fit:
            evidence, hint = f"{evidence}; they fit {self.fit}", "correct this in the log"
        return [Cause("positions", evidence, hint)]

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
        parts = [
            f"the filter's gate rejected {count} of {self.given} positions, {self.in_streaks} of "
            f"them in series of {self.LONG} or more in a row (longest {self.longest})"
        ]
        if fit:
            parts.append(
                f"{fit} of the rejected positions pass the same gate at the smoother's optimum "
                "(ekf.gps_recovery re-admits such positions)"
            )
        if self.unfit_count:
            parts.append(f"{self.unfit_count} do not pass it there either")
        return ["; ".join(parts)]


class PositionsFinding(Of[RejectedFixes]):
    """What the gate rejected; its counts stand in the result's part of the filter."""


class CheckPositions(Check):
    """Do the positions that the filter's gate rejected fit the smoother's optimum?"""

    name = "positions"
    needs = "absolute positions that the filter was given"
    errs = "a disagreement needs more than half of all positions to contradict the optimum"
    explains: ClassVar = {
        "positions": Explanation(
            "Positions contradict the other measurements",
            "Most absolute positions fit neither the filter nor the optimum, which rest on "
            "odometry and landmarks alone, since the gate rejected these positions. One of the "
            "two is wrong. Each known motion was fitted to the residuals, and one whose "
            "chi-square then lies in its band is named.",
            "Check the antenna's place, the positions' frame and clock, and their sigma.",
        )
    }

    def find(self, known: Known) -> PositionsFinding | Absent:
        """Return what the gate rejected."""
        fixes = rejected_fixes(known.ekf, known.gaps.smoothed)
        if fixes is None:
            return Absent("the filter was given no absolute positions")
        return PositionsFinding(fixes, fixes.causes, fixes.remarks)


def rejected_fixes(run: EkfRun, smoothed: Estimate) -> RejectedFixes | None:
    """Return what the gate rejected, None where no positions were given.

    smoothed: the smoother's estimate from what the filter used, at the filter's epochs.
    """
    given, count = run.positions, len(run.fix_number) + run.rejected_fixes
    if given is None or not count:
        return None
    number = np.setdiff1d(np.arange(count), run.fix_number)
    at = run.timeline.position_epoch[number]
    residual, spread = residuals(
        PositionModel(given.antenna_m),
        (smoothed.pose[at], smoothed.pose_covariance[at]),
        (given.position_m[number], given.covariance[number]),
    )
    unfit = squared_distance(residual, spread) > PositionFixes().gate
    fixes = RejectedFixes(count, number, streaks(number), unfit)
    if not fixes.contradict:
        return fixes
    from comparisons.checks.position_fit import PositionObservations, position_fit

    observations = PositionObservations(
        smoothed.time_s[at], given.position_m[number], spread, given.antenna_m
    )
    return replace(fixes, fit=position_fit(observations, Poses(smoothed.time_s, smoothed.pose)))


def residuals(
    model: PositionModel, poses: tuple[Array, Array], positions: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return nu (N, 2) and S (N, 2, 2) of positions at poses, both with their covariances."""
    nu, spread = [], []
    for pose, covariance, z, noise in zip(*poses, *positions, strict=True):
        expected, jacobian = model.predict(pose)
        nu.append(z - expected)
        spread.append(jacobian @ covariance @ jacobian.T + noise)
    return np.array(nu).reshape(-1, 2), np.array(spread).reshape(-1, 2, 2)


def streaks(number: Index) -> Index:
    """Return for each of ascending numbers (R,) how many without a gap it is one of."""
    if not len(number):
        return number
    which = np.cumsum(np.diff(number, prepend=number[0]) > 1)
    length: Index = np.bincount(which)[which]
    return length
