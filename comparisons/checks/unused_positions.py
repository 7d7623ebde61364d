"""Absolute positions that no estimator has used, compared with the optimum.

Where they contradict it, one of the two is wrong, or the positions' sigma; nothing here says which.
A receiver's errors last, as those of a reflected signal do, and so do the optimum's, so that many
positions may have one error between them. Their number is taken down to that of independent ones,
which the residuals tell. And a receiver errs far now and then: the middle one of the squared
residuals is judged, not their mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.special import betaincinv

from comparisons.arrays import Array
from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.checks.position_gate import residuals
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Poses, Positions
from comparisons.plane import rms
from comparisons.statistics import chi2_quantile, independent
from comparisons.words import Cause, Explanation, Row
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.models.position import PositionModel
from graphslam.linear_problem import whiten

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

_OUTSIDE = 0.001
"""Share of sound runs whose positions contradict the optimum."""
_BAD = 0.2
"""Share of a receiver's positions that may be far off and say nothing of the others."""
_FAR = float(chi2_quantile(1.0 - _OUTSIDE, 2)) ** 0.5
"""Sigma beyond which a residual counts as so far, where their correlation is asked for."""
_FEWEST = 5
"""Positions; of fewer, the middle one says nothing."""


@dataclass(frozen=True, kw_only=True)
class UnusedPositions:
    """Positions within the optimum's time that nobody has used.

    count: of them. independent: as many independent errors tell as much. middle: of the squared
    residuals, by the covariances of positions and optimum together; ln 4 is expected of two degrees
    of freedom. limit: the largest value that sound runs reach with a fifth of bad ones. error_m:
    root mean square distance. fit: motions of the positions that leave their noise, in words, if
    any does.
    """

    count: int
    independent: float
    middle: float
    limit: float
    error_m: float
    fit: str = ""

    @property
    def contradict(self) -> bool:
        """Whether they lie farther from the optimum than both covariances explain."""
        return self.middle > self.limit

    @property
    def cause(self) -> Cause | None:
        """What to look at, None where they do not contradict it."""
        if not self.contradict:
            return None
        fit = f"; they fit {self.fit}" if self.fit else ""
        return Cause(
            "contradiction",
            f"{self.count} positions that nobody has used contradict the smoother's optimum: the "
            f"RMS distance is {self.error_m:.2g} m, and the middle one of their squared residuals "
            f"{self.middle:.3g}, expected {chi2_quantile(0.5, 2):.3g}, limit {self.limit:.3g} for "
            f"{self.independent:.3g} independent ones{fit}",
            "check the positions' clock, frame, axes and antenna, and the start; --gps on shows "
            "what the estimators make of them",
        )


class UnusedPositionsFinding(Of[UnusedPositions]):
    """How positions that nobody has used lie to the optimum: a qualifier where they contradict."""

    def rows(self) -> Sequence[Row]:
        """Return the middle of their squared residuals."""
        positions = self.value
        return [
            Row(
                "Positions that nobody has used",
                f"squared residual, middle of {positions.count} "
                f"(expected {chi2_quantile(0.5, 2):.3g})",
                f"{positions.middle:.3g}",
                f"up to {positions.limit:.3g} ({positions.independent:.3g} independent, 99.9 %)",
                not positions.contradict,
            )
        ]


class CheckUnusedPositions(Check):
    """Do the positions that no estimator has used fit the smoother's optimum?"""

    name = "unused_positions"
    needs = "absolute positions that no estimator has used"
    errs = "1 of 1,000 sound runs, whose positions may have errors that last"
    explains: ClassVar = {
        "contradiction": Explanation(
            "Positions that nobody has used contradict the optimum",
            "The log has absolute positions that neither filter nor smoother was given, and they "
            "lie farther from the smoother's optimum than the covariances of both explain. The "
            "middle one of their squared residuals is judged, so that a fifth of bad positions "
            "does not count, beside as many positions as have independent errors. Either the "
            "positions or the optimum is wrong, or a stated noise; the figures do not say which. "
            "Each known motion was fitted to the residuals, and one whose chi-square then lies in "
            "its band is named.",
            "Check the positions' clock, frame, axes and antenna, and the start. Run with "
            "`--gps on`.",
            decides="qualifies",
        )
    }

    def find(self, known: Known) -> UnusedPositionsFinding | Absent:
        """Return their distance from S."""
        positions, smoothed = known.prepared.judged.positions, known.smoothed
        inside = None if positions is None else _inside(positions, smoothed)
        if inside is None or len(inside.time_s) < _FEWEST:
            return Absent(f"the log has no {_FEWEST} absolute positions that no estimator has used")
        return UnusedPositionsFinding(unused_positions(inside, smoothed))


def unused_positions(positions: Positions, smoothed: Estimate) -> UnusedPositions:
    """Return how positions within an estimate's time lie to its path."""
    from comparisons.checks.position_fit import PositionObservations, position_fit

    path = Poses(smoothed.time_s, smoothed.pose)
    poses, covariances = path.at(positions.time_s), _covariances(positions.time_s, smoothed)
    residual, covariance = residuals(
        PositionModel(positions.antenna_m),
        (poses, covariances),
        (positions.position_m, positions.covariance),
    )
    (whitened,) = whiten(covariance, residual)
    count = independent(np.clip(whitened, -_FAR, _FAR))
    good = 0.5 / (1.0 - _BAD)
    share = betaincinv(good * (count + 1.0), (1.0 - good) * (count + 1.0), 1.0 - _OUTSIDE)
    judged = UnusedPositions(
        count=len(whitened),
        independent=count,
        middle=float(np.median((whitened**2).sum(axis=1))),
        limit=float(chi2_quantile(share, 2)),
        error_m=rms(residual),
    )
    if not judged.contradict:
        return judged
    observations = PositionObservations(
        positions.time_s, positions.position_m, covariance, positions.antenna_m
    )
    return replace(judged, fit=position_fit(observations, path))


def _inside(positions: Positions, smoothed: Estimate) -> Positions:
    """Those within the estimate's time."""
    first_s, last_s = smoothed.time_s[[0, -1]]
    return positions.chosen((positions.time_s >= first_s) & (positions.time_s <= last_s))


def _covariances(time_s: Array, smoothed: Estimate) -> Array:
    """(N, 3, 3) of the poses at times, between two of the estimate's that of the less certain one.

    The way between two poses is an arc, and interpolation cuts it short, by up to an eighth of its
    length times its turn.
    """
    after = np.clip(np.searchsorted(smoothed.time_s, time_s), 1, len(smoothed.time_s) - 1)
    before = after - 1
    covariance, exact = smoothed.pose_covariance, smoothed.time_s[after] == time_s
    step = np.diff(smoothed.pose, axis=0)[before]
    sag = np.linalg.norm(step[:, :2], axis=1) * np.abs(wrap_angle(step[:, 2])) / 8.0
    sag[exact] = 0.0
    size = np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
    later = exact | (size[after] > size[before])
    chosen = np.where(later[:, None, None], covariance[after], covariance[before]).copy()
    chosen[:, [0, 1], [0, 1]] += sag[:, None] ** 2
    return chosen
