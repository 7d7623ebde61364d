"""Smoothing along the way: iSAM2 over the whole past, or over a fixed lag."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, SupportsFloat, SupportsIndex, SupportsInt

import gtsam
import numpy as np

from graphslam.arrays import Array, Marginal
from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, graph_of, pieces, to_tangent, unwrap
from graphslam.initialisation import extension
from graphslam.layout import Layout
from graphslam.marginals import joint_marginal, to_global
from graphslam.problem import SlamProblem

RELINEARISE = 0.1
"""A variable is linearised anew when it has moved by this much [m or rad] ..."""
RELINEARISE_EVERY = 10
"""... which is looked at in every so many updates, and always at the end."""


@dataclass(frozen=True)
class IncrementalEnd:
    """What an incremental smoother leaves."""

    values: gtsam.Values
    updates: int


@dataclass(frozen=True, kw_only=True)
class LagEnd:
    """What a fixed-lag smoother leaves.

    poses: (K, 3) as they were when they left the lag, headings unwrapped; pose_covariance:
    (K, 3, 3) then. landmarks: (L, 2) points. pose_landmarks: (Q, 3). marginal: last pose, points
    and pose landmarks at the end. All of the additive global error.
    """

    poses: Array
    pose_covariance: Array
    landmarks: Array
    pose_landmarks: Array
    marginal: Marginal
    updates: int


POSE, _POINT = gtsam.symbolChr(POSE_KEY), gtsam.symbolChr(LANDMARK_KEY)


class _Piece(NamedTuple):
    """What one update adds. end: number of poses then."""

    end: int
    graph: gtsam.NonlinearFactorGraph
    new: gtsam.Values


def _pieces(
    problem: SlamProblem,
    graph: gtsam.NonlinearFactorGraph,
    pose_at: Callable[[int], gtsam.Pose2],
    stops: Sequence[int] = (),
) -> Iterator[_Piece]:
    """One piece for every pose with observations, at `stops` (poses) and at the end.

    pose_at: where the smoother has the pose of a key now.
    """
    piece_of = pieces(problem, graph)
    ends = np.unique(
        np.concatenate(
            (
                problem.measurement_pose,
                problem.position_pose,
                problem.loop_closures.last,
                stops,
                [problem.pose_count - 1],
            )
        )
    ).astype(np.intp)
    known, done = gtsam.Values(), 0
    for end in (ends + 1).tolist():
        if done:
            known.update(POSE_KEY + done - 1, pose_at(POSE_KEY + done - 1))
        new = extension(problem, known, done, end)
        yield _Piece(end, piece_of(done, end), new)
        known.insert(new)
        done = end


def run_isam2(problem: SlamProblem, graph: gtsam.NonlinearFactorGraph) -> IncrementalEnd:
    """iSAM2, one update per pose with observations. graph: build_graph(problem).

    By QR, as odometry is often exact enough to make Cholesky break down. At the end everything is
    linearised anew until the error stays; iSAM2 by itself stops at its thresholds, up to a sigma
    away.
    """
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(RELINEARISE)
    parameters.relinearizeSkip = RELINEARISE_EVERY
    parameters.setFactorization("QR")
    isam, updates = gtsam.ISAM2(parameters), 0
    for piece in _pieces(problem, graph, isam.calculateEstimatePose2):
        isam.update(piece.graph, piece.new)
        updates += 1
    return IncrementalEnd(_settled(isam), updates)


def _settled(isam: gtsam.ISAM2) -> gtsam.Values:
    """The estimate after linearising everything anew, for as long as that lowers the error."""
    settings = gtsam.ISAM2UpdateParams()
    settings.forceFullSolve = settings.force_relinearize = True
    factors = isam.getFactorsUnsafe()
    values = isam.calculateEstimate()
    error = factors.error(values)
    for _ in range(10):
        isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), settings)
        values = isam.calculateEstimate()
        lower = factors.error(values)
        if not error - lower > 1e-9 * (1.0 + error):
            break
        error = lower
    return values


def run_fixed_lag(problem: SlamProblem, graph: gtsam.NonlinearFactorGraph, lag: int) -> LagEnd:
    """Poses leave after `lag` more poses, for good; landmarks stay. graph: build_graph(problem).

    What left is summed up in a linear prior at the values of then, so that errors of linearisation
    stay in: the result is no optimum, and `smooth` says how far it is from it.
    """
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(RELINEARISE)
    parameters.relinearizeSkip = 1
    parameters.setFactorization("QR")
    parameters.findUnusedFactorSlots = True
    smoother = gtsam.IncrementalFixedLagSmoother(float(lag), parameters)
    count = problem.pose_count
    poses, covariance = np.empty((count, 3)), np.empty((count, 3, 3))
    landmarks: list[int] = []
    left, updates = 0, 0

    def leave(until: int) -> None:
        for k in range(left, until):
            pose = smoother.calculateEstimatePose2(POSE_KEY + k)
            poses[k] = pose.x(), pose.y(), pose.theta()
            covariance[k] = smoother.marginalCovariance(POSE_KEY + k)

    # A stretch without observations must not be longer than what is held.
    known = np.unique(
        np.concatenate((problem.measurement_pose, problem.position_pose, [0, count - 1]))
    )
    stops = [
        stop
        for first, last in zip(known[:-1].tolist(), known[1:].tolist(), strict=True)
        for stop in range(first + lag, last, lag)
    ]
    for piece in _pieces(problem, graph, smoother.calculateEstimatePose2, stops):
        leave(piece.end - lag - 1)  # these the update is going to drop
        left = max(left, piece.end - lag - 1)
        added = list(piece.new.keys())
        stamps: dict[SupportsInt | SupportsIndex, SupportsFloat | SupportsIndex] = {
            key: float(key - POSE_KEY) for key in added if gtsam.symbolChr(key) == POSE
        }
        landmarks += [key for key in added if key not in stamps]
        stamps.update(dict.fromkeys(landmarks, float(piece.end - 1)))
        smoother.update(piece.graph, piece.new, stamps)
        updates += 1
    leave(count)
    unwrap(poses, problem)
    turn = to_tangent(poses[:, 2]).transpose(0, 2, 1)
    remaining = smoother.getFactors()
    held = filter(remaining.exists, range(remaining.size()))
    factors = graph_of(map(remaining.at, held))
    seen = sorted(key for key in landmarks if gtsam.symbolChr(key) == _POINT)
    turned = sorted(set(landmarks) - set(seen))
    places = np.full((problem.landmark_count, 2), np.nan)
    for key in seen:
        places[key - LANDMARK_KEY] = smoother.calculateEstimatePoint2(key)
    frames = [smoother.calculateEstimatePose2(key) for key in turned]
    pose_landmarks = np.array([(at.x(), at.y(), at.theta()) for at in frames]).reshape(-1, 3)
    linear = factors.linearize(smoother.getLinearizationPoint())
    kept = [POSE_KEY + count - 1, *seen, *turned]
    local = joint_marginal(linear, kept, Layout(1, len(seen), len(turned)).size)
    landmark_indices = np.array(seen, dtype=np.int64) - LANDMARK_KEY
    mean = np.concatenate((poses[-1], places[landmark_indices].ravel(), pose_landmarks.ravel()))
    return LagEnd(
        poses=poses,
        pose_covariance=turn @ covariance @ turn.transpose(0, 2, 1),
        landmarks=places,
        pose_landmarks=pose_landmarks,
        marginal=Marginal(mean, to_global(local.covariance, poses[-1, 2], pose_landmarks[:, 2])),
        updates=updates,
    )
