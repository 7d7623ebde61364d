"""Where else things could be, near a minimum: a landmark elsewhere, a heading wound by a turn.

Each alternative is a start for the optimiser, with an estimate of the error that it would add.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from graphslam.arrays import Array, Index, wrap_angle
from graphslam.problem import SlamProblem

DIRECTIONS = 8
"""Candidates for a landmark stand in so many directions from a pose that measured it.

None is opposite to what it measured: there the bearing's residual is pi, and its sign is rounding.
"""
EXCESS = 6.0
"""Places that add more error than this per measurement of the landmark are not tried."""
WINDING_EXCESS = 25.0
"""Turns whose increments alone add more error than this are not tried."""
LOOSE_RAD = 0.3
"""Directions are hardly measured where most bearings, or a stretch's turns, are known no better."""
TAILS = 4
"""A path is mirrored from so many poses on."""
MEASUREMENTS = 500_000
"""Landmarks with so many measurements are examined together; more would want gigabytes."""
_STEPS = 8
_ASIDE = 0.05
"""Of the angle between two candidates: so far the first stands beside what was measured."""
_SAME = 1.0
"""Two places of a landmark are one when they differ by less than this many sigma of its range."""


class AlternativeStart(NamedTuple):
    """Poses (K, 3) and landmarks (L, 2) to start from, and the error that they add, estimated."""

    excess: float
    poses: Array
    landmarks: Array


def alternatives(problem: SlamProblem, poses: Array, landmarks: Array) -> list[AlternativeStart]:
    """All alternatives to try from an estimate: poses (K, 3) unwrapped, landmarks (L, 2).

    The least excess comes first. Where several landmarks would be better off elsewhere, moving all
    of them at once comes before any of them.
    """
    modes = landmark_modes(problem, poses, landmarks)
    found = [
        AlternativeStart(float(modes.excess[i]), poses, _moved(landmarks, modes, [i]))
        for i in np.flatnonzero(modes.excess <= EXCESS * (modes.count + 1)).tolist()
    ]
    found += windings(problem, poses, landmarks)
    if loose(problem):
        found += mirrors(problem, poses, landmarks)
    better = np.flatnonzero(modes.excess < 0.0)
    _, first = np.unique(modes.landmark[better], return_index=True)
    if len(first) > 1:
        rows = better[first].tolist()
        excess = float(modes.excess[rows].sum())
        found.append(AlternativeStart(excess, poses, _moved(landmarks, modes, rows)))
    return sorted(found, key=lambda one: one.excess)


def loose(problem: SlamProblem) -> bool:
    """Whether directions are hardly measured: by most bearings, the prior, or a blind stretch.

    Then a path and its mirror image, or its rotation, explain the measurements nearly as well.
    """
    variance = problem.increment_covariance[:, 2, 2]
    blind = max((float(variance[a:b].sum()) for a, b in _stretches(problem)), default=0.0)
    bearing = float(np.median(problem.sigma[:, 1])) if len(problem.sigma) else 0.0
    prior = float(np.sqrt(problem.prior_covariance[2, 2]))
    return max(bearing, prior, float(np.sqrt(blind))) > LOOSE_RAD


def mirrors(problem: SlamProblem, poses: Array, landmarks: Array) -> Iterator[AlternativeStart]:
    """The path with its landmarks mirrored, whole or from a pose on.

    The whole is mirrored about its first heading, about its chord, and about the line through the
    surveyed landmarks; from a pose on, about the heading there. Surveyed landmarks stay.
    """
    axes = [(poses[0, :2], float(poses[0, 2]), 0)]
    chord = poses[-1, :2] - poses[0, :2]
    axes.append((poses[0, :2], float(np.arctan2(chord[1], chord[0])), 0))
    if len(problem.surveyed) > 1:
        middle = problem.surveyed.mean(axis=0)
        along = np.linalg.svd(problem.surveyed - middle)[2][0]
        axes.append((middle, float(np.arctan2(along[1], along[0])), 0))
    tails = np.linspace(0, problem.pose_count - 1, TAILS + 2)[1:-1].astype(np.intp)
    axes += [(poses[k, :2], float(poses[k, 2]), k) for k in np.unique(tails).tolist() if k]
    first = np.full(problem.landmark_count, problem.pose_count)
    np.minimum.at(first, problem.measurement_landmark, problem.measurement_pose)
    first[: len(problem.surveyed)] = -1
    for origin, angle, k in axes:
        other, moved = poses.copy(), landmarks.copy()
        other[k:, :2] = _reflected(poses[k:, :2], origin, angle)
        other[k:, 2] = 2.0 * angle - poses[k:, 2]
        if k:
            other[k, 2] = poses[k, 2]
        free = first >= k
        moved[free] = _reflected(landmarks[free], origin, angle)
        yield AlternativeStart(0.0, other, moved)


def _reflected(points: Array, origin: Array, angle: float) -> Array:
    """Points (N, 2) on the other side of a line."""
    cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
    return (points - origin) @ np.array(((cos, sin), (sin, -cos))) + origin


def _stretches(problem: SlamProblem) -> list[tuple[int, int]]:
    """First and last poses of stretches of odometry between those that something else fixes.

    A landmark that is seen from one pose only fixes nothing.
    """
    pairs = np.unique(
        np.column_stack((problem.measurement_landmark, problem.measurement_pose)), axis=0
    )
    views = np.bincount(pairs[:, 0].astype(np.intp), minlength=problem.landmark_count)
    views[: len(problem.surveyed)] = 2
    known = np.unique(
        np.concatenate(
            (
                problem.measurement_pose[views[problem.measurement_landmark] > 1],
                problem.position_pose,
                problem.pose_landmarks.pose,
                problem.loop_closures.first,
                problem.loop_closures.second,
            )
        )
    )
    measured = np.isfinite(problem.increment_covariance[:, 0, 0])
    between = zip(known[:-1].tolist(), known[1:].tolist(), strict=True)
    return [(first, last) for first, last in between if measured[first:last].all()]


def windings(problem: SlamProblem, poses: Array, landmarks: Array) -> Iterator[AlternativeStart]:
    """The heading wound by a turn more or less in a stretch without measurements.

    The turn is shared by the stretch's increments as their variances are, its path is integrated
    anew and shifted to end where it did. One increment alone would come back to where it was.
    """
    variance = problem.increment_covariance[:, 2, 2]
    turned = np.diff(poses[:, 2]) - problem.increment[:, 2]
    for first, last in _stretches(problem):
        if last == first + 1:
            continue
        share = variance[first:last] / max(float(variance[first:last].sum()), 1e-300)
        total, residual = float(variance[first:last].sum()), float(turned[first:last].sum())
        for turn in (-2.0 * np.pi, 2.0 * np.pi):
            excess = ((residual + turn) ** 2 - residual**2) / (2.0 * max(total, 1e-300))
            if excess <= WINDING_EXCESS:
                wound = _wound(problem, poses, slice(first, last), turn * share)
                yield AlternativeStart(excess, wound, landmarks)


def _wound(problem: SlamProblem, poses: Array, part: slice, turn: Array) -> Array:
    """Poses (K, 3) with turns (N,) added to the N increments of a part."""
    heading = poses[part.start, 2] + np.cumsum(np.diff(poses[part.start : part.stop + 1, 2]) + turn)
    before = np.concatenate((poses[part.start : part.start + 1, 2], heading[:-1]))
    step = (problem.increment[part, 0] + 1j * problem.increment[part, 1]) * np.exp(1j * before)
    place = np.cumsum(step) + complex(*poses[part.start, :2])
    rest = complex(*poses[part.stop, :2]) - place[-1]
    place = place + rest * np.arange(1, len(place) + 1) / len(place)
    wound = poses.copy()
    wound[part.start + 1 : part.stop + 1] = np.column_stack((place.real, place.imag, heading))
    wound[part.stop + 1 :, 2] += turn.sum()
    return wound


def _moved(landmarks: Array, modes: LandmarkModes, rows: list[int]) -> Array:
    moved = landmarks.copy()
    moved[modes.landmark[rows]] = modes.place[rows]
    return moved


@dataclass(frozen=True)
class LandmarkModes:
    """N other places of landmarks, each a minimum of that landmark's error with the poses held.

    landmark: (N,). place: (N, 2). excess: (N,) error above the present place's. count: (N,)
    measurements of that landmark.
    """

    landmark: Index
    place: Array
    excess: Array
    count: Index


def landmark_modes(problem: SlamProblem, poses: Array, landmarks: Array) -> LandmarkModes:
    """Find the other minima of each landmark's error, given poses (K, 3) and landmarks (L, 2).

    Candidates on the circle of a measured range are refined by damped Gauss-Newton, all at once.
    """
    free = np.setdiff1d(problem.measurement_landmark, np.arange(len(problem.surveyed)))
    middle = _middle_measurement(problem, free)
    start = problem.z[middle, 0, None] * np.exp(
        2j * np.pi * (np.arange(DIRECTIONS) + _ASIDE) / DIRECTIONS
        + 1j * (poses[problem.measurement_pose[middle], 2] + problem.z[middle, 1])[:, None]
    )
    origin = poses[problem.measurement_pose[middle], :2]
    place = np.stack((start.real, start.imag), axis=2) + origin[:, None]
    own = np.full(problem.landmark_count, -1)
    own[free] = np.arange(len(free))
    order = np.argsort(problem.measurement_landmark, kind="stable")
    rows = order[own[problem.measurement_landmark[order]] >= 0]
    landmark_index = own[problem.measurement_landmark[rows]]
    found = []
    for block in _blocks(np.bincount(landmark_index, minlength=len(free))):
        own_rows = rows[slice(*np.searchsorted(landmark_index, (block.start, block.stop)))]
        which = own[problem.measurement_landmark[own_rows]] - block.start
        pose = poses[problem.measurement_pose[own_rows]]
        seen = _Seen(pose, problem.z[own_rows], problem.sigma[own_rows], which)
        found.append(_modes(free[block], place[block], landmarks[free[block]], seen))
    return LandmarkModes(
        *(np.concatenate([getattr(part, one.name) for part in found]) for one in fields(found[0]))
    )


def _blocks(count: Index) -> list[slice]:
    """Landmarks, with so many measurements each (F,), in blocks of some MEASUREMENTS in all."""
    block = (np.cumsum(count) - count) // MEASUREMENTS
    first = np.concatenate(([0], np.flatnonzero(np.diff(block)) + 1))
    ends = [*first[1:].tolist(), len(count)]
    return [slice(a, b) for a, b in zip(first.tolist(), ends, strict=True)]


def _modes(free: Index, place: Array, present: Array, seen: _Seen) -> LandmarkModes:
    """Of landmarks (F,) at present places (F, 2), from candidates (F, D, 2)."""
    place, error = _refine(seen, place)
    now = seen.linearise(present[:, None])[0][:, 0]
    sigma = np.full(len(free), np.inf)
    np.minimum.at(sigma, seen.landmark_index, seen.sigma[:, 0])
    return _distinct(free, place, error - now[:, None], present, sigma, seen)


@dataclass(frozen=True)
class _Seen:
    """M measurements of F landmarks: poses (M, 3), z and sigma (M, 2), landmark index (M,).

    Sorted by landmark.
    """

    pose: Array
    z: Array
    sigma: Array
    landmark_index: Index

    def linearise(self, place: Array) -> tuple[Array, Array, Array]:
        """Error (F, D), gradient (F, D, 2) and information (F, D, 2, 2) of places (F, D, 2)."""
        offset = place[self.landmark_index] - self.pose[:, None, :2]
        dx, dy = offset[..., 0], offset[..., 1]
        distance = np.maximum(np.hypot(dx, dy), 1e-9)
        bearing = np.arctan2(dy, dx) - self.pose[:, 2:]
        far = (distance - self.z[:, :1]) / self.sigma[:, :1]
        aside = wrap_angle(bearing - self.z[:, 1:]) / self.sigma[:, 1:]
        along = np.stack((dx, dy)) / (distance * self.sigma[:, :1])
        across = np.stack((-dy, dx)) / (np.square(distance) * self.sigma[:, 1:])
        terms = [
            0.5 * (far * far + aside * aside),
            *(far * along + aside * across),
            along[0] * along[0] + across[0] * across[0],
            along[0] * along[1] + across[0] * across[1],
            along[1] * along[1] + across[1] * across[1],
        ]
        # Measurements are sorted by landmark.
        first = np.flatnonzero(np.diff(self.landmark_index, prepend=-1))
        error, gx, gy, xx, xy, yy = np.add.reduceat(np.stack(terms), first, axis=1)
        information = np.stack((np.stack((xx, xy), axis=-1), np.stack((xy, yy), axis=-1)), axis=-2)
        return error, np.stack((gx, gy), axis=-1), information


def _refine(seen: _Seen, place: Array) -> tuple[Array, Array]:
    damping = np.full(place.shape[:2], 1e-3)
    error, gradient, information = seen.linearise(place)
    for _ in range(_STEPS):
        xx, xy, yy = information[..., 0, 0], information[..., 0, 1], information[..., 1, 1]
        more = damping * (xx + yy)
        xx, yy = xx + more, yy + more
        gx, gy = gradient[..., 0], gradient[..., 1]
        step = np.stack((yy * gx - xy * gy, xx * gy - xy * gx), axis=-1)
        trial = place - step / (xx * yy - xy * xy)[..., None]
        lower, next_gradient, next_information = seen.linearise(trial)
        better = lower < error
        place = np.where(better[..., None], trial, place)
        error = np.where(better, lower, error)
        gradient = np.where(better[..., None], next_gradient, gradient)
        information = np.where(better[..., None, None], next_information, information)
        damping = np.where(better, 0.2 * damping, 10.0 * damping)
    return place, error


def _distinct(
    free: Index, place: Array, excess: Array, landmarks: Array, sigma: Array, seen: _Seen
) -> LandmarkModes:
    """Of candidates (F, D, 2) those that are neither the present place nor each other."""
    order = np.argsort(excess, axis=1, kind="stable")
    place = np.take_along_axis(place, order[..., None], axis=1)
    excess = np.take_along_axis(excess, order, axis=1)
    limit = np.maximum(_SAME * sigma, 1e-3)[:, None]
    new = np.linalg.norm(place - landmarks[:, None], axis=2) > limit
    for i in range(1, place.shape[1]):
        apart = np.linalg.norm(place[:, :i] - place[:, i : i + 1], axis=2) > limit
        new[:, i] &= (apart | ~new[:, :i]).all(axis=1)
    row, column = np.nonzero(new)
    count = np.bincount(seen.landmark_index, minlength=len(free))
    return LandmarkModes(free[row], place[row, column], excess[row, column], count[row])


def _middle_measurement(problem: SlamProblem, landmarks: Index) -> Index:
    """(F,) rows: of each landmark's measurements the one in the middle."""
    order = np.argsort(problem.measurement_landmark, kind="stable")
    ordered = problem.measurement_landmark[order]
    first = np.searchsorted(ordered, landmarks)
    last = np.searchsorted(ordered, landmarks, side="right")
    middle: Index = order[(first + last) // 2]
    return middle
