"""Starting values that lead to the optimum, from nothing but the measurements.

Dead reckoning over a whole log ends far from the truth, and an optimiser started there in a local
minimum. So the log is taken in pieces: each is dead reckoned on, fitted against the map so far as
if that were right, and everything is solved together whenever a piece does not fit, which is where
a loop closes, or when the log has grown by half.
"""

from __future__ import annotations

import gtsam
import numpy as np

from graphslam.graph_builder import LANDMARK_KEY, POSE_KEY, POSE_LANDMARK_KEY, pieces
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem

PIECE = 100
"""Poses that are dead reckoned at once."""
MISFIT = 3.0
"""A piece does not fit when its error per observation exceeds the map's by this factor."""
GROWTH = 1.5
"""Everything is solved together at the latest when the log has grown by this factor."""
_POINT = gtsam.symbolChr(LANDMARK_KEY)
_HELD_POSE = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
_HELD_POINT = gtsam.noiseModel.Isotropic.Sigma(2, 1e-2)


def track(problem: SlamProblem, graph: gtsam.NonlinearFactorGraph) -> tuple[gtsam.Values, int]:
    """Values for all poses and seen landmarks, and the iterations spent.

    graph: build_graph(problem), whose factors are used again for every piece.
    """
    piece_of = pieces(problem, graph)
    values, prefix = gtsam.Values(), gtsam.NonlinearFactorGraph()
    known, solved, iterations, usual = 0, 0, 0, 1.0
    while known < problem.pose_count:
        end = min(known + PIECE, problem.pose_count)
        piece = piece_of(known, end)
        prefix.push_back(piece)
        new = extension(problem, values, known, end)
        new, misfit, spent = _fit(piece, values, new)
        iterations += spent
        values.insert(new)
        known = end
        observations = max(1, piece.size() - PIECE)
        if misfit > MISFIT * usual * observations or known > GROWTH * solved:
            try:
                values, spent, _ = levenberg_marquardt(prefix, values, 1e-3, limit=15)
            except RuntimeError:
                spent = 0
            iterations += spent
            solved = known
            usual = max(1.0, prefix.error(values) / max(1, prefix.size() - known))
    return values, iterations


def extension(problem: SlamProblem, values: gtsam.Values, known: int, count: int) -> gtsam.Values:
    """Poses `known` to `count` - 1 by dead reckoning, and landmarks where they first see them.

    values: poses up to `known` and landmarks seen from them; those are not in the result.
    """
    new, poses = gtsam.Values(), {}
    if known:
        pose = values.atPose2(POSE_KEY + known - 1)
    else:
        pose = gtsam.Pose2(*problem.prior_pose)
        new.insert(POSE_KEY, pose)
        poses[0] = pose
        for landmark_index, place in enumerate(problem.surveyed):
            new.insert(LANDMARK_KEY + landmark_index, place)
    for k in range(max(known, 1), count):
        pose = pose.compose(gtsam.Pose2(*problem.increment[k - 1]))
        new.insert(POSE_KEY + k, pose)
        poses[k] = pose
    seen = problem.pose_landmarks
    for row in np.flatnonzero((seen.pose >= known) & (seen.pose < count)).tolist():
        key = POSE_LANDMARK_KEY + int(seen.landmark[row])
        if not values.exists(key) and not new.exists(key):
            measured = gtsam.Pose2(*seen.measured[row])
            new.insert(key, poses[int(seen.pose[row])].compose(measured))
    fresh = np.flatnonzero((problem.measurement_pose >= known) & (problem.measurement_pose < count))
    for row in fresh[np.argsort(problem.measurement_pose[fresh], kind="stable")].tolist():
        key = LANDMARK_KEY + int(problem.measurement_landmark[row])
        if not values.exists(key) and not new.exists(key):
            r, bearing = problem.z[row]
            place = np.array([r * np.cos(bearing), r * np.sin(bearing)])
            new.insert(key, poses[int(problem.measurement_pose[row])].transformFrom(place))
    return new


def _fit(
    piece: gtsam.NonlinearFactorGraph, values: gtsam.Values, new: gtsam.Values
) -> tuple[gtsam.Values, float, int]:
    """The new values fitted to a piece, its error and the iterations spent.

    The pose before the piece and the landmarks that it sees again are held where they are.
    """
    start, graph = gtsam.Values(new), gtsam.NonlinearFactorGraph(piece)
    held = [key for key in piece.keyVector() if values.exists(key)]
    for key in held:
        if gtsam.symbolChr(key) != _POINT:
            pose = values.atPose2(key)
            start.insert(key, pose)
            graph.push_back(gtsam.PriorFactorPose2(key, pose, _HELD_POSE))
        else:
            point = values.atPoint2(key)
            start.insert(key, point)
            graph.push_back(gtsam.PriorFactorPoint2(key, point, _HELD_POINT))
    try:
        end, spent, _ = levenberg_marquardt(graph, start, 1e-3, limit=10)
    except RuntimeError:
        return new, float("inf"), 0
    error = graph.error(end)
    for key in held:
        end.erase(key)
    return end, error, spent
