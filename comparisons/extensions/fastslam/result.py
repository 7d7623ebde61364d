"""FastSLAM in `result.json`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy
from comparisons.extensions.fastslam.check import LEVEL, CloudCheck
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import Depletion

_AGREES = {True: "agree", False: "disagree", None: "no verdict: the clouds are too small"}


@dataclass(frozen=True, kw_only=True)
class FastSlamResult(CloudCheck):
    """Entry `fastslam`: clouds of particles compared with the smoother.

    See comparisons.extensions.fastslam.check.

    Attributes:
        particles: particles of each cloud.
        length_s: mean length of the stretches.
        level: largest p of a disagreement.
        verdict: whether the clouds agree, in words.
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
    length_s: float
    level: float
    verdict: str
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
        **vars(check),
        particles=settings.particles,
        length_s=float(np.mean([one.end_s - one.begin_s for one in check.stretches])),
        level=LEVEL,
        verdict=_AGREES[check.agrees],
        path_m=float(np.sqrt(np.mean(apart[:, 0] ** 2 + apart[:, 1] ** 2))),
        difference_m=float(np.hypot(*apart[-1, :2])),
        difference_rad=float(abs(apart[-1, 2])),
        **vars(depletion),
        accuracy=accuracy,
    )
