"""The smoother: the optimum of a whole log, from several starts, with the evidence for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from graphslam.arrays import Array
from graphslam.graph_builder import (
    KERNELS,
    LANDMARK_KEY,
    POSE_KEY,
    POSE_LANDMARK_KEY,
    build_graph,
    from_values,
    oriented_from,
    to_values,
)
from graphslam.incremental import LagEnd, run_fixed_lag, run_isam2
from graphslam.initialisation import extension, track
from graphslam.marginals import (
    Marginal,
    SingularProblemError,
    joint_marginal,
    last_pose_and_landmarks,
    pose_covariances,
    to_global,
    turned,
)
from graphslam.optimisers import OPTIMISERS, optimise, polish
from graphslam.optimum import Optimality, Stationarity, chi_square_test, stationarity
from graphslam.problem import SlamProblem
from graphslam.robust import NOTHING_REJECTED, Rejected, reject_wild
from graphslam.singular import explain_singularity

AGREEMENT = 1e-6
"""Starts agree when their errors differ by less than this, relative to 1 + error."""
METHODS = ("batch", "isam2", "fixed-lag")
ROBUST = (*KERNELS, "gnc")


@dataclass(frozen=True)
class SmootherOptions:
    """What a user may choose.

    method: of METHODS. lag: poses that a fixed lag holds. optimiser: of the batch, one of
    OPTIMISERS. robust: against wild sightings and positions, one of ROBUST; it changes marginals.
    """

    method: str = "batch"
    lag: int = 100
    optimiser: str = OPTIMISERS[0]
    robust: str = "none"

    @property
    def kernel(self) -> str:
        """The kernel that stays in the graph, of KERNELS."""
        return self.robust if self.robust in KERNELS else "none"

    def __post_init__(self) -> None:
        """Check the choices. Raises ValueError."""
        for name, value, known in (
            ("method", self.method, METHODS),
            ("optimiser", self.optimiser, OPTIMISERS),
            ("robust", self.robust, ROBUST),
        ):
            if value not in known:
                raise ValueError(f"{name} is '{value}', expected one of {', '.join(known)}")
        if self.lag < 1:
            raise ValueError(f"lag is {self.lag}, expected at least 1")


@dataclass(frozen=True)
class Start:
    """One attempt: where it began and where the optimiser ended."""

    name: str
    error: float
    iterations: int
    converged: bool


@dataclass(frozen=True, kw_only=True)
class SmootherResult:
    """The estimate asked for, and the evidence from the lowest of all attempts.

    poses: (K, 3), headings unwrapped. landmarks: (L, 2). error: half the squared norm of the
    whitened residuals at the optimum. problem: what was solved, without `rejected`, the wild
    observations that were left out; those are numbered as in the problem given. values, graph:
    the gtsam objects of the optimum, for marginals. lagged: what a fixed-lag smoother said; its
    poses and landmarks are then the result's.
    """

    options: SmootherOptions
    problem: SlamProblem
    poses: Array
    landmarks: Array
    error: float
    iterations: int
    converged: bool
    starts: tuple[Start, ...]
    optimality: Optimality
    rejected: Rejected
    values: gtsam.Values
    graph: gtsam.NonlinearFactorGraph
    lagged: LagEnd | None = None

    @property
    def rank(self) -> int:
        """Unknowns that the measurements determine; a result is only had when they all are."""
        return int(self.values.dim())

    def oriented(self) -> Array:
        """(Q, 3) oriented landmarks: x, y, heading."""
        if self.lagged is not None:
            return self.lagged.oriented
        return oriented_from(self.values, self.problem)

    def joint(
        self, poses: Sequence[int], landmarks: Sequence[int], oriented: Sequence[int] = ()
    ) -> Array:
        """Joint covariance (n, n) of any poses, points and oriented landmarks, in this order.

        Of the additive global error, at the optimum; n is 3 P + 2 L + 3 Q.
        """
        frames = [POSE_KEY + k for k in poses], [POSE_LANDMARK_KEY + j for j in oriented]
        keys = frames[0] + [LANDMARK_KEY + j for j in landmarks] + frames[1]
        second = 3 * len(poses) + 2 * len(landmarks)
        size = second + 3 * len(oriented)
        local = joint_marginal(self.graph.linearize(self.values), keys, size).covariance
        headings = [
            np.array([self.values.atPose2(key).theta() for key in group]) for group in frames
        ]
        return turned(local, (0, headings[0]), (second, headings[1]))

    def marginal(self) -> Marginal:
        """Last pose and all landmarks jointly: mean and covariance, additive global error.

        Oriented landmarks come last; their headings are as gtsam has them, wrapped.
        """
        if self.lagged is not None:
            return self.lagged.marginal
        oriented = self.oriented()
        mean = np.concatenate((self.poses[-1], self.landmarks.ravel(), oriented.ravel()))
        local = last_pose_and_landmarks(
            self.graph.linearize(self.values), len(self.poses), len(self.landmarks), len(oriented)
        )
        return Marginal(mean, to_global(local.covariance, self.poses[-1, 2], oriented[:, 2]))

    def pose_covariances(self) -> Array:
        """Covariance (K, 3, 3) of every pose, given all it was told; additive global error."""
        if self.lagged is not None:
            return self.lagged.pose_covariance
        return pose_covariances(self.graph, self.values, self.poses[:, 2])


def smooth(
    problem: SlamProblem,
    guesses: Mapping[str, tuple[Array, Array]],
    progress: Callable[[str], None] = lambda stage: None,
    options: SmootherOptions | None = None,
) -> SmootherResult:
    """Find the optimum of a problem, or follow it along the way and say how far it is.

    guesses: other estimators' poses (K, 3) and landmarks (L, 2) by name, tried first. Then comes
    the tracked start, which needs no guess, or the incremental method's end, and dead reckoning
    when the optimum is not verified yet. Raises SingularProblemError when every attempt fails for
    want of information, and ValueError for closures that reach beyond a fixed lag.
    """
    options = options or SmootherOptions()
    reach = int(np.abs(problem.closures.first - problem.closures.second).max(initial=0))
    if options.method == "fixed-lag" and reach > options.lag:
        raise ValueError(f"lag is {options.lag}, expected {reach} at least: so far closures reach")
    rejected = NOTHING_REJECTED
    if options.robust == "gnc":
        progress("smoother, wild observations")
        graph = build_graph(problem)
        problem, rejected = reject_wild(problem, graph, track(problem, graph)[0])
    graph = build_graph(problem, options.kernel)
    closed = problem.closures
    weighted = options.kernel != "none" or (len(closed.first) > 0 and closed.kernel != "none")
    seen = np.union1d(problem.sighting_landmark, np.arange(len(problem.surveyed)))
    attempts: list[tuple[Start, gtsam.Values]] = []

    def attempt(name: str, values: gtsam.Values, spent: int = 0) -> None:
        progress(f"smoother, start {name}")
        try:
            end, iterations, converged = optimise(graph, values, options.optimiser)
            end, error = polish(graph, end)
        except RuntimeError:  # gtsam's indeterminate linear system
            attempts.append((Start(name, float("inf"), spent, converged=False), values))
            return
        attempts.append((Start(name, error, spent + iterations, converged), end))

    for name, (poses, landmarks) in guesses.items():
        attempt(name, to_values(poses, landmarks, seen, problem.oriented))
    progress(f"smoother, {options.method}")
    lagged = None
    if options.method == "isam2":
        end = run_isam2(problem, graph)
        followed = from_values(end.values, problem)
        oriented = oriented_from(end.values, problem)
        attempt("isam2", end.values, end.updates)
    elif options.method == "fixed-lag":
        lagged = run_fixed_lag(problem, graph, options.lag)
        followed, oriented = (lagged.poses, lagged.landmarks), lagged.oriented
        start = to_values(*followed, seen, problem.oriented)
        for key, place in enumerate(oriented, start=POSE_LANDMARK_KEY):
            start.update(key, gtsam.Pose2(*place))
        attempt("fixed-lag", start, lagged.updates)
    else:
        attempt("tracked", *track(problem, graph))
    optimality = _examine(problem, graph, attempts, weighted=weighted)
    if not optimality.verified:
        start = extension(problem, gtsam.Values(), 0, problem.pose_count)
        attempt("dead-reckoning", start)
        optimality = _examine(problem, graph, attempts, weighted=weighted)
    best, values = min(attempts, key=lambda a: a[0].error)
    if not np.isfinite(best.error):
        why = explain_singularity(graph, values)
        raise SingularProblemError(why or "the measurements do not fix every pose and landmark")
    poses, landmarks = from_values(values, problem)
    result = SmootherResult(
        options=options,
        problem=problem,
        poses=poses,
        landmarks=landmarks,
        error=best.error,
        iterations=best.iterations,
        converged=best.converged,
        starts=tuple(start for start, _ in attempts),
        optimality=optimality,
        rejected=rejected,
        values=values,
        graph=graph,
    )
    if options.method == "batch":
        return result
    return replace(
        result,
        poses=followed[0],
        landmarks=followed[1],
        optimality=replace(optimality, distance_sigma=_distance(result, *followed, oriented)),
        lagged=lagged,
    )


def _distance(optimum: SmootherResult, poses: Array, landmarks: Array, oriented: Array) -> float:
    """Largest difference of the last pose and the landmarks from the optimum, in its sigma."""
    mean, covariance = optimum.marginal()
    apart = np.concatenate((poses[-1], landmarks.ravel(), oriented.ravel())) - mean
    turns = np.concatenate(([2], np.arange(len(mean) - oriented.size + 2, len(mean), 3)))
    apart[turns] = np.angle(np.exp(1j * apart[turns]))
    return float(np.max(np.abs(apart) / np.sqrt(np.diag(covariance))))


def _examine(
    problem: SlamProblem,
    graph: gtsam.NonlinearFactorGraph,
    attempts: list[tuple[Start, gtsam.Values]],
    *,
    weighted: bool,
) -> Optimality:
    """weighted: a kernel has changed the residuals, so that chi-square says nothing."""
    best, values = min(attempts, key=lambda a: a[0].error)
    agreeing = tuple(
        start.name
        for start, _ in attempts
        if start.error - best.error <= AGREEMENT * (1.0 + best.error)
    )
    dof = 0 if weighted else problem.residual_dimension - problem.state_dimension
    conditions = (
        stationarity(graph, values)
        if np.isfinite(best.error)
        else Stationarity(float("nan"), definite=False)
    )
    return Optimality(conditions, chi_square_test(best.error, dof), agreeing)
