"""Batch smoothing: Levenberg-Marquardt from several starts, the lowest kept and examined."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from graphslam.graph_builder import (
    LANDMARK_KEY,
    POSE_KEY,
    SlamProblem,
    build_graph,
    from_values,
    to_values,
)
from graphslam.marginals import (
    Marginal,
    SingularProblemError,
    eliminate,
    last_pose_and_landmarks,
    pose_covariances,
    to_global,
)
from graphslam.optimum import Proof, Stationarity, chi_square_test, stationarity

Array = NDArray[np.float64]

AGREEMENT = 1e-6
"""Starts agree when their errors differ by less than this, relative to 1 + error."""
GROWTH = 1.3
"""Each prefix of the incremental start is this much longer than the one before."""


@dataclass(frozen=True)
class Start:
    """One attempt: where it began and where Levenberg-Marquardt ended."""

    name: str
    error: float
    iterations: int
    converged: bool


@dataclass(frozen=True)
class SmootherResult:
    """The lowest of all attempts with its evidence.

    poses: (K, 3), headings unwrapped. landmarks: (L, 2). error: half the squared norm of the
    whitened residuals. values, graph: the gtsam objects, for marginals.
    """

    poses: Array
    landmarks: Array
    error: float
    iterations: int
    converged: bool
    starts: tuple[Start, ...]
    proof: Proof
    values: gtsam.Values
    graph: gtsam.NonlinearFactorGraph

    def marginal(self) -> Marginal:
        """Last pose and all landmarks jointly: mean and covariance, additive global error."""
        mean = np.concatenate((self.poses[-1], self.landmarks.ravel()))
        local = last_pose_and_landmarks(
            self.graph.linearize(self.values), len(self.poses), len(self.landmarks)
        )
        return Marginal(mean, to_global(local.covariance, self.poses[-1, 2]))

    def pose_covariances(self) -> Array:
        """Covariance (K, 3, 3) of every pose, given all measurements; additive global error."""
        return pose_covariances(self.graph, self.values, self.poses[:, 2])


def smooth(
    problem: SlamProblem,
    guesses: Mapping[str, tuple[Array, Array]],
    progress: Callable[[str], None] = lambda stage: None,
) -> SmootherResult:
    """Find the optimum of a problem.

    guesses: other estimators' poses (K, 3) and landmarks (L, 2) by name, tried first. Then comes
    the incremental start, which needs no guess, and dead reckoning when the proof is still open.
    Raises SingularProblemError when every attempt fails for want of information.
    """
    graph = build_graph(problem)
    seen = np.union1d(problem.sighting_landmark, np.arange(len(problem.surveyed)))
    attempts: list[tuple[Start, gtsam.Values]] = []

    def attempt(name: str, values: gtsam.Values, spent: int = 0) -> None:
        progress(f"smoother, start {name}")
        try:
            end, _, iterations, converged = _optimise(graph, values)
            end, error = _polish(graph, end)
        except RuntimeError:  # gtsam's indeterminate linear system
            attempts.append((Start(name, float("inf"), spent, converged=False), values))
            return
        attempts.append((Start(name, error, spent + iterations, converged), end))

    for name, (poses, landmarks) in guesses.items():
        attempt(name, to_values(poses, landmarks, seen))
    progress("smoother, growing prefixes")
    attempt("incremental", *_incremental(problem))
    proof = _prove(problem, graph, attempts)
    if not proof.proven:
        attempt("dead-reckoning", _extend(problem, gtsam.Values(), 0, problem.pose_count))
        proof = _prove(problem, graph, attempts)
    best, values = min(attempts, key=lambda a: a[0].error)
    if not np.isfinite(best.error):
        raise SingularProblemError("the measurements do not fix every pose and landmark")
    poses, landmarks = from_values(values, problem)
    return SmootherResult(
        poses,
        landmarks,
        best.error,
        best.iterations,
        best.converged,
        tuple(start for start, _ in attempts),
        proof,
        values,
        graph,
    )


def _prove(
    problem: SlamProblem,
    graph: gtsam.NonlinearFactorGraph,
    attempts: list[tuple[Start, gtsam.Values]],
) -> Proof:
    best, values = min(attempts, key=lambda a: a[0].error)
    agreeing = tuple(
        start.name
        for start, _ in attempts
        if start.error - best.error <= AGREEMENT * (1.0 + best.error)
    )
    dof = problem.residual_dimension - problem.state_dimension
    conditions = (
        stationarity(graph, values)
        if np.isfinite(best.error)
        else Stationarity(float("nan"), definite=False)
    )
    return Proof(conditions, chi_square_test(best.error, dof), agreeing)


def _optimise(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    relative_tolerance: float = 1e-12,
    limit: int = 100,
) -> tuple[gtsam.Values, float, int, bool]:
    """Levenberg-Marquardt; returns the end, its error, iterations, and whether it converged.

    By Cholesky, and by the slower QR where that breaks down on an ill-conditioned problem.
    Raises RuntimeError when both do.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(limit)
    parameters.setRelativeErrorTol(relative_tolerance)
    parameters.setAbsoluteErrorTol(1e-9)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    try:
        end = optimiser.optimize()
    except RuntimeError:
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        end = optimiser.optimize()
    iterations = optimiser.iterations()
    return end, optimiser.error(), iterations, iterations < limit


def _polish(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> tuple[gtsam.Values, float]:
    """Gauss-Newton by QR for as long as it lowers the error; LM's Cholesky stops short of that."""
    error = graph.error(values)
    for _ in range(10):
        step = eliminate(graph.linearize(values)).optimize()
        nearer = values.retract(step)
        lower = graph.error(nearer)
        if not lower < error:
            break
        gain, values, error = error - lower, nearer, lower
        if gain < 1e-12 * (1.0 + error):
            break
    return values, error


def _incremental(problem: SlamProblem) -> tuple[gtsam.Values, int]:
    """Values from growing prefixes of the log, each solved before the next is dead reckoned on.

    Drift never gets far before the sightings correct it, so the path stays in the basin of the
    optimum where dead reckoning over the whole log would not. Returns values and iterations.
    """
    values = gtsam.Values()
    known, iterations = 0, 0
    count = min(50, problem.pose_count)
    while True:
        values = _extend(problem, values, known, count)
        if count == problem.pose_count:
            return values, iterations
        graph = build_graph(problem.prefix(count))
        try:
            values, _, spent, _ = _optimise(graph, values, relative_tolerance=1e-4, limit=20)
        except RuntimeError:
            spent = 0
        iterations += spent
        known, count = count, min(int(GROWTH * count) + 1, problem.pose_count)


def _extend(problem: SlamProblem, values: gtsam.Values, known: int, count: int) -> gtsam.Values:
    """Add poses `known` to `count` - 1 by dead reckoning, landmarks where first seen."""
    extended = gtsam.Values(values)
    if known:
        pose = values.atPose2(POSE_KEY + known - 1)
    else:
        pose = gtsam.Pose2(*problem.prior_pose)
        extended.insert(POSE_KEY, pose)
        for slot, place in enumerate(problem.surveyed):
            extended.insert(LANDMARK_KEY + slot, place)
    poses = {known - 1: pose} if known else {0: pose}
    for k in range(max(known, 1), count):
        pose = pose.compose(gtsam.Pose2(*problem.increment[k - 1]))
        extended.insert(POSE_KEY + k, pose)
        poses[k] = pose
    fresh = (problem.sighting_pose >= known) & (problem.sighting_pose < count)
    for row in np.flatnonzero(fresh).tolist():
        key = LANDMARK_KEY + int(problem.sighting_landmark[row])
        if not extended.exists(key):
            r, bearing = problem.z[row]
            place = np.array([r * np.cos(bearing), r * np.sin(bearing)])
            extended.insert(key, poses[int(problem.sighting_pose[row])].transformFrom(place))
    return extended
