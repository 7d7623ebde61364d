"""Run the smoother, and the two frozen smoothers, over what the EKF was given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.motion import (
    LEAST_EIGENVALUE,
    composed_motion,
    least_eigenvalues,
    motion_samples,
)
from comparisons.adapters.recorded import (
    measurement_points,
    merge_points,
    recorded,
    used_entries,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log, Positions
from comparisons.logs.transforms.known_landmarks import surveyed
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.layout import Layout
from graphslam.arrays import Marginal
from graphslam.layout import POINT, POSE_LANDMARK, LandmarkKind
from graphslam.linear_problem import LinearProblem, LinearRelations, solve
from graphslam.model_system import LinearisationPoints, model_motion, model_system, moved_to
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.smoother import SmootherEvidence, SmootherOptions, smooth


class PositionRows(NamedTuple):
    """Fixes of absolute positions: poses (G,), positions (G, 2) [m], covariances (G, 2, 2).

    antenna_m: the antenna's place in the vehicle's frame.
    """

    epoch: Index
    position: Array
    covariance: Array
    antenna_m: tuple[float, float]


def build_problem(log: Log, run: EkfRun) -> SlamProblem:
    """The log as the smoother's arrays, with the EKF's association, and the fixes it accepted."""
    count, rows = len(run.estimate.landmark), run.fix_number
    epoch, z, covariance, antenna_m = position_rows(run.timeline, run.positions)
    fused = PositionRows(epoch[rows], z[rows], covariance[rows], antenna_m)
    problem = assemble(log, run.timeline, run.landmark_index, count, fused)
    return replace(problem, pose_landmarks=run.pose_landmarks)


def assemble(
    log: Log,
    timeline: Timeline,
    landmark_index: Index,
    landmark_count: int,
    fixes: PositionRows,
) -> SlamProblem:
    """Return the log as arrays. landmark_index: (M,) of the measurements, negative where unused."""
    used = np.flatnonzero(landmark_index >= 0)
    measurements = log.measurements
    composed = composed_motion(log, timeline)
    _, surveyed_place, surveyed_covariance = surveyed(log)
    return SlamProblem(
        prior_pose=log.prior.pose,
        prior_covariance=log.prior.covariance,
        increment=composed.displacement,
        increment_covariance=composed.covariance,
        measurement_pose=timeline.measurement_epoch[used],
        measurement_landmark=landmark_index[used],
        z=np.column_stack((measurements.range_m, measurements.bearing_rad))[used],
        sigma=np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))[used],
        landmark_count=landmark_count,
        position_pose=fixes.epoch,
        position=fixes.position,
        position_covariance=fixes.covariance,
        lever_m=fixes.antenna_m,
        surveyed=surveyed_place,
        surveyed_covariance=surveyed_covariance,
        loop_closures=_loop_closures(log, timeline),
    )


def _loop_closures(log: Log, timeline: Timeline) -> LoopClosures:
    """Those of the timeline's poses."""
    c = log.loop_closures
    if c is None:
        return LoopClosures()
    rows = np.flatnonzero(c.time_s <= timeline.epoch_time_s[-1])
    first, second = (np.searchsorted(timeline.epoch_time_s, t[rows]) for t in (c.from_s, c.to_s))
    return LoopClosures(first, second, c.displacement[rows], c.covariance[rows])


def position_rows(timeline: Timeline, positions: Positions | None) -> PositionRows:
    """Of the positions that the timeline has."""
    if positions is None:
        none = np.zeros(0, dtype=np.intp)
        return PositionRows(none, np.zeros((0, 2)), np.zeros((0, 2, 2)), (0.0, 0.0))
    p, count = positions, len(timeline.position_epoch)
    return PositionRows(
        timeline.position_epoch, p.position_m[:count], p.covariance[:count], p.antenna_m
    )


def recorded_system_of(run: EkfRun) -> LinearProblem:
    """F1: one linear problem from the EKF's own recorded matrices."""
    return recorded(run.trace, _recorded_until(run))


def _recorded_until(run: EkfRun) -> Index:
    """Steps made at each of F1's poses: the run's, and where it used what is not of their time."""
    trace, until = run.trace, run.timeline.steps_until()
    records = (*trace.measurements.values(), *trace.initialisations.values(), trace.positions)
    return np.union1d(until, np.concatenate([record.step for record in records]))


def model_system_of(problem: SlamProblem, run: EkfRun) -> LinearProblem:
    """F2: the smoother's own factors, linearised where the EKF was."""
    return model_system(problem, _points(problem, run))


def model_steps(log: Log, problem: SlamProblem, run: EkfRun) -> LinearRelations | None:
    """Every prediction as the smoother's factors have it, linearised where the filter was.

    None where the filter's steps or states are not the log's, or a step alone has a singular
    covariance.
    """
    trace, timeline = run.trace, run.timeline
    count = len(timeline.control)
    if trace.departed.shape != (count, 3) or not timeline.control.size:
        return None
    steps = motion_samples(log, timeline)
    if (least_eigenvalues(steps.covariance) < LEAST_EIGENVALUE).any():
        return None
    single = replace(problem, increment=steps.displacement, increment_covariance=steps.covariance)
    return model_motion(single, trace.departed, trace.arrived)


def model_system_at(problem: SlamProblem, run: EkfRun, optimum: Estimate) -> LinearProblem:
    """The same factors in the same order, linearised at the smoother's estimate.

    optimum: with all pose landmarks by index, those that were merged with others, too.
    """
    places = _places(optimum.landmark, optimum.pose_landmarks)
    there = moved_to(_points(problem, run), problem, optimum.pose, places)
    return model_system(problem, there)


def _points(problem: SlamProblem, run: EkfRun) -> LinearisationPoints:
    trace = run.trace
    problem_row = np.cumsum(run.landmark_index >= 0) - 1  # of a log's measurement
    fix_row = np.zeros(int(run.fix_number.max(initial=-1)) + 1, dtype=np.intp)
    fix_row[run.fix_number] = np.arange(len(run.fix_number))
    seen = measurement_points(trace, lambda pose, step: _as_headings(run, pose, step))
    return LinearisationPoints(
        departed=run.departed,
        arrived=run.arrived,
        measurements=seen | {POINT: replace(seen[POINT], row=problem_row[seen[POINT].row])},
        merges=merge_points(trace),
        position=fix_row[trace.positions.number],
        position_weight=trace.positions.weight,
        position_pose=_as_headings(run, trace.positions.pose, trace.positions.step),
        own_axes=run.own_axes,
        position_entries=used_entries(trace.positions),
    )


def solve_recorded(linear: LinearProblem, run: EkfRun) -> Marginal:
    """F1's estimate of the last pose, as x, y, heading, and all landmarks."""
    final, estimate = run.final, run.estimate
    size = estimate.landmark.size + estimate.pose_landmarks.size
    own = np.vstack((run.trace.departed, final.own))[_recorded_until(run)]
    marginal = solve(linear, own, _places(estimate.landmark, run.pose_landmark_places))
    p = len(final.own)
    read = np.zeros((3 + size, p + size))
    read[:3, :p], read[3:, p:] = final.jacobian, np.eye(size)
    mean = np.concatenate((final.pose, marginal.mean[p:]))
    mean[:3] += final.jacobian @ (marginal.mean[:p] - final.own)
    return Marginal(mean, read @ marginal.covariance @ read.T)


def solve_model(linear: LinearProblem, run: EkfRun) -> Marginal:
    """F2's estimate of the last pose and all landmarks."""
    places = _places(run.estimate.landmark, run.pose_landmark_places)
    return solve(linear, run.departed, places)


def run_smoother(
    problem: SlamProblem,
    run: EkfRun,
    options: SmootherOptions,
    progress: Callable[[str], None] = lambda stage: None,
) -> SmootherEvidence:
    """The relinearised smoother, the EKF's estimate being one of its starts.

    Raises InputError for options that the problem does not allow.
    """
    return smooth_problem(
        problem, {"ekf": (run.departed, run.estimate.landmark)}, progress, options
    )


def smooth_problem(
    problem: SlamProblem,
    guesses: Mapping[str, tuple[Array, Array]],
    progress: Callable[[str], None],
    options: SmootherOptions,
) -> SmootherEvidence:
    """Call smooth; raise InputError for options that the problem does not allow."""
    try:
        return smooth(problem, guesses, progress, options)
    except ValueError as error:
        raise InputError(f"smoother: {error}") from None


def smoothed_estimate(
    result: SmootherEvidence,
    time_s: Array,
    landmark_id: NDArray[np.int64],
    association: str,
    labels: Mapping[int, str] | None = None,
) -> Estimate:
    """The smoother's result with its marginals, at times (K,), for landmarks with ids (L,).

    labels: names of these by id, where they have any.

    Of two pose landmarks that are one, the first stands for both.
    """
    pose_landmarks = result.pose_landmarks()
    kept = np.setdiff1d(np.arange(len(pose_landmarks)), result.problem.pose_landmarks.merges.second)
    layout = Layout.packed(3, len(result.landmarks), len(pose_landmarks))
    covariance, points = result.marginal().covariance, layout.columns(layout.present())
    rows = np.concatenate((points, layout.columns(kept, POSE)[3:]))
    return Estimate(
        time_s=time_s,
        pose=result.poses,
        pose_covariance=result.pose_covariances(),
        landmark_id=landmark_id,
        landmark=result.landmarks,
        joint_covariance=covariance[np.ix_(rows, rows)]
        if len(rows) < len(covariance)
        else covariance,
        information="fixed-lag" if result.lagged else "smoothed",
        provenance={"estimator": f"graphslam, {result.options.method}", "association": association},
        pose_landmark_id=kept,
        pose_landmarks=pose_landmarks[kept],
        labels=labels or {},
    )


def _places(points: Array, pose_landmarks: Array) -> dict[LandmarkKind, Array]:
    """Of each kind of landmarks."""
    return {POINT: points, POSE_LANDMARK: pose_landmarks}


def _as_headings(run: EkfRun, pose: Array, step: Index) -> Array:
    """Recorded poses (M, p) as x, y, heading, the heading near the one of its epoch."""
    if pose.shape[1] == 3:
        return pose
    epoch = np.searchsorted(run.timeline.steps_until(), step)
    heading, about = np.arctan2(pose[:, 3], pose[:, 2]), run.departed[epoch, 2]
    heading += 2.0 * np.pi * np.round((about - heading) / (2.0 * np.pi))
    return np.column_stack((pose[:, :2], heading))
