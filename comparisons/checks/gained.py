"""What an estimate knows of the vehicle that the odometry alone does not tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Of
from comparisons.estimates.estimate import Estimate
from comparisons.plane import rms
from comparisons.words import Row
from graphslam.increments import dead_reckoned_covariance

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

NOTHING = 0.9
"""Share of the odometry's sigma that is left, from which on next to nothing was gained."""


class Gain(NamedTuple):
    """An estimate beside the odometry alone.

    sigma_left: of the position, over the odometry's, median over the poses. moved_m: root mean
    square distance of the two paths.
    """

    sigma_left: float
    moved_m: float

    @property
    def is_nothing(self) -> bool:
        """Whether the estimate knows next to nothing but the odometry."""
        return self.sigma_left > NOTHING


class GainFinding(Of[Mapping[str, Gain]]):
    """What the estimates have gained, by their names."""

    def rows(self) -> Sequence[Row]:
        """Return two rows for each."""
        group, rows = "Beside the odometry alone", list[Row]()
        for name, gain in self.value.items():
            left = f"{100.0 * gain.sigma_left:.3g} %"
            rows.append(Row(group, f"position sigma that is left, {name}", left))
            moved = f"{gain.moved_m:.3f} m"
            rows.append(Row(group, f"distance of the path, {name} (rms)", moved))
        return rows


class CheckGain(Check):
    """Do landmarks, positions and closures tell anything that the odometry does not?"""

    name = "gain"
    needs = "odometry between all poses, and a smoother's optimum"
    errs = "not at all: what is gained changes no verdict"

    def find(self, known: Known) -> GainFinding | Absent:
        """Return what each estimate has gained, and a remark on those that have next to nothing."""
        problem, path = known.result.problem, known.dead_reckoned
        spread = dead_reckoned_covariance(
            problem.prior_covariance, path, problem.increment_covariance
        )
        variance = _variance(spread)
        if not np.isfinite(variance).all() or not (variance[1:] > 0.0).any():
            return Absent("the odometry does not lead from the first pose to the last")
        each = {
            name: Gain(_left(estimate, variance), rms((estimate.pose - path)[:, :2]))
            for name, estimate in known.estimates.items()
            if _is_at(estimate, known.smoothed)
        }
        nothing = [name for name, gain in each.items() if gain.is_nothing]
        remarks = []
        if nothing:
            figures = ", ".join(f"{100.0 * each[name].sigma_left:.3g} %" for name in nothing)
            remarks.append(
                f"{' and '.join(nothing)} know next to nothing that the odometry alone does not "
                f"tell: {figures} of its position sigma is left (median over the poses)"
            )
        return GainFinding(each, (), remarks)


def _is_at(estimate: Estimate, smoothed: Estimate) -> bool:
    """Whether an estimate has poses with covariances at the smoother's epochs."""
    return bool(
        len(estimate.time_s) == len(smoothed.time_s)
        and np.allclose(estimate.time_s, smoothed.time_s, rtol=0.0, atol=1e-6)
        and np.isfinite(estimate.pose_covariance).all()
        and (_variance(estimate.pose_covariance) >= 0.0).all()
    )


def _left(estimate: Estimate, variance: Array) -> float:
    some = variance > 0.0
    some[0] = False  # the prior is the same for all
    left = _variance(estimate.pose_covariance)[some] / variance[some]
    return float(np.median(np.sqrt(left)))


def _variance(covariance: Array) -> Array:
    """(K,) of positions, both axes together [m^2]."""
    found: Array = np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
    return found
