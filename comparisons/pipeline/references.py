"""Right estimates of a log for an external one to be compared with, at its own times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from comparisons.adapters.filter_variants import (
    BackwardEkf,
    IteratedEkf,
    SequentialEkf,
    UnscentedEkf,
)
from comparisons.adapters.motion import CLOCK_S, poses_at
from comparisons.adapters.reference_filter import FilterRun, run_reference
from comparisons.arrays import Array
from comparisons.checks.grade import SMOOTHER, Reference
from comparisons.config import SolveConfig
from comparisons.pipeline.prepare import Prepared
from comparisons.pipeline.solve import Solution
from ekf_reference.core.ekf import Ekf

EKF = "the reference EKF"
_VARIANTS: tuple[tuple[str, type[Ekf]], ...] = (
    ("an iterated EKF", IteratedEkf),
    ("an EKF that updates by one landmark after the other", SequentialEkf),
    ("an EKF that updates by one landmark after the other, the last first", BackwardEkf),
    ("an unscented Kalman filter", UnscentedEkf),
)


def reference_ekf(
    prepared: Prepared[SolveConfig], time_s: Array
) -> tuple[Reference, tuple[Array, Array]] | None:
    """The reference EKF at times (K,), and its poses and covariances before each instant's updates.

    None where it breaks down.
    """
    run = _run(prepared, Ekf, time_s)
    return None if run is None else (_of_run(EKF, run, time_s), run.before_updates().at(time_s))


def variants(prepared: Prepared[SolveConfig], time_s: Array) -> Iterator[Reference]:
    """Other sound filters on the same log, made when they are asked for."""
    for name, kind in _VARIANTS:
        run = _run(prepared, kind, time_s)
        if run is not None:
            yield _of_run(name, run, time_s)


def smoother(solution: Solution, time_s: Array) -> Reference:
    """The smoother's poses (K, 3) at times (K,); known are those at its own instants."""
    estimate = solution.estimate
    row = np.searchsorted(estimate.time_s, time_s - CLOCK_S)
    row = np.minimum(row, len(estimate.time_s) - 1)
    known = np.abs(estimate.time_s[row] - time_s) <= CLOCK_S
    return Reference(
        name=SMOOTHER,
        time_s=time_s,
        known=known,
        pose=poses_at(solution.log, estimate, time_s),
        pose_covariance=np.where(known[:, None, None], estimate.pose_covariance[row], np.nan),
        landmark_id=estimate.landmark_id,
        landmark=estimate.landmark,
        joint_covariance=estimate.joint_covariance,
        joint_s=float(estimate.time_s[-1]),
        span_s=(float(estimate.time_s[0]), float(estimate.time_s[-1])),
        smoothed=True,
    )


def _run(prepared: Prepared[SolveConfig], kind: type[Ekf], time_s: Array) -> FilterRun | None:
    p = prepared
    return run_reference(
        p.log, p.timeline, p.ekf, p.positions, kind=kind, map_s=float(np.round(time_s[-1], 4))
    )


def _of_run(name: str, run: FilterRun, time_s: Array) -> Reference:
    pose, covariance = run.at(time_s)
    epochs = run.timeline.epoch_time_s
    return Reference(
        name=name,
        time_s=time_s,
        known=np.ones(len(time_s), dtype=bool),
        pose=pose,
        pose_covariance=covariance,
        landmark_id=run.map.landmark_id,
        landmark=run.map.landmark,
        joint_covariance=run.map.joint_covariance,
        joint_s=run.map.time_s,
        span_s=(float(epochs[0]), float(epochs[-1])),
    )
