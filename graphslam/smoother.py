"""The smoother: the optimum of a whole log, from several starts, with the evidence for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np

from graphslam.arrays import Array, Marginal
from graphslam.graph_builder import (
    KERNELS,
    LANDMARK_KEY,
    POSE_KEY,
    POSE_LANDMARK_KEY,
    build_graph,
    from_values,
    pose_landmarks_from,
)
from graphslam.incremental import LagEnd, run_fixed_lag, run_isam2
from graphslam.initialisation import extension, track
from graphslam.layout import Layout
from graphslam.marginals import (
    SingularProblemError,
    joint_marginal,
    last_pose_and_landmarks,
    pose_covariances,
    to_global,
    turned,
)
from graphslam.observability import explain_singularity
from graphslam.optimisers import OPTIMISERS
from graphslam.optimum import Exploration, Optimality, chi_square_test, stationarity
from graphslam.problem import SlamProblem
from graphslam.robust import NOTHING_REJECTED, Rejected, reject_outliers
from graphslam.search import MinimumSearch

METHODS = ("batch", "isam2", "fixed-lag")
ROBUST = (*KERNELS, "gnc")


@dataclass(frozen=True)
class SmootherOptions:
    """What a user may choose.

    method: of METHODS. lag: poses that a fixed lag holds. optimiser: of the batch, one of
    OPTIMISERS. robust: against outlier measurements and positions, one of ROBUST; it changes
    marginals.
    accept_misfit: a minimum may be verified although its chi-square is too high.
    """

    method: str = "batch"
    lag: int = 100
    optimiser: str = OPTIMISERS[0]
    robust: str = "none"
    accept_misfit: bool = False

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

    def check(self, problem: SlamProblem) -> None:
        """Check that a problem allows these choices.

        Args:
            problem: What is to be solved.

        Raises:
            ValueError: A closure reaches beyond the fixed lag; or, but in a batch, only later poses
                fix an earlier one; or robust is gnc beside what it cannot weigh.
        """
        closed = problem.loop_closures
        reach = int(np.abs(closed.first - closed.second).max(initial=0))
        if self.method == "fixed-lag" and reach > self.lag:
            raise ValueError(
                f"lag is {self.lag}, expected at least {reach}, the span of the loop closures"
            )
        reached = np.union1d(problem.steps + 1, closed.last)
        alone = np.setdiff1d(np.arange(1, problem.pose_count), reached)
        if self.method != "batch" and len(alone):
            raise ValueError(
                f"method is {self.method}, expected batch: nothing connects pose {alone[0]} with "
                "those before it"
            )
        if self.robust != "gnc":
            return
        if problem.lever_m != (0.0, 0.0) and len(problem.position):
            raise ValueError(
                "robust is gnc, which does not support positions of an antenna away from the pose"
            )
        if len(closed.first) and closed.kernel == "none":
            raise ValueError(
                "robust is gnc, which does not support loop closures, expected huber or cauchy"
            )


@dataclass(frozen=True)
class Start:
    """One attempt: where it began and where the optimiser ended."""

    name: str
    error: float
    iterations: int
    converged: bool


@dataclass(frozen=True, kw_only=True)
class SmootherEvidence:
    """The estimate asked for, and the evidence from the lowest of all attempts.

    poses: (K, 3), headings unwrapped. landmarks: (L, 2). error: half the squared norm of the
    whitened residuals at the optimum. problem: what was solved, without `rejected`, the outlier
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
    def reweighted(self) -> bool:
        """Whether a robust kernel has changed the weight of residuals."""
        return _reweighted(self.problem, self.options.kernel)

    @property
    def rank(self) -> int:
        """Unknowns that the measurements determine; a result is only had when they all are."""
        return int(self.values.dim())

    def initial_error(self) -> float:
        """Return the error where the increments lead, landmarks where they were first seen.

        Returns:
            Half the squared norm of the whitened residuals there.
        """
        start = extension(self.problem, gtsam.Values(), 0, self.problem.pose_count)
        return float(self.graph.error(start))

    def pose_landmarks(self) -> Array:
        """Return the pose landmarks at the optimum.

        Returns:
            (Q, 3) x, y [m], heading [rad], wrapped as gtsam has it.
        """
        if self.lagged is not None:
            return self.lagged.pose_landmarks
        return pose_landmarks_from(self.values, self.problem)

    def joint(
        self, poses: Sequence[int], landmarks: Sequence[int], pose_landmarks: Sequence[int] = ()
    ) -> Array:
        """Return the joint covariance of any poses, points and pose landmarks, in this order.

        Args:
            poses: P indices of poses.
            landmarks: L indices of points.
            pose_landmarks: Q indices of pose landmarks.

        Returns:
            (n, n) at the optimum, of the additive global error; n = 3 P + 2 L + 3 Q.
        """
        layout = Layout(len(poses), len(landmarks), len(pose_landmarks))
        frames = [POSE_KEY + k for k in poses], [POSE_LANDMARK_KEY + j for j in pose_landmarks]
        keys = frames[0] + [LANDMARK_KEY + j for j in landmarks] + frames[1]
        local = joint_marginal(self.graph.linearize(self.values), keys, layout.size).covariance
        headings = np.array([self.values.atPose2(key).theta() for key in frames[0] + frames[1]])
        return turned(local, layout.frame, headings)

    def marginal(self) -> Marginal:
        """Return the last pose and all landmarks jointly.

        Returns:
            Mean and covariance of the additive global error. Pose landmarks come last; their
            headings are as gtsam has them, wrapped.
        """
        if self.lagged is not None:
            return self.lagged.marginal
        pose_landmarks = self.pose_landmarks()
        mean = np.concatenate((self.poses[-1], self.landmarks.ravel(), pose_landmarks.ravel()))
        local = last_pose_and_landmarks(
            self.graph.linearize(self.values),
            len(self.poses),
            len(self.landmarks),
            len(pose_landmarks),
        )
        return Marginal(mean, to_global(local.covariance, self.poses[-1, 2], pose_landmarks[:, 2]))

    def pose_covariances(self) -> Array:
        """Return the covariance of every pose alone, given all measurements, later ones among them.

        Returns:
            (K, 3, 3), additive global error.

        Raises:
            SingularProblemError: Some direction is left without information.
        """
        if self.lagged is not None:
            return self.lagged.pose_covariance
        return pose_covariances(self.graph, self.values, self.poses[:, 2])


def smooth(
    problem: SlamProblem,
    guesses: Mapping[str, tuple[Array, Array]],
    progress: Callable[[str], None] = lambda stage: None,
    options: SmootherOptions | None = None,
) -> SmootherEvidence:
    """Find the optimum of a problem, or follow it along the way and say how far it is.

    The relaxed start, which needs no guess, and the incremental method's end come after the
    guesses; then tracking, where no guess agrees with the relaxed start, and the search for other
    minima.

    Args:
        problem: What is known; it is not changed.
        guesses: Poses (K, 3) and landmarks (L, 2) of other estimators by name, tried first.
        progress: Called with the name of each stage.
        options: Method, optimiser and robust kernel; batch Levenberg-Marquardt by default.

    Returns:
        The lowest minimum that was found, with the evidence that it is the optimum.

    Raises:
        SingularProblemError: Every attempt fails for want of information.
        ValueError: The problem does not allow the options (SmootherOptions.check).
    """
    options = options or SmootherOptions()
    options.check(problem)
    prepared = _prepare(problem, options, progress)
    search = MinimumSearch(prepared.problem, prepared.graph, options.optimiser, progress)
    for name, guess in guesses.items():
        search.attempt(name, "sequential", search.values(*guess))
    search.attempt_relaxed()
    progress(f"smoother, {options.method}")
    followed = _follow(prepared, options, search)
    if not search.attempts or not search.agreed:
        search.attempt("tracked", "sequential", *track(prepared.problem, prepared.graph))
    result = _result(prepared, options, search, search.explore())
    return result if followed is None else _along(result, followed)


class _Prepared(NamedTuple):
    """What is solved: the problem without the outliers that were found, and its graph."""

    problem: SlamProblem
    rejected: Rejected
    graph: gtsam.NonlinearFactorGraph


def _prepare(
    problem: SlamProblem, options: SmootherOptions, progress: Callable[[str], None]
) -> _Prepared:
    """Leave outliers out where that is asked for, and build the graph."""
    rejected = NOTHING_REJECTED
    if options.robust == "gnc":
        progress("smoother, outlier detection")
        graph = build_graph(problem)
        problem, rejected = reject_outliers(problem, graph, track(problem, graph)[0])
    return _Prepared(problem, rejected, build_graph(problem, options.kernel))


def _result(
    prepared: _Prepared, options: SmootherOptions, search: MinimumSearch, exploration: Exploration
) -> SmootherEvidence:
    """Return the lowest minimum with its evidence; SingularProblemError where there is none."""
    problem, rejected, graph = prepared
    best = search.best
    if not np.isfinite(best.error):
        why = explain_singularity(graph, best.values)
        raise SingularProblemError(why or "the measurements do not fix every pose and landmark")
    poses, landmarks = from_values(best.values, problem)
    dof = problem.residual_dimension - problem.state_dimension
    if _reweighted(problem, options.kernel):
        dof = 0  # a kernel has changed the residuals, so that chi-square says nothing
    return SmootherEvidence(
        options=options,
        problem=problem,
        poses=poses,
        landmarks=landmarks,
        error=best.error,
        iterations=best.iterations,
        converged=best.converged,
        starts=tuple(Start(a.name, a.error, a.iterations, a.converged) for a in search.attempts),
        optimality=Optimality(
            stationarity=stationarity(graph, best.values),
            chi_square=chi_square_test(best.error, dof),
            agreeing=tuple(attempt.name for attempt in search.agreeing()),
            agreed=search.agreed,
            exploration=exploration,
            accept_misfit=options.accept_misfit,
        ),
        rejected=rejected,
        values=best.values,
        graph=graph,
    )


@dataclass(frozen=True)
class _Followed:
    """What an incremental method said: poses (K, 3), landmarks (L, 2), pose landmarks (Q, 3)."""

    poses: Array
    landmarks: Array
    pose_landmarks: Array
    lagged: LagEnd | None


def _follow(
    prepared: _Prepared, options: SmootherOptions, search: MinimumSearch
) -> _Followed | None:
    """Run the incremental method that is asked for and begin an attempt where it ended."""
    problem, _, graph = prepared
    try:
        if options.method == "isam2":
            end = run_isam2(problem, graph)
            search.attempt("isam2", "sequential", end.values, end.updates)
            pose_landmarks = pose_landmarks_from(end.values, problem)
            return _Followed(*from_values(end.values, problem), pose_landmarks, None)
        if options.method == "fixed-lag":
            lagged = run_fixed_lag(problem, graph, options.lag)
            start = search.values(lagged.poses, lagged.landmarks)
            for key, place in enumerate(lagged.pose_landmarks, start=POSE_LANDMARK_KEY):
                start.update(key, gtsam.Pose2(*place))
            search.attempt("fixed-lag", "sequential", start, lagged.updates)
            return _Followed(lagged.poses, lagged.landmarks, lagged.pose_landmarks, lagged)
    except RuntimeError:  # gtsam's, of many lines
        raise SingularProblemError(
            f"{options.method} reached a singular system; raise the smallest sigmas of the log, or "
            "use the batch smoother"
        ) from None
    return None


def _along(result: SmootherEvidence, followed: _Followed) -> SmootherEvidence:
    """Return what an incremental method said, with its distance from the optimum."""
    return replace(
        result,
        poses=followed.poses,
        landmarks=followed.landmarks,
        optimality=replace(result.optimality, distance_sigma=_distance(result, followed)),
        lagged=followed.lagged,
    )


def _reweighted(problem: SlamProblem, kernel: str) -> bool:
    """Whether a kernel reduces the weight of what fits badly, of closures or of all."""
    closed = problem.loop_closures
    return kernel != "none" or (len(closed.first) > 0 and closed.kernel != "none")


def _distance(optimum: SmootherEvidence, followed: _Followed) -> float:
    """Largest difference of the last pose and the landmarks from the optimum, in its sigma."""
    mean, covariance = optimum.marginal()
    points, pose_landmarks = followed.landmarks, followed.pose_landmarks
    apart = np.concatenate((followed.poses[-1], points.ravel(), pose_landmarks.ravel())) - mean
    turns = Layout(1, len(points), len(pose_landmarks)).frame + 2
    apart[turns] = np.angle(np.exp(1j * apart[turns]))
    return float(np.max(np.abs(apart) / np.sqrt(np.diag(covariance))))
