"""Run the smoother, and the two frozen smoothers, over what the EKF was given."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from comparisons.logs.log import Log
from comparisons.runs.ekf_run import EkfRun
from comparisons.runs.estimate import Estimate
from comparisons.runs.known_landmarks import surveyed
from comparisons.runs.motion import motion_samples
from ekf_reference.trace import SightingRecords
from graphslam import increments
from graphslam.frozen import (
    FrozenPoints,
    LinearMotion,
    LinearPositions,
    LinearSightings,
    solve_own_factors,
    solve_recorded,
)
from graphslam.graph_builder import SlamProblem
from graphslam.marginals import Marginal
from graphslam.smoother import SmootherResult, smooth

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def build_problem(log: Log, run: EkfRun) -> SlamProblem:
    """The log as the smoother's arrays, with the EKF's association of sightings to landmarks."""
    timeline, used = run.timeline, np.flatnonzero(run.slot >= 0)
    seen = log.sightings
    composed = increments.compose(
        motion_samples(log, timeline), timeline.step_epoch - 1, len(timeline.epoch_time_s) - 1
    )
    return SlamProblem(
        log.prior.pose,
        log.prior.covariance,
        composed.displacement,
        composed.covariance,
        timeline.sighting_epoch[used],
        run.slot[used],
        np.column_stack((seen.range_m, seen.bearing_rad))[used],
        np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))[used],
        len(run.estimate.landmark),
        *_positions(run),
        *surveyed(log)[1:],
    )


def _positions(run: EkfRun) -> tuple[Index, Array, Array, tuple[float, float]]:
    """The fixes that the filter accepted: poses, positions, covariances, lever arm."""
    if run.positions is None:
        return np.zeros(0, dtype=np.intp), np.zeros((0, 2)), np.zeros((0, 2, 2)), (0.0, 0.0)
    p, rows = run.positions, run.fix_number
    epoch = run.timeline.position_epoch[rows]
    return epoch, p.position_m[rows], p.covariance[rows], p.antenna_m


def run_frozen_recorded(log: Log, run: EkfRun) -> Marginal:
    """F1: one linear problem from the EKF's own recorded matrices."""
    trace, estimate = run.trace, run.estimate
    parts = (_from_updates(trace.updates), _from_augmentations(trace.augmentations))
    sightings = LinearSightings(*(np.concatenate(c) for c in zip(*parts, strict=True)))
    fixes = trace.positions
    return solve_recorded(
        log.prior.pose,
        log.prior.covariance,
        LinearMotion(trace.departed, trace.arrived, trace.f, trace.q),
        sightings,
        LinearPositions(fixes.step, fixes.pose, fixes.innovation, fixes.jacobian_pose, fixes.noise),
        estimate.pose[-1],
        estimate.landmark,
    )


def run_frozen_own(problem: SlamProblem, run: EkfRun) -> Marginal:
    """F2: the smoother's own factors, linearised where the EKF was."""
    trace = run.trace
    sighting_row = np.cumsum(run.slot >= 0) - 1  # a log's sighting to the problem's
    fix_row = np.zeros(int(run.fix_number.max(initial=-1)) + 1, dtype=np.intp)
    fix_row[run.fix_number] = np.arange(len(run.fix_number))
    # A landmark begun with a boundless prior is augmented without its sighting's information.
    begun = trace.augmentations
    both = (trace.updates, begun.rows(np.flatnonzero(begun.weight > 0.0)))
    points = FrozenPoints(
        run.departed,
        run.arrived,
        sighting_row[np.concatenate([r.sighting for r in both])],
        np.concatenate([r.weight for r in both]),
        np.concatenate([r.pose for r in both]),
        np.concatenate([r.landmark for r in both]),
        fix_row[trace.positions.number],
        trace.positions.weight,
        trace.positions.pose,
    )
    return solve_own_factors(problem, points, run.estimate.landmark)


def run_smoother(
    problem: SlamProblem, run: EkfRun, progress: Callable[[str], None] = lambda stage: None
) -> SmootherResult:
    """The relinearised smoother, the EKF's estimate being one of its starts."""
    guess = (run.departed, run.estimate.landmark)
    return smooth(problem, {"ekf": guess}, progress)


def smoothed_estimate(result: SmootherResult, run: EkfRun) -> Estimate:
    """The smoother's result with its marginals."""
    return Estimate(
        run.timeline.epoch_time_s,
        result.poses,
        result.pose_covariances(),
        run.estimate.landmark_id,
        result.landmarks,
        result.marginal().covariance,
        "smoothed",
        {"estimator": "graphslam, batch Levenberg-Marquardt", "association": "the EKF's"},
    )


def _from_updates(r: SightingRecords) -> tuple[np.ndarray, ...]:
    return (
        r.step, r.slot, r.pose, r.landmark, r.innovation, r.jacobian_pose, r.jacobian_other, r.noise
    )  # fmt: skip


def _from_augmentations(r: SightingRecords) -> tuple[np.ndarray, ...]:
    """Landmark = point + G_x (x - pose) + G_z v, as a relation with residual zero."""
    identity = np.broadcast_to(np.eye(2), r.noise.shape)
    spread = r.jacobian_other @ r.noise @ r.jacobian_other.transpose(0, 2, 1)
    return (
        r.step, r.slot, r.pose, r.landmark, r.innovation, -r.jacobian_pose, identity, spread
    )  # fmt: skip
