"""The search for the lowest minimum: starts that know nothing of each other, and hops.

Starts are of three kinds that share no values: `relaxed` (the problem made linear), `sequential`
(made along the way: tracked, an EKF's, iSAM2's) and `random` (drawn from prior and sensors). Hops
lead from where they end to the alternatives of `ambiguity`: a landmark on the other side of the
path, a heading wound by a turn.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from graphslam.ambiguity import AlternativeStart, alternatives, loose
from graphslam.arrays import Array
from graphslam.graph_builder import (
    LANDMARK_KEY,
    POSE_KEY,
    POSE_LANDMARK_KEY,
    from_values,
    to_values,
)
from graphslam.optimisers import levenberg_marquardt, optimise, polish
from graphslam.optimum import TIE, Exploration, Minimum, same_error
from graphslam.problem import SlamProblem
from graphslam.relaxation import relax

BUDGET = 400
"""Iterations over the whole graph that exploring may take, beside those in BUDGET_SHARE."""
BUDGET_SHARE = 4
"""It may take so many times the iterations of the starts more."""
MOST_WORK = 30_000_000
"""Iterations times factors that exploring may take: 30 iterations of a million factors."""
NEARBY_POSES = 1_000
"""Of more poses a landmark's other place is tried among the poses that saw it first.

The trial over the whole graph is left out where the landmark comes back already there.
"""
LOCAL_POSES = 8_000
"""Of more poses it is left out, too, where the trial nearby adds more error than FOLLOWED."""
FOLLOWED = 100.0
"""Error that a trial nearby may add and still be followed over the whole graph."""
MISSED = 0.05
"""Random starts go on until a basin as wide as the best one's is missed with this chance."""
LEAST_DRAWS, MOST_DRAWS = 8, 40
_SAME = 1e-2
"""Two ends are one minimum when the quadratic model at one gives the other no more error."""
_AS_FAR_M = 1e-4
"""Distances between minima that differ by less are one: optima are settled to a tenth of that."""
_GLANCE = 6
_HOPELESS = 2.0
"""A hop or a random start is given up when its error is so many times the best so soon ..."""
_TRIAL = 20
"""Iterations after which a hop or a random start must have come near the best error ..."""
_NEAR = 0.05
"""... by this, relative to 1 + error, to be followed to its end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """One start and where it ended. kind: `relaxed`, `sequential` or `random`."""

    name: str
    kind: str
    error: float
    iterations: int
    converged: bool
    values: gtsam.Values


class MinimumSearch:
    """Starts, their ends and what they amount to, for one problem and its graph."""

    def __init__(
        self,
        problem: SlamProblem,
        graph: gtsam.NonlinearFactorGraph,
        optimiser: str,
        progress: Callable[[str], None],
    ) -> None:
        """optimiser: of optimisers.OPTIMISERS, for starts; hops take Levenberg-Marquardt."""
        self._problem, self._graph, self._optimiser = problem, graph, optimiser
        self._progress = progress
        self._spent, self._budget, self._hops, self._cut = 0.0, float(BUDGET), 0, False
        self._beside: list[Attempt] = []  # where hops ended that did not lead below
        self._back: Counter[Attempt] = Counter()  # hops that came back, found out nearby
        self._settled: list[Attempt] = []  # no alternative of these leads below
        self._together: dict[tuple[Attempt, Attempt], bool] = {}
        self.attempts: list[Attempt] = []

    @property
    def best(self) -> Attempt:
        """The lowest of all; of those that tie within what a last step may leave, the first."""
        lowest = min(attempt.error for attempt in self.attempts)
        limit = lowest + TIE[0] + TIE[1] * lowest
        return next(attempt for attempt in self.attempts if attempt.error <= limit)

    def attempt(self, name: str, kind: str, values: gtsam.Values, spent: int = 0) -> Attempt:
        """Optimise from values and keep the end; a singular problem's error is infinite."""
        self._progress(f"smoother, start {name}")
        try:
            end, iterations, converged = optimise(self._graph, values, self._optimiser)
            end, error, more = polish(self._graph, end)
            iterations += more
        except RuntimeError:  # gtsam's indeterminate linear system
            end, error, iterations, converged = values, float("inf"), 0, False
        self.attempts.append(
            Attempt(
                name=name,
                kind=kind,
                error=error,
                iterations=spent + iterations,
                converged=converged,
                values=end,
            )
        )
        return self.attempts[-1]

    def values(self, poses: Array, landmarks: Array) -> gtsam.Values:
        """Of poses (K, 3) and landmarks (L, 2); pose landmarks stand where first measured."""
        problem = self._problem
        return to_values(poses, landmarks, problem.seen_landmarks, problem.pose_landmarks)

    def attempt_relaxed(self) -> None:
        """Start from the relaxed problem's solution; a problem that it does not fix has none."""
        try:
            values = relaxed_values(self._problem)
        except RuntimeError:
            return
        self.attempt("relaxed", "relaxed", values)

    def agreeing(self) -> list[Attempt]:
        """The attempts that ended at the lowest minimum."""
        best = self.best
        return [attempt for attempt in self.attempts if self._same(best, attempt)]

    @property
    def agreed(self) -> bool:
        """Whether two independent starts reached the lowest minimum; random ones all are."""
        kinds = [attempt.kind for attempt in self.agreeing()]
        return len({"relaxed", "sequential"}.intersection(kinds)) + kinds.count("random") >= 2

    def explore(self) -> Exploration:
        """Hop from the best; where starts disagree or directions are loose, draw starts, too.

        Stops without completing when the budget is spent.
        """
        agreed, lowest = self.agreed, self.best
        budget = BUDGET + BUDGET_SHARE * sum(one.iterations for one in self.attempts)
        self._budget = min(budget, MOST_WORK // max(1, self._graph.size()))
        lower = self._descend(lowest)
        draws, missed = 0, 0.0
        if not agreed or lower is not lowest or loose(self._problem):
            draws, missed = self._draw()
            if not self.agreed:
                for other in [a for a in self.attempts if a.kind == "sequential"]:
                    self._descend(other)
        complete = not self._cut and missed <= MISSED
        return Exploration(self._minima(), self._hops, draws, missed, complete)

    def _afford(self) -> bool:
        """Whether there is budget left; what is left out for want of it makes a search partial."""
        self._cut = self._cut or self._spent >= self._budget
        return not self._cut

    def _draw(self) -> tuple[int, float]:
        """Start from relaxed problems that are drawn: how many, and the chance left."""
        missed, draws = 1.0, 0
        while draws < MOST_DRAWS and (missed > MISSED or draws < LEAST_DRAWS) and self._afford():
            draws += 1
            rng = np.random.default_rng(draws)
            try:
                start = relaxed_values(draw(self._problem, rng))
            except RuntimeError:
                continue
            drawn = self._rough(
                Attempt(
                    name=f"random {draws}",
                    kind="random",
                    error=float("inf"),
                    iterations=0,
                    converged=False,
                    values=start,
                )
            )
            self.attempts.append(drawn)
            if drawn is self.best:
                self._descend(drawn)
            hits = sum(attempt.kind == "random" for attempt in self.agreeing())
            missed = (1.0 - hits / (draws + 1)) ** draws
        return draws, missed

    def _descend(self, attempt: Attempt) -> Attempt:
        """Hop to lower minima until no alternative leads to one; the end is an attempt, too."""
        now = attempt
        while np.isfinite(now.error):
            if any(self._same(settled, now) for settled in self._settled):
                break
            lower = self._hop(now)
            if lower is None:
                self._settled.append(now)
                break
            now = lower
        if now is not attempt:
            self.attempts.append(now)
        return now

    def _hop(self, attempt: Attempt) -> Attempt | None:
        """The first alternative that leads below, or None."""
        poses, landmarks = from_values(attempt.values, self._problem)
        for other in alternatives(self._problem, poses, landmarks):
            if not self._afford():
                return None
            if other.poses is poses and self._comes_to_nothing(attempt, other, landmarks):
                continue
            end = self._trial(attempt, other, poses, landmarks)
            if end is attempt:
                self._back[attempt] += 1
                continue
            if end.error < attempt.error and not same_error(end.error, attempt.error):
                return end
            self._beside.append(end)
        return None

    def _comes_to_nothing(
        self, attempt: Attempt, other: AlternativeStart, landmarks: Array
    ) -> bool:
        """Whether a moved landmark comes back, or costs too much, as those nearby already tell.

        Only of problems of more than NEARBY_POSES or LOCAL_POSES: a hop over all takes too long.
        """
        moved = np.flatnonzero(np.abs(other.landmarks - landmarks).max(axis=1) > 0.0)
        beyond = len(self._problem.loop_closures.first) + self._problem.pose_landmarks.count
        if self._problem.pose_count <= NEARBY_POSES or len(moved) > 1 or beyond:
            return False
        from graphslam.surroundings import Surroundings

        near = Surroundings(self._problem, self._graph, attempt.values, int(moved[0]))
        added, spent = near.settle(other.landmarks[moved[0]])
        self._spent += spent * near.share
        back = abs(added) <= _SAME
        too_much = added > FOLLOWED and self._problem.pose_count > LOCAL_POSES
        self._back[attempt] += back
        self._hops += back or too_much
        return back or too_much

    def _trial(
        self, attempt: Attempt, other: AlternativeStart, poses: Array, landmarks: Array
    ) -> Attempt:
        values = gtsam.Values(attempt.values)
        for k in np.flatnonzero(np.abs(other.poses - poses).max(axis=1) > 0.0).tolist():
            values.update(POSE_KEY + k, gtsam.Pose2(*other.poses[k]))
        # A landmark that nobody saw is NaN, and nowhere else either.
        for j in np.flatnonzero(np.abs(other.landmarks - landmarks).max(axis=1) > 0.0).tolist():
            values.update(LANDMARK_KEY + j, other.landmarks[j])
        self._hops += 1
        name = attempt.name.removesuffix(" and hops") + " and hops"
        return self._rough(replace(attempt, name=name, values=values), attempt)

    def _rough(self, start: Attempt, left: Attempt | None = None) -> Attempt:
        """Optimise in few iterations, and to the end only what comes near the best by then.

        left: what a hop has left; it is the result as soon as the hop is seen to come back there.
        """
        try:
            end, spent, converged = levenberg_marquardt(self._graph, start.values, 1e-2, _GLANCE)
            error, more = self._graph.error(end), 0
            back = self._at(left, error, end)
            if not back and error < _HOPELESS * (1.0 + self.best.error):
                end, more, converged = levenberg_marquardt(self._graph, end, 1e-4, _TRIAL)
                error, spent, more = self._graph.error(end), spent + more, 0
                back = self._at(left, error, end)
            if left is not None and back:
                self._spent += spent
                return left
            if error < self.best.error + _NEAR * (1.0 + self.best.error):
                end, more, converged = optimise(self._graph, end)
                end, error, last = polish(self._graph, end)
                more += last
        except RuntimeError:
            return replace(start, error=float("inf"), converged=False)
        self._spent += spent + more
        return replace(start, error=error, iterations=spent + more, converged=converged, values=end)

    def _same(self, one: Attempt, other: Attempt) -> bool:
        """Equal in error and in place."""
        if one is other:
            return True
        known = self._together.get((one, other))
        if known is None:
            known = self._together[one, other] = self._at(one, other.error, other.values)
        return known

    def _at(self, one: Attempt | None, error: float, values: gtsam.Values) -> bool:
        """Whether values with such an error are at an attempt's end; never where there is none."""
        if one is None or not np.isfinite(one.error) or not same_error(one.error, error):
            return False
        apart = one.values.localCoordinates(values)
        linear = self._graph.linearize(one.values)
        added = linear.error(apart) - linear.error(one.values.zeroVectors())
        return bool(abs(added) <= _SAME)

    def _minima(self) -> tuple[Minimum, ...]:
        """The distinct minima, lowest first, and where they differ most from the best."""
        best = self.best
        ends = [end for end in (*self.attempts, *self._beside) if np.isfinite(end.error)]
        distinct: dict[Attempt, int] = {}
        for end in sorted(ends, key=lambda attempt: (attempt is not best, attempt.error)):
            minimum = next((one for one in distinct if self._same(one, end)), end)
            distinct[minimum] = distinct.get(minimum, 0) + 1 + self._back[end]
        if not distinct:
            return ()
        poses, landmarks = from_values(best.values, self._problem)
        first, *others = (
            self._difference(end, count, poses, landmarks) for end, count in distinct.items()
        )
        # Mirror images have one error but for rounding: they stand in the order of their landmarks.
        others.sort(key=lambda one: (float(f"{one.error:.7g}"), one.landmark, one.pose))
        return (first, *others)

    def _difference(self, end: Attempt, count: int, poses: Array, landmarks: Array) -> Minimum:
        other_poses, other_landmarks = from_values(end.values, self._problem)
        moved = np.linalg.norm(other_poses[:, :2] - poses[:, :2], axis=1)
        shifted = np.linalg.norm(other_landmarks - landmarks, axis=1)
        pose = _farthest(moved)
        known = np.flatnonzero(np.isfinite(shifted))
        landmark = int(known[_farthest(shifted[known])]) if len(known) else -1
        far = float(shifted[landmark]) if len(known) else 0.0
        return Minimum(
            error=end.error,
            starts=count,
            pose=pose,
            pose_m=float(moved[pose]),
            landmark=landmark,
            landmark_m=far,
        )


def _farthest(distance: Array) -> int:
    """The first of those that are as far as rounding tells."""
    return int((distance > distance.max() - _AS_FAR_M).argmax())


def relaxed_values(problem: SlamProblem) -> gtsam.Values:
    """The relaxed problem's solution. Raises RuntimeError where its equations do not fix it."""
    start = relax(problem)
    values = to_values(start.poses, start.landmarks, problem.seen_landmarks)
    for key, place in enumerate(start.frames, start=POSE_LANDMARK_KEY):
        values.insert(key, gtsam.Pose2(*place))
    return values


def draw(problem: SlamProblem, rng: np.random.Generator) -> SlamProblem:
    """The problem with every measurement and the prior drawn anew about what was measured."""

    def noise(covariance: Array) -> Array:
        # By the symmetric root: which way an eigenvector points is rounding.
        values, vectors = np.linalg.eigh(covariance)
        along = np.einsum("...ji,...j->...i", vectors, rng.standard_normal(values.shape))
        scaled = np.sqrt(np.maximum(values, 0.0)) * along
        drawn: Array = np.einsum("...ij,...j->...i", vectors, scaled)
        return drawn

    seen, closed = problem.pose_landmarks, problem.loop_closures
    merged = seen.merges
    z = problem.z + problem.sigma * rng.standard_normal(problem.z.shape)
    return replace(
        problem,
        prior_pose=problem.prior_pose + noise(problem.prior_covariance),
        increment=problem.increment + noise(np.nan_to_num(problem.increment_covariance)),
        z=np.column_stack((np.abs(z[:, 0]), z[:, 1])),
        position=problem.position + noise(problem.position_covariance),
        surveyed=problem.surveyed + noise(problem.surveyed_covariance),
        pose_landmarks=replace(
            seen,
            measured=seen.measured + noise(seen.covariance),
            merges=replace(merged, measured=merged.measured + noise(merged.covariance)),
        ),
        loop_closures=replace(closed, motion=closed.motion + noise(closed.covariance)),
    )
