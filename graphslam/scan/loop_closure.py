"""Loop closure: where the vehicle may have been before, verified by laying the scans together.

Candidates come from the estimate's own covariance: two poses may see the same place when their
distance could be within reach given how uncertain it is. A match becomes a closure only when scans
overlap, fit, fix all directions, and agree with the graph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from graphslam.arrays import Array, Index
from graphslam.problem import LoopClosures, SlamProblem
from graphslam.scan import planar
from graphslam.scan.matchers import COARSE_M, MatchOptions, SurfaceMatcher
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.points import placed
from graphslam.scan.refinement import RefinementOptions
from graphslam.scan.registration import Matcher, Registration, ScanError, squared_distance
from graphslam.smoother import SmootherEvidence, smooth

Clouds = Mapping[int, Array]
"""Points (M, 3) seen from some of the poses, by the pose's number."""

_CHI2_2_99 = 9.21
_CHI2_3_999 = 16.27


class LoopCloser(Protocol):
    """Finds motions between poses that do not follow each other."""

    def close(self, problem: SlamProblem, clouds: Clouds) -> Closed:
        """Closures for a problem, from the clouds (M, 3) seen at some of its poses."""


@dataclass(frozen=True)
class ClosureAttempt:
    """A pair of poses that was tried: what came of it, `accepted` or the reason against."""

    first: int
    second: int
    outcome: str


@dataclass(frozen=True)
class Closed:
    """What was found, and all that was tried."""

    loop_closures: LoopClosures = field(default_factory=LoopClosures)
    attempts: tuple[ClosureAttempt, ...] = ()


class NoLoopClosure:
    """Closes nothing."""

    def close(self, problem: SlamProblem, clouds: Clouds) -> Closed:
        """No closures."""
        return Closed()


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """When a match is tried and when it is believed.

    keyframe_m, keyframe_rad: poses closer together than both share a keyframe. apart_m: way driven
    between two poses of a loop, at least. reach_m: scans taken within this distance show the same
    place. per_keyframe: pairs tried for each keyframe, the nearest first. neighbours: keyframes on
    either side that the earlier scan is matched together with. least_overlap, most_residual_m,
    least_stiffness: of a match to believe. placement_m, placement_rad: added to its sigmas, since
    vehicles tilt, clocks jitter, and a map of scans is itself not exact. rounds: how often to look
    again with the estimate that the closures have improved. kernel: of the closures in the graph.
    """

    keyframe_m: float = 1.0
    keyframe_rad: float = 0.3
    apart_m: float = 15.0
    reach_m: float = 4.0
    per_keyframe: int = 2
    neighbours: int = 1
    least_overlap: float = 0.7
    most_residual_m: float = 0.15
    least_stiffness: float = 12.0
    placement_m: float = 0.02
    placement_rad: float = 0.003
    rounds: int = 3
    kernel: str = "cauchy"


class RegistrationLoopCloser:
    """Verifies candidates with a matcher."""

    def __init__(
        self,
        matcher: Matcher,
        options: LoopOptions | None = None,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        """progress: called with the keyframes done, of all."""
        self._matcher, self._progress = matcher, progress
        self.options = options or LoopOptions()

    def close(self, problem: SlamProblem, clouds: Clouds) -> Closed:
        """Search in rounds until nothing new is found; see LoopCloser."""
        o = self.options
        keyframes = choose_keyframes(problem, clouds, o.keyframe_m, o.keyframe_rad)
        found: dict[tuple[int, int], Registration] = {}
        attempts: dict[tuple[int, int], ClosureAttempt] = {}
        tried: dict[tuple[int, int], Array] = {}
        for _ in range(self.options.rounds):
            before = len(found)
            result = smooth(replace(problem, loop_closures=self._loop_closures(found)), {})
            running_estimate = KeyframeEstimate(result, keyframes)
            for later in range(len(keyframes)):
                self._progress(later, len(keyframes))
                for earlier in self._candidates(problem, running_estimate, later):
                    pair = (int(keyframes[earlier]), int(keyframes[later]))
                    expected, spread = running_estimate.relative(earlier, later)
                    if pair in found or _as_before(tried.get(pair), expected):
                        continue
                    tried[pair] = expected
                    outcome = self._try(running_estimate, clouds, earlier, later, expected, spread)
                    if isinstance(outcome, str):
                        attempts[pair] = ClosureAttempt(*pair, outcome)
                    else:
                        found[pair] = outcome
                        attempts[pair] = ClosureAttempt(*pair, "accepted")
            if len(found) == before:
                break
        return Closed(self._loop_closures(found), tuple(attempts.values()))

    def _loop_closures(self, found: dict[tuple[int, int], Registration]) -> LoopClosures:
        pairs = sorted(found)
        return LoopClosures(
            np.array([i for i, _ in pairs], dtype=np.intp),
            np.array([j for _, j in pairs], dtype=np.intp),
            np.array([found[p].motion for p in pairs]).reshape(-1, 3),
            np.array([found[p].covariance for p in pairs]).reshape(-1, 3, 3),
            self.options.kernel,
        )

    def _candidates(
        self, problem: SlamProblem, running_estimate: KeyframeEstimate, later: int
    ) -> list[int]:
        """Earlier keyframes that may lie within reach, the nearest first."""
        o = self.options
        way = np.concatenate(([0.0], np.cumsum(np.hypot(*problem.increment[:, :2].T))))
        at = way[running_estimate.keyframes]
        earlier = np.flatnonzero(at[later] - at >= o.apart_m)
        if not len(earlier):
            return []
        offset = running_estimate.pose[earlier, :2] - running_estimate.pose[later, :2]
        distance = np.hypot(*offset.T)
        spread = running_estimate.position_spread(earlier, later)
        along = offset / np.maximum(distance, 1e-9)[:, None]
        variance = np.einsum("ni,nij,nj->n", along, spread, along)
        beyond = np.maximum(distance - o.reach_m, 0.0)
        near = beyond**2 <= _CHI2_2_99 * variance
        chosen: list[int] = []
        for k in np.argsort(distance, kind="stable").tolist():
            apart = all(abs(at[earlier[k]] - at[c]) >= o.apart_m for c in chosen)
            if near[k] and apart:
                chosen.append(int(earlier[k]))
            if len(chosen) == o.per_keyframe:
                break
        return chosen

    def _try(
        self,
        running_estimate: KeyframeEstimate,
        clouds: Clouds,
        earlier: int,
        later: int,
        expected: Array,
        spread: Array,
    ) -> Registration | str:
        """A believable match of two keyframes, or the reason why there is none."""
        o = self.options
        around = range(
            max(earlier - o.neighbours, 0),
            min(earlier + o.neighbours + 1, len(running_estimate.keyframes)),
        )
        base = running_estimate.pose[earlier]
        target = placed(
            [clouds[int(running_estimate.keyframes[k])] for k in around],
            np.array([planar.between(base, running_estimate.pose[k]) for k in around]),
        )
        source = clouds[int(running_estimate.keyframes[later])]
        reach = COARSE_M + 2.0 * float(np.sqrt(np.trace(spread[:2, :2])))
        seen = planar.moved(expected, source)
        common = np.isfinite(cKDTree(target).query(seen, distance_upper_bound=reach)[0]).mean()
        if common < o.least_overlap:
            return "the scans view different places"
        placement = np.diag((o.placement_m**2, o.placement_m**2, o.placement_rad**2))
        reason = ""
        for start in starts(expected, spread, o.reach_m):
            try:
                match = self._matcher.match(source, target, start)
            except ScanError as error:
                reason = reason or str(error)
                continue
            beside = running_estimate.misplacement(earlier, around, match.motion)
            widened = replace(match, covariance=match.covariance + beside + placement)
            doubt = self._doubt(widened, expected, spread)
            if not doubt:
                return widened
            reason = reason or doubt
        return reason

    def _doubt(self, match: Registration, expected: Array, spread: Array) -> str:
        """What speaks against a match, empty when nothing does."""
        o = self.options
        if match.overlap < o.least_overlap:
            return f"overlap {match.overlap:.2f}, expected {o.least_overlap:g} at least"
        if match.residual_m > o.most_residual_m:
            return f"residual {match.residual_m:.3f} m, expected {o.most_residual_m:g} m at most"
        if match.stiffness[0] < o.least_stiffness:
            return "the surroundings do not constrain one direction"
        distance = squared_distance(match, expected, spread)
        if distance > _CHI2_3_999:
            return f"contradicts the graph: squared Mahalanobis distance {distance:.0f}"
        return ""


def _as_before(tried: Array | None, expected: Array) -> bool:
    """A pair was tried from about the same expectation."""
    return tried is not None and bool(np.abs(planar.wrapped(tried - expected)).max() < COARSE_M / 4)


def starts(expected: Array, spread: Array, reach_m: float) -> list[Array]:
    """Where to begin matching: the expectation and, where it is vague, its sigma points.

    Vague: a direction whose two sigmas, heading scaled by the reach, exceed half a metre.
    """
    scale = np.array((1.0, 1.0, reach_m))
    values, axes = np.linalg.eigh(spread * np.outer(scale, scale))
    result = [expected]
    for value, axis in zip(values, axes.T, strict=True):
        sigma = float(np.sqrt(max(value, 0.0)))
        if 2.0 * sigma > 0.5:
            step = min(2.0 * sigma, 2.0 * reach_m) * axis / scale
            result += [expected + step, expected - step]
    return result


def loop_closer(
    settings: KissIcpOptions,
    matcher: Matcher | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> RegistrationLoopCloser:
    """A loop closer for scans that suit these settings of scan odometry.

    matcher: in place of the surfaces', which begin a metre off.
    """
    surfaces = replace(MatchOptions.suited(settings, RefinementOptions()), iterations=15)
    options = LoopOptions(most_residual_m=max(0.15, 0.4 * settings.refinement.reach_m))
    return RegistrationLoopCloser(matcher or SurfaceMatcher(surfaces), options, progress)


def choose_keyframes(
    problem: SlamProblem, seen_from: Iterable[int], apart_m: float, apart_rad: float
) -> Index:
    """(F,) of the poses with scans, one at least every so many metres and radians of the drive."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*problem.increment[:, :2].T))))
    turn = np.concatenate(([0.0], np.cumsum(np.abs(problem.increment[:, 2]))))
    chosen: list[int] = []
    for k in sorted(seen_from):
        if (
            not chosen
            or way[k] - way[chosen[-1]] >= apart_m
            or turn[k] - turn[chosen[-1]] >= apart_rad
        ):
            chosen.append(k)
    return np.array(chosen, dtype=np.intp)


class KeyframeEstimate:
    """Poses of keyframes with their joint covariance, of the additive global error."""

    def __init__(self, result: SmootherEvidence, keyframes: Index) -> None:
        """keyframes: (F,) numbers of poses."""
        self.keyframes = keyframes
        self.pose = result.poses[keyframes]
        size = len(keyframes)
        joint = result.joint(keyframes.tolist(), [])
        self._joint = joint.reshape(size, 3, size, 3).transpose(0, 2, 1, 3)

    def position_spread(self, earlier: Index, later: int) -> Array:
        """(N, 2, 2) covariances of the places' differences."""
        own = np.arange(len(self.keyframes))
        spread = self._joint[own, own][:, :2, :2]
        cross = self._joint[earlier, later][:, :2, :2]
        result: Array = spread[earlier] + spread[later] - cross - cross.transpose(0, 2, 1)
        return result

    def relative(self, first: int, second: int) -> tuple[Array, Array]:
        """(3,) the second in the first's frame, with covariance (3, 3) in those axes."""
        block = np.block([[self._joint[i, j] for j in (first, second)] for i in (first, second)])
        return planar.relative(self.pose[first], self.pose[second], block)

    def misplacement(self, base: int, around: range, motion: Array) -> Array:
        """(3, 3) how far keyframes around a base, as placed by the graph, may lead a match astray.

        Of the right perturbation of a motion (3,) from the base. The match follows each in part;
        the mean of their covariances bounds that of their mean, however they are correlated.
        """
        total = np.zeros((3, 3))
        for k in around:
            place, spread = self.relative(base, k)
            own = planar.rotation(place[2]).T
            total += planar.carried(own @ spread @ own.T, planar.between(place, motion))
        return total / len(around)
