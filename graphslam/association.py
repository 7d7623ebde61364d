"""Who was seen, by the smoother's own reasoning, without a filter's help.

The log is read in pieces. What a piece sees is judged against the smoother's joint covariance of
the last pose and the whole map: a measurement is recognised when all likely joint hypotheses say
the same of it. What nothing in the map explains waits; seen often enough in one place, it becomes a
landmark. After each piece the smoother takes in what was decided. In the end landmarks that turn
out to be one are merged, everything is solved once more, the finished map judges all measurements
again, and rare landmarks are dropped.
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
    graph_of,
    measurement_factors,
    motion_factors,
    position_factors,
    prior_factor,
)
from graphslam.growing_smoother import GrowingSmoother
from graphslam.marginals import to_global
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

    landmark_index: (M,). values: of all variables, as smoothed, or where they start; `start` has
    the latter, which the smoother does not have yet, as it has not the measurements that are not
    `included` and the poses from `solved` on. running_estimate: at the last pose known, of the
    landmarks `around`. count: landmarks.
    """

    problem: SlamProblem
    options: Options
    order: Index
    landmark_index: Index
    running_estimate: RunningEstimate
    included: Mask
    smoother: GrowingSmoother
    values: gtsam.Values = field(default_factory=gtsam.Values)
    start: gtsam.Values = field(default_factory=gtsam.Values)
    around: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    known: int = 1
    solved: int = 0
    count: int = 0

    def insert(self, key: int, where: gtsam.Pose2 | Array) -> None:
        """Begin a variable."""
        self.values.insert(key, where)
        self.start.insert(key, where)

    def landmarks(self) -> Array:
        """(L, 2)."""
        return np.array(
            [self.values.atPoint2(LANDMARK_KEY + j) for j in range(self.count)]
        ).reshape(-1, 2)


def associate(problem: SlamProblem, options: Options | None = None) -> AssociationResult:
    """Decide for every measurement; the problem's measurement_landmark is not read."""
    draft = _Draft(
        problem=problem,
        options=options or Options(),
        order=np.argsort(problem.measurement_pose, kind="stable"),
        landmark_index=np.full(len(problem.z), UNSEEN, dtype=np.intp),
        running_estimate=RunningEstimate(problem.prior_pose, problem.prior_covariance),
        included=np.zeros(len(problem.z), dtype=bool),
        smoother=GrowingSmoother(),
    )
    draft.insert(POSE_KEY, gtsam.Pose2(*problem.prior_pose))
    _see(draft, 0)
    while draft.known < problem.pose_count:
        length = draft.options.piece if draft.solved else draft.options.first_piece
        end = min(draft.known + length, problem.pose_count)
        if draft.solved:
            _look_around(draft, end)
        for k in range(draft.known, end):
            draft.running_estimate.move(
                problem.increment[k - 1], problem.increment_covariance[k - 1]
            )
            _see(draft, k)
            draft.insert(POSE_KEY + k, gtsam.Pose2(*draft.running_estimate.pose))
        draft.known = end
        _promote(draft)
        draft.smoother.extend(_new_factors(draft), draft.start)
        draft.values, draft.start = gtsam.Values(draft.smoother.values), gtsam.Values()
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
        found = relocalise(draft.running_estimate, z, variance, draft.options)
        known = found >= 0
        found[known] = draft.around[found[known]]
        draft.landmark_index[rows] = found


def _look_around(draft: _Draft, end: int) -> None:
    """Take the running estimate from the smoother, of landmarks that poses before `end` may see."""
    p, key = draft.problem, POSE_KEY + draft.known - 1
    pose, landmarks = draft.values.atPose2(key), draft.landmarks()
    mean = np.array((pose.x(), pose.y(), pose.theta()))
    ahead = RunningEstimate(mean, to_global(draft.smoother.joint_covariance([key]), mean[2]))
    around = np.zeros(draft.count, dtype=bool)
    for k in range(draft.known, end):
        ahead.move(p.increment[k - 1], p.increment_covariance[k - 1])
        rows = _rows(draft, k)
        if len(rows):
            reach = 2.0 * ahead.reach_m(float(p.z[rows, 0].max()))
            around |= np.linalg.norm(landmarks - ahead.pose[:2], axis=1) <= reach
    draft.around = np.flatnonzero(around)
    local = draft.smoother.joint_covariance([key, *(LANDMARK_KEY + draft.around).tolist()])
    draft.running_estimate = RunningEstimate(
        np.concatenate((mean, landmarks[draft.around].ravel())), to_global(local, mean[2])
    )


def _new_factors(draft: _Draft) -> list[gtsam.NonlinearFactor]:
    """Factors of the poses from `solved` on and of recognised measurements not included yet."""
    p, first = draft.problem, draft.solved
    new: list[gtsam.NonlinearFactor] = [] if first else [prior_factor(POSE_KEY, p)]
    steps = np.arange(max(first, 1) - 1, draft.known - 1)
    departed = POSE_KEY + steps
    new += motion_factors(departed, departed + 1, p.increment[steps], p.increment_covariance[steps])
    rows = np.flatnonzero(
        (draft.landmark_index >= 0) & ~draft.included & (p.measurement_pose < draft.known)
    )
    draft.included[rows] = True
    poses, landmarks = (
        POSE_KEY + p.measurement_pose[rows],
        LANDMARK_KEY + draft.landmark_index[rows],
    )
    new += measurement_factors(poses, landmarks, p.z[rows], p.sigma[rows])
    fixes = np.flatnonzero((p.position_pose >= first) & (p.position_pose < draft.known))
    new += position_factors(p, fixes)
    draft.solved = draft.known
    return new


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
        draft.insert(LANDMARK_KEY + draft.count, centre)
        draft.count += 1


def _finish(draft: _Draft) -> AssociationResult:
    """Merge, solve, judge all measurements once more, drop what is rare, number."""
    _merge(draft)
    poses, landmarks = _solution(draft)
    _judge_again(draft, poses, landmarks)
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
    return AssociationResult(landmark_index, len(numbers), poses, landmarks[numbers])


def _merge(draft: _Draft) -> None:
    """Join landmarks within the resolution of each other that are statistically the same."""
    o, landmarks = draft.options, draft.landmarks()
    apart = np.linalg.norm(landmarks[:, None] - landmarks[None], axis=2)
    pairs = np.argwhere(np.triu(apart < o.resolution_m, k=1))
    if not len(pairs):
        return
    close, place = np.unique(pairs, return_inverse=True)
    p = draft.smoother.joint_covariance((LANDMARK_KEY + close).tolist())
    group = np.arange(draft.count)
    for (i, j), (first, second) in zip(pairs.tolist(), 2 * place.reshape(pairs.shape), strict=True):
        a, b = slice(first, first + 2), slice(second, second + 2)
        s = p[a, a] + p[b, b] - p[a, b] - p[b, a] + (o.resolution_m**2 / 8.0) * np.eye(2)
        d = landmarks[i] - landmarks[j]
        if float(d @ np.linalg.solve(s, d)) < o.gate:
            group[group == group[j]] = group[i]
    kept, renumber = np.unique(group, return_inverse=True)
    used = draft.landmark_index >= 0
    draft.landmark_index[used] = renumber[draft.landmark_index[used]]
    for landmark_index in range(draft.count):
        draft.values.erase(LANDMARK_KEY + landmark_index)
    for landmark_index, old in enumerate(kept.tolist()):
        draft.values.insert(LANDMARK_KEY + landmark_index, landmarks[old])
    draft.count = len(kept)


def _solution(draft: _Draft) -> tuple[Array, Array]:
    """Poses (K, 3) and landmarks (L, 2) of the optimum of all that is decided."""
    draft.solved, draft.included[:] = 0, False
    graph = graph_of(_new_factors(draft))
    values, *_ = levenberg_marquardt(graph, draft.values, 1e-4, limit=5)
    return from_values(values, replace(draft.problem, landmark_count=draft.count))


def _judge_again(draft: _Draft, poses: Array, landmarks: Array) -> None:
    """Nearest landmark of every measurement in the finished map, when no other comes near.

    By the measurements' own noise: pose and map, being solved together, err alike.
    """
    o, p = draft.options, draft.problem
    if not draft.count:
        return
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
