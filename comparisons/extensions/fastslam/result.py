"""FastSLAM in `result.json`."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy
from comparisons.extensions.fastslam.check import LEVEL, CloudCheck, ExactCheck, StretchCheck
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import Depletion
from comparisons.figures import Model

_AGREES = {True: "agree", False: "disagree", None: "no verdict: the clouds are too small"}


class FastSlamResult(Model):
    """Entry `fastslam`: clouds of particles compared with the smoother.

    See comparisons.extensions.fastslam.check.

    Attributes:
        particles: particles of each cloud.
        clouds: independent clouds of all stretches together, one draw each.
        stretches: stretches that were compared.
        length_s: their mean length.
        energy: energy distance of all stretches over its mean where both posteriors are one.
        p: probability of so large an energy distance where both posteriors are one.
        level: largest p of a disagreement.
        squared_shift: squared distance of the draws' means from the smoother's, over what their
            scatter explains.
        largest_shift: what `squared_shift` exceeds with probability `level`.
        spread: variance of pose and map over the smoother's, mean of all directions.
        independent: independent particles that know the last pose as well as one cloud.
        agrees: whether the clouds agree with the smoother; null where they are too small to tell.
        verdict: the same in words.
        exact: the smoother's exact posterior; null where the clouds agree with its Gaussian.
        shape: what of the clouds is not Gaussian.
        path_m: whole log: distance of one cloud's mean positions from the smoother's (root mean
            square over the epochs).
        difference_m: whole log, last pose: distance of one cloud's mean from the smoother's.
        difference_rad: the same of the heading.
        effective: mean effective sample size of the whole log's cloud.
        first: particles of its first epoch that have descendants.
        middle: particles of its middle epoch that have descendants.
        accuracy: errors of its estimate.
    """

    particles: int
    clouds: int
    stretches: tuple[StretchCheck, ...]
    length_s: float
    energy: float
    p: float
    level: float
    squared_shift: float
    largest_shift: float
    spread: float
    independent: float
    agrees: bool | None
    verdict: str
    exact: ExactCheck | None
    shape: list[str]
    path_m: float
    difference_m: float
    difference_rad: float
    effective: float
    first: int
    middle: int
    accuracy: Accuracy | None


def fastslam_result(
    settings: FastSlamConfig,
    check: CloudCheck,
    depletion: Depletion,
    apart: Array,
    accuracy: Accuracy | None,
) -> FastSlamResult:
    """Return what was found. apart: (K, 3) poses of the whole log's cloud from the smoother's."""
    return FastSlamResult(
        particles=settings.particles,
        clouds=check.clouds,
        stretches=check.stretches,
        length_s=float(np.mean([one.end_s - one.begin_s for one in check.stretches])),
        energy=check.energy,
        p=check.p,
        level=LEVEL,
        squared_shift=check.squared_shift,
        largest_shift=check.largest_shift,
        spread=check.spread,
        independent=check.independent,
        agrees=check.agrees,
        verdict=_AGREES[check.agrees],
        exact=check.exact,
        shape=list(check.shape),
        path_m=float(np.sqrt(np.mean(apart[:, 0] ** 2 + apart[:, 1] ** 2))),
        difference_m=float(np.hypot(*apart[-1, :2])),
        difference_rad=float(abs(apart[-1, 2])),
        effective=depletion.effective,
        first=depletion.first,
        middle=depletion.middle,
        accuracy=accuracy,
    )
