"""Someone else's estimate against the smoother: what is absent narrows what can be said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import match_landmarks
from comparisons.checks.agreement import (
    LARGEST_DISTANCE,
    LEAST_VARIANCE_RATIO,
    eigenvalue_range,
)
from comparisons.checks.causes import Cause
from comparisons.checks.diagnosis.diagnosis import Paths, diagnose, rms
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import GivenEstimate
from ekf_reference.core.geometry import wrap_angle

_SURE = 0.999
_MOST_OUTSIDE = 0.01
"""Share of poses that may lie beyond their 99.9 % region."""
_MOST_LATE_S = 0.5
_GENEROUS = 2.0
_FLOOR_M = 0.05
"""Differences that one estimate may have from another of its kind, in RMS over all poses."""
_SWAPPED = 3.0
"""Names are taken for exchanged where another landmark is so many times nearer."""


@dataclass(frozen=True)
class Block:
    """The given estimate against the smoother's in one block of the state.

    distance: root of d^T P_S^-1 d / dim. least, largest: generalised eigenvalues of the pair
    (P given, P_S); None where no covariance was given.
    """

    difference_m: float
    distance: float
    least: float | None = None
    largest: float | None = None

    @property
    def near(self) -> bool:
        """As near as the optimum itself is certain."""
        return self.distance <= LARGEST_DISTANCE

    @property
    def sure_enough(self) -> bool:
        """No variance too small or too large by more than the bound, as far as one was given."""
        if self.least is None or self.largest is None:
            return True
        return self.least >= LEAST_VARIANCE_RATIO and self.largest <= 1.0 / LEAST_VARIANCE_RATIO


@dataclass(frozen=True, kw_only=True)
class GivenAgreement:
    """All that could be compared.

    time_s: (K,) the given poses inside the log's time, pose: (K, 3), and the smoother's there,
    reference: (K, 3). rms_m, rms_heading_rad: of their differences. outside: share of them beyond
    the 99.9 % region of the given covariances; None without. last: the last pose; None where
    it lies before the log's last epoch. landmark_id: (M,) of those compared, landmarks: as many.
    unmatched: landmarks given that the smoother does not have. causes: why they disagree, if so.
    """

    time_s: Array
    pose: Array
    reference: Array
    rms_m: float
    rms_heading_rad: float
    outside: float | None
    last: Block | None
    landmark_id: NDArray[np.int64]
    landmarks: tuple[Block, ...]
    unmatched: int
    causes: tuple[Cause, ...]


def compare_given(
    given: GivenEstimate,
    smoothed: Estimate,
    reference: Array,
    *,
    labelled: bool,
    peer: Callable[[], Array] | None = None,
) -> GivenAgreement:
    """Compare all that is there.

    reference: (K, 3) the smoother's poses at the given times. labelled: ids are the log's.
    peer: gives a right estimate of the same kind there (K, 3), the smoother's by default; asked
    where it is needed. Poses without covariances may be a few times as far from the smoother's
    as it is.

    Raises InputError where the estimate has no pose in the log's time.
    """
    first, last = smoothed.time_s[0], smoothed.time_s[-1]
    inside = (given.time_s >= first - 1e-4) & (given.time_s <= last + 1e-4)
    if not inside.any():
        raise InputError(
            f"the estimate's times, {given.time_s[0]:.3f} to {given.time_s[-1]:.3f} s, lie outside "
            f"the log's, {first:.3f} to {last:.3f} s; expected the log's own clock"
        )
    time_s, pose, reference = given.time_s[inside], given.pose[inside], reference[inside]
    difference = _wrapped(pose - reference)
    outside = None
    if given.pose_covariance is not None:
        outside = _outside(difference, given.pose_covariance[inside])
    end = None
    if last - time_s[-1] <= _MOST_LATE_S:
        cover = None if given.pose_covariance is None else given.pose_covariance[inside][-1]
        end = _block(difference[-1], smoothed.joint_covariance[:3, :3], cover)
    ours, theirs = _matched(given, smoothed, labelled=labelled)
    blocks = _landmark_blocks(given, smoothed, ours, theirs)
    found = GivenAgreement(
        time_s=time_s,
        pose=pose,
        reference=reference,
        rms_m=float(np.sqrt(np.square(difference[:, :2]).sum(axis=1).mean())),
        rms_heading_rad=float(np.sqrt(np.square(difference[:, 2]).mean())),
        outside=outside,
        last=end,
        landmark_id=smoothed.landmark_id[theirs],
        landmarks=tuple(blocks),
        unmatched=(0 if given.landmark is None else len(given.landmark)) - len(ours),
        causes=(),
    )

    @cache
    def alike() -> Array:
        return reference if peer is None else peer()[inside]

    poses_off = _poses_off(found, alike)
    swapped = _swapped(given, smoothed, ours, theirs)
    causes = _causes(found, lambda: Paths(time_s, pose, alike()), swapped, poses_off)
    return replace(found, causes=tuple(causes))


def _landmark_blocks(
    given: GivenEstimate, smoothed: Estimate, ours: Index, theirs: Index
) -> list[Block]:
    if given.landmark is None:
        return []
    own = smoothed.landmark_covariances()
    blocks = []
    for i, j in zip(ours.tolist(), theirs.tolist(), strict=True):
        cover = None if given.landmark_covariance is None else given.landmark_covariance[i]
        blocks.append(_block(given.landmark[i] - smoothed.landmark[j], own[j], cover))
    return blocks


def _causes(
    found: GivenAgreement, paths: Callable[[], Paths], swapped: Cause | None, poses_off: str
) -> list[Cause]:
    far = [k for k, block in enumerate(found.landmarks) if not block.near]
    causes = []
    if poses_off or far:
        causes += diagnose(paths())
        if swapped is not None and not causes:  # another frame exchanges landmarks, too
            causes.append(swapped)
        if not causes or far:
            causes.append(_position(found, far, poses_off))
    unsure = [k for k, block in enumerate(found.landmarks) if not block.sure_enough]
    ends = found.last is not None and not found.last.sure_enough
    if unsure or ends:
        causes.append(_covariance(found, unsure))
    return causes


def _poses_off(found: GivenAgreement, alike: Callable[[], Array]) -> str:
    """What is wrong with the poses, in words; empty when nothing is."""
    parts = []
    if found.last is not None and not found.last.near:
        parts.append(
            f"the last pose is off by {found.last.difference_m:.2f} m "
            f"({found.last.distance:.1f} sigma)"
        )
    if found.outside is not None and found.outside > _MOST_OUTSIDE:
        parts.append(
            f"{100.0 * found.outside:.0f} % of the poses lie beyond their own 99.9 % region, "
            f"{found.rms_m:.2f} m off (RMS)"
        )
    elif found.outside is None:
        expected_m = _GENEROUS * rms((alike() - found.reference)[:, :2]) + _FLOOR_M
        if found.rms_m > expected_m:
            parts.append(
                f"the poses are {found.rms_m:.2f} m off (RMS), where {expected_m:.2f} m could be"
            )
    return "; ".join(parts)


def _position(found: GivenAgreement, far: list[int], poses_off: str) -> Cause:
    parts = []
    if far:
        worst = max(far, key=lambda k: found.landmarks[k].distance)
        block = found.landmarks[worst]
        parts.append(
            f"{len(far)} of {len(found.landmarks)} landmarks are too far off, landmark "
            f"{found.landmark_id[worst]} by {block.difference_m:.2f} m ({block.distance:.1f} sigma)"
        )
    return Cause(
        "estimate",
        "; ".join(filter(None, (*parts, poses_off))),
        "a trace would tell algebra from model; look first at associations, signs and noise",
    )


def _covariance(found: GivenAgreement, unsure: list[int]) -> Cause:
    blocks = [found.landmarks[k] for k in unsure]
    if found.last is not None and not found.last.sure_enough:
        blocks.append(found.last)
    ratios = [r for b in blocks for r in (b.least, b.largest) if r is not None]
    worst = float(max(ratios, key=lambda r: abs(float(np.log(max(r, 1e-300))))))
    typical = float(np.median(ratios))
    return Cause(
        "covariance",
        f"{len(unsure)} of {len(found.landmarks)} landmarks have a wrong covariance, at worst "
        f"{worst:.3g} times the justified variance, typically {typical:.3g} times",
        "look at the noise: a sigma where a variance is meant, a factor on R or Q, a dropped "
        "cross-covariance, sightings used twice",
    )


def _swapped(given: GivenEstimate, smoothed: Estimate, ours: Index, theirs: Index) -> Cause | None:
    """Landmarks that lie where another one's name belongs."""
    if given.landmark is None or len(ours) < 2:
        return None
    apart = np.linalg.norm(given.landmark[ours][:, None] - smoothed.landmark[theirs][None], axis=2)
    own = np.diag(apart)
    nearest = apart.argmin(axis=1)
    other = np.flatnonzero(
        (nearest != np.arange(len(own))) & (_SWAPPED * apart.min(axis=1) < own) & (own > 0.5)
    )
    if not len(other) or len(other) > 0.5 * len(own):
        return None
    ids = smoothed.landmark_id[theirs]
    pairs = ", ".join(f"{ids[k]} at {ids[nearest[k]]}" for k in other[:4])
    return Cause(
        "association",
        f"{len(other)} landmarks lie where another is: {pairs}",
        "look at the names: ids exchanged, or sightings given to the wrong landmark",
    )


def _matched(given: GivenEstimate, smoothed: Estimate, *, labelled: bool) -> tuple[Index, Index]:
    none = np.zeros(0, dtype=np.intp)
    if given.landmark is None or given.landmark_id is None:
        return none, none
    return match_landmarks(
        (given.landmark_id, given.landmark),
        (smoothed.landmark_id, smoothed.landmark),
        labelled=labelled,
    )


def _block(difference: Array, covariance: Array, given: Array | None) -> Block:
    d = difference
    square = float(d @ np.linalg.solve(covariance, d))
    distance = float(np.sqrt(max(square, 0.0) / len(d)))
    metres = float(np.hypot(d[0], d[1]))
    if given is None:
        return Block(metres, distance)
    return Block(metres, distance, *eigenvalue_range(given, covariance))


def _outside(difference: Array, covariance: Array) -> float:
    """Share of the poses beyond their own region; one without a usable covariance is."""
    limit = float(chi2.ppf(_SURE, 3))
    positive = np.linalg.eigvalsh(covariance)[:, 0] > 0.0
    safe = np.where(positive[:, None, None], covariance, np.eye(3))
    square = np.einsum("ki,ki->k", difference, np.linalg.solve(safe, difference[..., None])[..., 0])
    return float(np.mean(~positive | (square > limit)))


def _wrapped(difference: Array) -> Array:
    difference = difference.copy()
    difference[:, 2] = wrap_angle(difference[:, 2])
    return difference
