"""What an external estimate has that a reference of its kind has not, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.checks.accuracy import at_others
from comparisons.checks.diagnosis import covariance_signatures as signatures
from comparisons.checks.diagnosis.diagnosis import (
    Diagnosis,
    PathMotion,
    Paths,
    PathTransform,
    diagnose,
    frame_at_start,
    simplest_motion,
)
from comparisons.checks.grade import (
    LIKE_SIGMA,
    LIKE_VARIANCE,
    SMOOTHER,
    Likeness,
    in_sigma,
    joint_pair,
)
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.logs.stamps import at_instants
from comparisons.plane import pose_difference, rms
from comparisons.words import Cause

_MAP_HINT = "supply the whole map, with the ids of the log's measurements"
_AT_M = 0.5
"""A landmark so near is the one of another name."""


@dataclass(frozen=True, kw_only=True)
class Clues:
    """What poses (K, 3) and covariances (K, 3, 3) might be in place of the reference's.

    before: those before each instant's measurements, if the reference is a filter. smoothed: the
    smoother's, NaN where it has none. filtered: makes those of the reference EKF, None where it
    breaks down. closed: the log has loop closures, which the reference EKF does not use.
    """

    before: tuple[Array, Array] | None
    smoothed: tuple[Array, Array]
    filtered: Callable[[], tuple[Array, Array] | None]
    closed: bool


def facts(given: ExternalEstimate, likeness: Likeness, clues: Clues) -> list[Cause]:
    """Name all that keeps an estimate from being like a reference; none where it is.

    given: its poses at the reference's times, and no others.
    """
    if likeness.grade is not None:
        return []
    causes, partly = _means(given, likeness, clues)
    covariances = _covariances(given, likeness, clues)
    valid = not any(signatures.invalid(pair) for pair, _ in _pairs(given, likeness).values())
    causes = [*causes, *covariances] if valid else [*covariances, *causes]
    if likeness.missing:
        causes.append(Cause("coverage", "; ".join(likeness.missing), "supply the whole trajectory"))
    if likeness.unmapped:
        causes.append(Cause("map", "; ".join(likeness.unmapped), _map_hint(given, likeness)))
    return causes + partly


def _map_hint(given: ExternalEstimate, likeness: Likeness) -> str:
    """Hand it in, or under the log's ids where it lies at landmarks of others."""
    reference = likeness.reference
    others = np.setdiff1d(np.arange(len(reference.landmark)), likeness.theirs)
    if given.landmark is None or given.landmark_id is None or not len(others):
        return _MAP_HINT
    place, pairs = reference.landmark[others], []
    names = [reference.landmark_name(row) for row in others.tolist()]
    for row in np.setdiff1d(np.arange(len(given.landmark)), likeness.ours):
        apart = np.linalg.norm(place - given.landmark[row], axis=1)
        if apart.min() <= _AT_M:
            pairs.append(f"{given.landmark_id[row]} at landmark {names[apart.argmin()]}")
    if not pairs:
        return _MAP_HINT
    listed = ", ".join(pairs[:4])
    return f"use the log's ids: {len(pairs)} landmarks have another id in the log: {listed}"


def _means(given: ExternalEstimate, likeness: Likeness, clues: Clues) -> Diagnosis:
    off = {part.name: part.sigma > LIKE_SIGMA + part.rounding[0] for part in likeness.parts}
    far_poses, far = off["poses"], off.get("landmarks", np.zeros(0, dtype=bool))
    if not far_poses.any() and not far.any():
        return Diagnosis([], [])
    known = _known_path(given, likeness, clues) if far_poses.any() else None
    causes, evidence, partly = [] if known is None else [known], list[Cause](), list[Cause]()
    if known is None and far_poses.any():
        causes, evidence = diagnose(paths_beside(given, likeness.reference, clues.smoothed[0]))
    swapped = _swapped(given, likeness)
    if swapped is not None and not causes:  # another frame exchanges landmarks, too
        (partly if far_poses.any() else causes).append(swapped)
    if not causes or far.any():
        apart = _apart(given, likeness, far_poses, far)
        said = (apart.evidence, *(cause.evidence for cause in evidence))
        causes.append(replace(apart, evidence="; ".join(said)))
    return Diagnosis(causes, partly)


def paths_beside(given: ExternalEstimate, reference: Reference, smoothed: Array) -> list[Paths]:
    """The path of an estimate beside the smoother's (K, 3) and that of a reference."""
    at = reference.known
    time_s, covariance = reference.time_s[at], reference.pose_covariance[at]
    others = {SMOOTHER: smoothed, reference.name: reference.pose}
    return [
        Paths(time_s, given.pose[at], other[at], covariance, name) for name, other in others.items()
    ]


class UndoneMotion(NamedTuple):
    """A motion of all of an estimate, and the estimate without it."""

    motion: PathMotion
    given: ExternalEstimate


def undone_motions(
    given: ExternalEstimate, paths: list[Paths], instants_s: Array
) -> Iterator[UndoneMotion]:
    """Yield the simplest motion of all of an estimate, and another frame alone; none where neither.

    A delay is one that leads to instants (J,) of the log. paths: as of `paths_beside`.
    """
    nearest, motion = simplest_motion(paths)
    if motion.moved == PathTransform():
        return
    yield _without(given, motion, instants_s)
    if motion.gap == "frame" or motion.moved.yaw_rad:
        yield _without(given, frame_at_start(nearest, motion), instants_s)


def _without(given: ExternalEstimate, motion: PathMotion, instants_s: Array) -> UndoneMotion:
    other = undone(given, motion.moved, instants_s)
    delay_s = float(np.median(given.time_s - other.time_s))
    return UndoneMotion(replace(motion, moved=motion.moved._replace(delay_s=delay_s)), other)


def undone(given: ExternalEstimate, moved: PathTransform, instants_s: Array) -> ExternalEstimate:
    """Return an estimate as it was before a motion of its frame, scale or clock.

    A clock that was late by the same everywhere leads back to instants (J,) of the log. Landmarks
    are not of the vehicle's frame, so that they stay where an arm alone is undone.
    """
    arm = moved.arm * np.exp(1j * (given.pose[:, 2] - moved.turn_rad))

    def back(place: Array, arm: NDArray[np.complex128] | complex = 0.0j) -> Array:
        at = (place[:, :2] @ (1.0, 1.0j) - moved.b) / moved.a - arm
        return np.column_stack((at.real, at.imag, place[:, 2:] - moved.turn_rad))

    def turned(
        covariance: Array | None, pose: int, arm: NDArray[np.complex128] | complex = 0.0j
    ) -> Array | None:
        if covariance is None:
            return None
        own = 1.0 / moved.a
        block = np.array(((own.real, -own.imag), (own.imag, own.real)))
        places = (covariance.shape[-1] - pose // 3) // 2
        by = np.kron(np.eye(places), block)
        if pose:
            by = np.insert(np.insert(by, 2, 0.0, axis=0), 2, 0.0, axis=1)
            by[2, 2] = 1.0
            by = np.tile(by, (*covariance.shape[:-2], 1, 1))
            across = -1j * np.asarray(arm)
            by[..., 0, 2], by[..., 1, 2] = across.real, across.imag
        return np.asarray(by @ covariance @ by.swapaxes(-1, -2))

    time_s = given.time_s - moved.delay_s
    nearest = instants_s[np.abs(instants_s[None] - time_s[:, None]).argmin(axis=1)]
    time_s = at_instants(time_s + float(np.median(nearest - time_s)), instants_s)
    return replace(
        given,
        time_s=time_s,
        pose=back(given.pose, arm),
        landmark=None if given.landmark is None else back(given.landmark),
        pose_covariance=turned(given.pose_covariance, 3, arm),
        landmark_covariance=turned(given.landmark_covariance, 0),
        joint_covariance=turned(given.joint_covariance, 3, arm[-1]),
    )


def _known_path(given: ExternalEstimate, likeness: Likeness, clues: Clues) -> Cause | None:
    """Other poses of the same estimators."""
    if clues.before is not None and _fits(given, likeness, clues.before):
        return Cause(
            "time",
            "the poses are those from before the measurement update",
            "write the pose after every update",
        )
    if not likeness.reference.smoothed and _fits(given, likeness, clues.smoothed):
        return Cause(
            "information",
            "the poses are those of the smoother, which uses later measurements",
            'write information = "smoothed" in estimate.toml',
        )
    filtered = clues.filtered() if likeness.reference.smoothed else None
    if filtered is not None and _fits(given, likeness, filtered):
        if clues.closed:
            landmarks = " and landmarks" if len(likeness.theirs) else ""
            return Cause(
                "data",
                f"the poses are those of the log's odometry{landmarks} alone: no loop closure is "
                "used",
                "check that the closures reach the optimiser, and that what is written is its "
                "result, not its start",
            )
        return Cause(
            "information",
            "the poses are those of the reference EKF, which does not use later measurements",
            'write information = "filtered" in estimate.toml, or supply the smoothed trajectory',
        )
    return None


def _fits(given: ExternalEstimate, likeness: Likeness, other: tuple[Array, Array]) -> bool:
    at = likeness.reference.known & np.isfinite(other[1]).all(axis=(1, 2))
    if 2 * at.sum() < len(at):
        return False
    difference = pose_difference(given.pose[at], other[0][at])
    return bool((in_sigma(difference, other[1][at]) <= LIKE_SIGMA).all())


def _apart(
    given: ExternalEstimate,
    likeness: Likeness,
    poses: NDArray[np.bool_],
    landmarks: NDArray[np.bool_],
) -> Cause:
    reference, limit, parts = likeness.reference, f"{100 * LIKE_SIGMA:.0f} % of sigma", []
    if poses.any():
        at = reference.known
        difference = pose_difference(given.pose[at], reference.pose[at])
        sigma, worst = likeness.parts[0].sigma, int(np.argmax(likeness.parts[0].sigma))
        turned = np.degrees(rms(difference[:, 2:]))
        parts.append(
            f"{poses.sum()} of {len(poses)} poses differ by more than {limit} from those of "
            f"{reference.name}: {rms(difference[:, :2]):.3f} m and {turned:.2f} degrees (RMS); the "
            f"pose at {reference.time_s[at][worst]:.2f} s differs most, by {sigma[worst]:.2g} sigma"
        )
    if landmarks.any() and given.landmark is not None:
        sigma = likeness.parts[1].sigma
        worst = int(np.argmax(sigma))
        place = given.landmark[likeness.ours[worst]], reference.landmark[likeness.theirs[worst]]
        parts.append(
            f"{landmarks.sum()} of {len(landmarks)} landmarks differ by more than {limit}, "
            f"landmark {reference.landmark_name(int(likeness.theirs[worst]))} most, by "
            f"{np.linalg.norm(place[0] - place[1]):.3f} m ({sigma[worst]:.2g} sigma)"
        )
    return Cause(
        "estimate",
        "; ".join(parts),
        "check associations, signs and noise; supply a trace, which separates algebra from models"
        if not reference.smoothed
        else "check signs, frames and noise of what the optimiser is given",
    )


def _covariances(given: ExternalEstimate, likeness: Likeness, clues: Clues) -> list[Cause]:
    """One sentence for each part that is off, or one for all where one factor explains them."""
    reference, name = likeness.reference, likeness.reference.name
    off = {p.name for p in likeness.parts if not p.within(np.inf, LIKE_VARIANCE)}
    if not off:
        return []
    at, pairs, said = reference.known, _pairs(given, likeness), []
    hint = (
        "check the noise: a sigma instead of a variance, a factor on R or Q, a dropped "
        "cross-covariance, a measurement used twice; check the export: frame, units, order, time"
    )
    fits = [signatures.fit(*pair) for pair in pairs.values()]
    factors = [fit.factor for fit in fits if fit is not None and not fit.exceptions.any()]
    if len(factors) == len(fits) and max(factors) <= min(factors) * (1.0 + LIKE_VARIANCE):
        every = signatures.of_everything(float(np.median(factors)), name)
        return [Cause("covariance", every, hint)]
    if "poses" in off:
        smoothed = clues.smoothed[1][at]
        before = reference.pose_covariance[at] if clues.before is None else clues.before[1][at]
        poses = signatures.PoseCovariances(
            pairs["poses"][1], given.time_s[at], given.pose[at, 2], before, smoothed
        )
        said.append(signatures.of_poses(pairs["poses"][0], poses, name))
    if "landmarks" in off:
        heading = float(given.pose[-1, 2])
        labels = [reference.landmark_name(row) for row in likeness.theirs.tolist()]
        said.append(signatures.of_landmarks(*pairs["landmarks"], heading, name, labels))
    if "last pose and landmarks" in off and (not said or "landmarks" not in off):
        first, second = pairs["last pose and landmarks"]
        said.append(signatures.of_all(first[0], second[0], name))
    return [Cause("covariance", "; ".join(said), hint)]


def _pairs(given: ExternalEstimate, likeness: Likeness) -> dict[str, tuple[Array, Array]]:
    """Covariances (N, n, n) of the parts that were handed in, and the reference's."""
    reference, at, pairs = likeness.reference, likeness.reference.known, {}
    if given.pose_covariance is not None:
        pairs["poses"] = given.pose_covariance[at], reference.pose_covariance[at]
    if given.landmark_covariance is not None:
        own = reference.landmark_covariances(likeness.theirs)
        pairs["landmarks"] = given.landmark_covariance[likeness.ours], own
    joint = joint_pair(given, reference, (likeness.ours, likeness.theirs))
    if joint is not None:
        pairs["last pose and landmarks"] = joint[0][None], joint[1][None]
    return pairs


def _swapped(given: ExternalEstimate, likeness: Likeness) -> Cause | None:
    """Landmarks that lie where another one's name belongs."""
    ours, theirs, reference = likeness.ours, likeness.theirs, likeness.reference
    if given.landmark is None or len(ours) < 2:
        return None
    other = at_others(given.landmark[ours], reference.landmark[theirs])
    if not other:
        return None
    names = [reference.landmark_name(row) for row in theirs.tolist()]
    pairs = ", ".join(f"{names[k]} lies on {names[nearest]}" for k, nearest in other[:4])
    one = "1 landmark coincides with another"
    some = one if len(other) == 1 else f"{len(other)} landmarks coincide with others"
    return Cause(
        "association",
        f"{some}: {pairs}",
        "check for exchanged ids, and for measurements assigned to the wrong landmark",
    )
