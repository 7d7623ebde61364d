"""Who was seen, by the smoother's own reasoning, without a filter's help.

The log is read in pieces. What a piece sees is judged against the smoother's joint covariance of
the last pose and the whole map: a measurement is recognised when all likely joint hypotheses say
the same of it. What nothing in the map explains waits; seen often enough in one place, it becomes a
landmark. After each piece everything is solved anew. In the end the finished map judges all
measurements once more, landmarks that turn out to be one are merged, and rare ones are dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from graphslam.arrays import Array, Index, Mask
from graphslam.graph_builder import (
    LANDMARK_KEY,
    POSE_KEY,
    from_values,
    increment_factors,
    measurement_factors,
    position_factor,
    prior_factor,
)
from graphslam.marginals import joint_marginal, to_global
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem
from graphslam.relocalisation import PENDING, UNSEEN, Options, extent, relocalise
from graphslam.running_estimate import RunningEstimate, wrapped


@dataclass(frozen=True)
class AssociationResult:
    """landmark_index: (M,) of each measurement, by first measurement, negative where unused.

    poses: (K, 3) and landmarks: (L, 2), where the association left them: a start for smoothing.
    """

    landmark_index: Index
    landmark_count: int
    poses: Array
    landmarks: Array


@dataclass(kw_only=True)
class _Draft:
    """What is decided so far.

    landmark_index: (M,). values, graph: the smoother's, up to pose `solved`, with the measurements
    `included`. running_estimate: at the last pose known. count: landmarks.
    """

    problem: SlamProblem
    options: Options
    order: Index
    landmark_index: Index
    values: gtsam.Values
    running_estimate: RunningEstimate
    included: Mask
    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    known: int = 1
    solved: int = 0
    count: int = 0

    def solution(self) -> tuple[Array, Array]:
        """Poses (K, 3) known so far and landmarks (L, 2)."""
        p = self.problem
        known = replace(p, increment=p.increment[: self.known - 1], landmark_count=self.count)
        return from_values(self.values, known)


def associate(problem: SlamProblem, options: Options | None = None) -> AssociationResult:
    """Decide for every measurement; the problem's measurement_landmark is not read."""
    options = options or Options()
    values = gtsam.Values()
    values.insert(POSE_KEY, gtsam.Pose2(*problem.prior_pose))
    draft = _Draft(
        problem=problem,
        options=options,
        order=np.argsort(problem.measurement_pose, kind="stable"),
        landmark_index=np.full(len(problem.z), UNSEEN, dtype=np.intp),
        values=values,
        running_estimate=RunningEstimate(problem.prior_pose, problem.prior_covariance),
        included=np.zeros(len(problem.z), dtype=bool),
    )
    _see(draft, 0)
    while draft.known < problem.pose_count:
        length = options.piece if draft.solved else options.first_piece
        end = min(draft.known + length, problem.pose_count)
        for k in range(draft.known, end):
            draft.running_estimate.move(
                problem.increment[k - 1], problem.increment_covariance[k - 1]
            )
            _see(draft, k)
            draft.values.insert(POSE_KEY + k, gtsam.Pose2(*draft.running_estimate.pose))
        draft.known = end
        _promote(draft)
        _solve(draft)
    return _finish(draft)


def _rows(draft: _Draft, pose: int) -> Index:
    """Measurements from a pose."""
    seen = draft.problem.measurement_pose
    first = np.searchsorted(seen, pose, side="left", sorter=draft.order)
    last = np.searchsorted(seen, pose, side="right", sorter=draft.order)
    return draft.order[first:last]


def _see(draft: _Draft, pose: int) -> None:
    """Judge the measurements from a pose, and narrow the running estimate by what is recognised."""
    rows = _rows(draft, pose)
    if len(rows):
        z, variance = draft.problem.z[rows], draft.problem.sigma[rows] ** 2
        draft.landmark_index[rows] = relocalise(draft.running_estimate, z, variance, draft.options)


def _solve(draft: _Draft) -> None:
    """Optimise everything known, and take the running estimate from it."""
    _extend_graph(draft)
    draft.values, *_ = levenberg_marquardt(draft.graph, draft.values, 1e-4, limit=5)
    poses, landmarks = draft.solution()
    keys = [POSE_KEY + draft.known - 1, *range(LANDMARK_KEY, LANDMARK_KEY + draft.count)]
    local = joint_marginal(draft.graph.linearize(draft.values), keys, 3 + 2 * draft.count)
    mean = np.concatenate((poses[-1], landmarks.ravel()))
    draft.running_estimate = RunningEstimate(mean, to_global(local.covariance, poses[-1, 2]))


def _extend_graph(draft: _Draft) -> None:
    """Factors of the poses and of the recognised measurements that the graph does not have yet."""
    p, graph, first = draft.problem, draft.graph, draft.solved
    if not graph.size():
        graph.push_back(prior_factor(POSE_KEY, p))
    moves = slice(max(first, 1) - 1, draft.known - 1)
    step = replace(
        p, increment=p.increment[moves], increment_covariance=p.increment_covariance[moves]
    )
    departures = list(range(POSE_KEY + moves.start, POSE_KEY + moves.stop))
    new: list[gtsam.NonlinearFactor] = list(
        increment_factors(departures, [key + 1 for key in departures], step)
    )
    rows = np.flatnonzero(
        (draft.landmark_index >= 0) & ~draft.included & (p.measurement_pose < draft.known)
    )
    draft.included[rows] = True
    seen = replace(p, z=p.z[rows], sigma=p.sigma[rows])
    poses = (POSE_KEY + p.measurement_pose[rows]).tolist()
    new += measurement_factors(poses, (LANDMARK_KEY + draft.landmark_index[rows]).tolist(), seen)
    fixes = np.flatnonzero((p.position_pose >= first) & (p.position_pose < draft.known))
    new += [
        position_factor(
            POSE_KEY + int(p.position_pose[i]), p.position[i], p.position_covariance[i], p.lever_m
        )
        for i in fixes.tolist()
    ]
    for factor in new:
        graph.push_back(factor)
    draft.solved = draft.known


def _places(draft: _Draft, rows: Index) -> Array:
    """(m, 2) where measurements are in the smoothed frame."""
    p = draft.problem
    result = np.empty((len(rows), 2))
    for i, row in enumerate(rows.tolist()):
        pose = draft.values.atPose2(POSE_KEY + int(p.measurement_pose[row]))
        r, bearing = p.z[row]
        result[i] = pose.transformFrom(np.array([r * np.cos(bearing), r * np.sin(bearing)]))
    return result


def _promote(draft: _Draft) -> None:
    """Make landmarks of what is pending and seen often enough."""
    o, p = draft.options, draft.problem
    old = draft.known - 3 * o.piece
    draft.landmark_index[(draft.landmark_index == PENDING) & (p.measurement_pose < old)] = UNSEEN
    rows = np.flatnonzero((draft.landmark_index == PENDING) & (p.measurement_pose < draft.known))
    if len(rows) < o.measurements:
        return
    places = _places(draft, rows)
    cluster = fcluster(linkage(places, "average"), o.resolution_m, "distance")
    for number in np.unique(cluster).tolist():
        inside = cluster == number
        centre = places[inside].mean(axis=0)
        spread = float(np.sqrt(np.mean(np.sum((places[inside] - centre) ** 2, axis=1))))
        instants = len(np.unique(p.measurement_pose[rows[inside]]))
        if instants < o.measurements or spread > o.spread_m:
            continue
        draft.landmark_index[rows[inside]] = draft.count
        draft.values.insert(LANDMARK_KEY + draft.count, centre)
        draft.count += 1


def _finish(draft: _Draft) -> AssociationResult:
    """Merge, judge all measurements once more by the finished map, drop what is rare, number."""
    _merge(draft)
    _judge_again(draft)
    counts = np.bincount(draft.landmark_index[draft.landmark_index >= 0], minlength=draft.count)
    rare = np.flatnonzero(counts < draft.options.measurements)
    draft.landmark_index[np.isin(draft.landmark_index, rare)] = UNSEEN
    used = draft.order[draft.landmark_index[draft.order] >= 0]
    _, first = np.unique(draft.landmark_index[used], return_index=True)
    numbers = draft.landmark_index[used][np.sort(first)]
    renumber = np.empty(draft.count, dtype=np.intp)
    renumber[numbers] = np.arange(len(numbers))
    landmark_index = np.full(len(draft.landmark_index), UNSEEN, dtype=np.intp)
    landmark_index[used] = renumber[draft.landmark_index[used]]
    poses, landmarks = draft.solution()
    return AssociationResult(landmark_index, len(numbers), poses, landmarks[numbers])


def _merge(draft: _Draft) -> None:
    """Join landmarks within the resolution of each other that are statistically the same."""
    if draft.count < 2:
        return
    o, running_estimate = draft.options, draft.running_estimate
    group = np.arange(draft.count)
    apart = np.linalg.norm(
        running_estimate.landmarks[:, None] - running_estimate.landmarks[None], axis=2
    )
    for i, j in np.argwhere(np.triu(apart < o.resolution_m, k=1)).tolist():
        a, b = slice(3 + 2 * i, 5 + 2 * i), slice(3 + 2 * j, 5 + 2 * j)
        p = running_estimate.covariance
        s = p[a, a] + p[b, b] - p[a, b] - p[b, a] + (o.resolution_m**2 / 8.0) * np.eye(2)
        d = running_estimate.landmarks[i] - running_estimate.landmarks[j]
        if float(d @ np.linalg.solve(s, d)) < o.gate:
            group[group == group[j]] = group[i]
    kept, renumber = np.unique(group, return_inverse=True)
    if len(kept) == draft.count:
        return
    used = draft.landmark_index >= 0
    draft.landmark_index[used] = renumber[draft.landmark_index[used]]
    for landmark_index in range(draft.count):
        draft.values.erase(LANDMARK_KEY + landmark_index)
    for landmark_index, old in enumerate(kept.tolist()):
        draft.values.insert(LANDMARK_KEY + landmark_index, running_estimate.landmarks[old])
    draft.count, draft.solved = len(kept), 0
    draft.graph, draft.included[:] = gtsam.NonlinearFactorGraph(), False
    _solve(draft)


def _judge_again(draft: _Draft) -> None:
    """Nearest landmark of every measurement in the finished map, when no other comes near.

    By the measurements' own noise: pose and map, being solved together, err alike.
    """
    o, p = draft.options, draft.problem
    if not draft.count:
        return
    poses, landmarks = draft.solution()
    for pose in np.unique(p.measurement_pose).tolist():
        rows = _rows(draft, pose)
        at = RunningEstimate(np.concatenate((poses[pose], landmarks.ravel())), np.zeros((0, 0)))
        near = at.near(float(p.z[rows, 0].max()) + 5.0)
        draft.landmark_index[rows] = UNSEEN
        if not len(near):
            continue
        nu = wrapped(p.z[rows][:, None] - at.expect(near).z[None])
        noise = p.sigma[rows] ** 2 + extent(p.z[rows], o)
        nis = np.sum(nu**2 / noise[:, None], axis=2)
        best = nis.argmin(axis=1)
        least = nis[np.arange(len(rows)), best]
        nis[np.arange(len(rows)), best] = np.inf
        sure = (least <= o.gate) & (nis.min(axis=1) - least > 2.0 * math.log(o.odds))
        draft.landmark_index[rows[sure]] = near[best[sure]]
