"""How near an external estimate is to a reference of its own kind: equal, like it, or neither."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import match_landmarks
from comparisons.checks.verdict import Outcome
from comparisons.config import RequiredGrade
from comparisons.covariances import eigenvalue_ranges, relative_difference
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.plane import pose_difference
from comparisons.rounding import ROUNDING, STORED, rounded_to_single, stored_rounding
from comparisons.shown import Brief
from ekf_reference.core.layout import Layout

Grade = Literal["equal", "like", "plausible", "wrong"]
GRADES: tuple[Grade, ...] = ("wrong", "plausible", "like", "equal")
"""From the lowest to the highest."""
LIKE_SIGMA = 0.05
"""Like: no entry of a mean is off by more of the reference's standard deviation."""
LIKE_VARIANCE = 0.05
"""Like: no direction's variance differs by a larger share."""
SMOOTHER = "the smoother"
MOST_LATE_S = 0.5
"""A path that begins or ends so much inside the log's is not all of it."""
_EXACT = 1e-6
"""Variance, by the largest on the path, of a pose that is known exactly, as a start may be."""


class EstimatePart(NamedTuple):
    """One part of an estimate against the reference's.

    sigma: (N,) of each pose or landmark, the largest difference of an entry by the reference's
    standard deviation. least, largest: (N,) generalised eigenvalues of the covariance pair, NaN
    where none was handed in. rounding: what single precision may change of these, where the
    estimate is stored so, of means and of covariances.
    """

    name: str
    sigma: Array
    least: Array
    largest: Array
    rounding: tuple[float, float] = (0.0, 0.0)

    def within(self, sigma: float, variance: float) -> bool:
        """Means and covariances differ by no more."""
        by_mean, by_variance = self.rounding
        near = self.sigma <= sigma + by_mean
        spread = relative_difference(self.least, self.largest)
        return bool(near.all() and not (spread > variance + by_variance).any())


@dataclass(frozen=True, kw_only=True, repr=False)
class Likeness(Brief):
    """An estimate against a reference.

    grade: `equal` or `like`, None for neither. parts: of poses, and of landmarks, last pose and
    map together where handed in. missing, unmapped: what of the reference's path and map the
    estimate has not, or the other way about, in words.
    ours, theirs: rows of the estimate's and of the reference's landmarks that are the same.
    """

    reference: Reference
    grade: Literal["equal", "like"] | None
    parts: tuple[EstimatePart, ...]
    missing: tuple[str, ...]
    unmapped: tuple[str, ...]
    ours: Index
    theirs: Index

    @property
    def single(self) -> bool:
        """Whether some of the estimate is stored in single precision."""
        return any(max(part.rounding) > 0.0 for part in self.parts)

    @property
    def sigma(self) -> float:
        """The largest difference of a mean's entry."""
        return max(float(part.sigma.max(initial=0.0)) for part in self.parts)

    @property
    def farthest(self) -> float:
        """The largest difference, of means in sigma and of covariances in their logarithm."""
        low, high = self.variances or (1.0, 1.0)
        spread = max(abs(np.log(max(low, 1e-300))), abs(np.log(max(high, 1e-300))))
        return max(self.sigma, float(spread))

    @property
    def variances(self) -> tuple[float, float] | None:
        """The least and largest generalised eigenvalue; None without covariances."""
        least = np.concatenate([part.least for part in self.parts])
        largest = np.concatenate([part.largest for part in self.parts])
        if np.isnan(least).all():
            return None
        return float(np.nanmin(least)), float(np.nanmax(largest))


@dataclass(frozen=True, kw_only=True, repr=False)
class Graded(Brief):
    """An estimate's grade. value: None where it is not like any, and the optimum is not verified.

    required: the least that is asked for. by: what it was compared with in the end, the nearest.
    """

    value: Grade | None
    required: RequiredGrade
    by: Likeness | None

    @property
    def enough(self) -> bool:
        """Whether it is what is asked for."""
        return self.value is not None and (GRADES.index(self.value) >= GRADES.index(self.required))


def likeness(given: ExternalEstimate, reference: Reference, *, labelled: bool) -> Likeness:
    """Compare every pose, every landmark, and the last pose and map together.

    given: its poses at the reference's times, and no others. labelled: ids are the log's.
    """
    rows = ours, theirs = match_map(given, reference, labelled=labelled)
    missing, unmapped = _missing(reference), _unmapped(given, reference, ours, labelled=labelled)
    parts = [pose_part(given, reference)]
    if given.landmark is not None:
        parts.append(_landmarks(given, reference, rows))
    if given.joint_covariance is not None:
        parts.append(_joint(given, reference, rows))
    like = all(part.within(LIKE_SIGMA, LIKE_VARIANCE) for part in parts)
    grade: Literal["equal", "like"] | None = None
    if like and not (missing or unmapped):
        grade = "equal" if all(part.within(ROUNDING, ROUNDING) for part in parts) else "like"
    return Likeness(
        reference=reference,
        grade=grade,
        parts=tuple(parts),
        missing=tuple(missing),
        unmapped=tuple(unmapped),
        ours=ours,
        theirs=theirs,
    )


def nearer(first: Likeness | None, second: Likeness) -> Likeness:
    """Return the second where it is nearer by more than rounding: by grade, then by distance."""
    if first is None:
        return second
    ranks = [GRADES.index(one.grade or "wrong") for one in (first, second)]
    if ranks[0] != ranks[1]:
        return second if ranks[1] > ranks[0] else first
    return second if second.farthest < first.farthest * (1.0 - ROUNDING) else first


def graded(
    required: RequiredGrade, near: Likeness | None, against: Sequence[str], *, verified: bool
) -> Graded:
    """Return the grade of an estimate by the reference that it is nearest to, or by the optimum.

    against: what is not plausible beside the optimum. verified: the optimum is.
    """
    value: Grade | None = near.grade if near else None
    if value is None and verified:
        value = "wrong" if against else "plausible"
    return Graded(value=value, required=required, by=near)


def outcome_of(grade: Graded, *, verified: bool, association_known: bool = True) -> Outcome:
    """Return the outcome; an optimum not verified leaves open only what is measured by it.

    association_known: by labels, or beyond doubt; if not, the references may be wrong themselves.
    """
    if grade.value == "wrong":
        return "disagree"
    if grade.value is None and not association_known:
        return "unverified"
    by_optimum = grade.by is None or grade.by.grade is None or grade.by.reference.smoothed
    if by_optimum and not verified and not (grade.value is None and grade.required != "plausible"):
        return "unverified"
    return "agree" if grade.enough else "disagree"


def match_map(
    given: ExternalEstimate, reference: Reference, *, labelled: bool
) -> tuple[Index, Index]:
    """Return the rows of the landmarks that both have. labelled: ids are the log's."""
    if given.landmark is None or given.landmark_id is None:
        none = np.zeros(0, dtype=np.intp)
        return none, none
    return match_landmarks(
        (given.landmark_id, given.landmark),
        (reference.landmark_id, reference.landmark),
        labelled=labelled,
    )


def in_sigma(difference: Array, covariance: Array) -> Array:
    """Return the largest entry (K,) of differences (K, n) in standard deviations."""
    found: Array = (np.abs(difference) / np.sqrt(np.diagonal(covariance, 0, 1, 2))).max(axis=1)
    return found


def joint_rows(landmarks: Index) -> Index:
    """Return the entries of the last pose and some landmarks (m,) in a joint covariance."""
    return Layout.packed(3, int(landmarks.max(initial=-1)) + 1).columns(landmarks)


def joint_pair(
    given: ExternalEstimate, reference: Reference, rows: tuple[Index, Index]
) -> tuple[Array, Array] | None:
    """Return the joint covariances (n, n) of an estimate and a reference, None without any.

    Of the last pose and the landmarks that both have, of these alone where the poses are of
    different times. rows: of these landmarks in either.
    """
    ours, theirs = map(joint_rows, rows)
    if abs(reference.time_s[-1] - reference.joint_s) > CLOCK_S:
        ours, theirs = ours[3:], theirs[3:]
    if given.joint_covariance is None or not len(ours):
        return None
    return (
        given.joint_covariance[np.ix_(ours, ours)],
        reference.joint_covariance[np.ix_(theirs, theirs)],
    )


def pose_part(given: ExternalEstimate, reference: Reference) -> EstimatePart:
    """Compare the poses. given: these at the reference's times, and no others."""
    at = reference.known
    own = reference.pose_covariance[at]
    difference = pose_difference(given.pose[at], reference.pose[at])
    cover = None if given.pose_covariance is None else given.pose_covariance[at]
    ratios = eigenvalue_ranges(None if cover is None else _started(cover, own), own)
    rounding = (
        _mean_rounding(given.pose[:, :2], reference.pose[at], own),
        _covariance_rounding(cover, own),
    )
    return EstimatePart("poses", in_sigma(difference, own), *ratios, rounding)


def _started(given: Array, own: Array) -> Array:
    """Covariances (K, 3, 3) as given; the reference's where both know the pose exactly."""
    variance, others = (np.diagonal(one, 0, 1, 2) for one in (given, own))
    nothing = _EXACT * others.max(axis=0, initial=0.0)
    exact = (np.abs(variance) <= nothing).all(axis=1) & (others <= nothing).all(axis=1)
    return np.where(exact[:, None, None], own, given)


def _landmarks(
    given: ExternalEstimate, reference: Reference, rows: tuple[Index, Index]
) -> EstimatePart:
    ours, theirs = rows
    own = reference.landmark_covariances(theirs)
    theirs_at = reference.landmark[theirs]
    at = np.zeros((0, 2)) if given.landmark is None else given.landmark[ours]
    cover = None if given.landmark_covariance is None else given.landmark_covariance[ours]
    rounding = _mean_rounding(at, theirs_at, own), _covariance_rounding(cover, own)
    return EstimatePart(
        "landmarks", in_sigma(at - theirs_at, own), *eigenvalue_ranges(cover, own), rounding
    )


def _joint(
    given: ExternalEstimate, reference: Reference, rows: tuple[Index, Index]
) -> EstimatePart:
    pair = joint_pair(given, reference, rows)
    if pair is None:
        none = np.zeros(0)
        return EstimatePart("last pose and landmarks", none, none, none)
    first, second = pair[0][None], pair[1][None]
    rounding = 0.0, _covariance_rounding(first, second)
    return EstimatePart(
        "last pose and landmarks", np.zeros(1), *eigenvalue_ranges(first, second), rounding
    )


def _mean_rounding(stored: Array, mean: Array, covariance: Array) -> float:
    """Return what single precision changes of means (K, n) [sigma], where they are stored so."""
    if not stored_rounding(stored):
        return 0.0
    return STORED * float(in_sigma(mean - rounded_to_single(mean), covariance).max())


def _covariance_rounding(stored: Array | None, covariance: Array) -> float:
    """Return what it changes of the eigenvalues of covariances (K, n, n), as above."""
    if stored is None or not stored_rounding(stored):
        return 0.0
    low, high = eigenvalue_ranges(rounded_to_single(covariance), covariance)
    return STORED * float(relative_difference(low, high).max())


def _missing(reference: Reference) -> Sequence[str]:
    """What of the path the estimate has not, whose times the reference's are."""
    (begin, end), (first, last), missing = reference.span_s, reference.time_s[[0, -1]], []
    if first - begin > max(MOST_LATE_S, 0.05 * (end - begin)):
        missing.append(f"the trajectory starts at {first:.1f} s, the log at {begin:.1f} s")
    if end - last > MOST_LATE_S:
        missing.append(f"the trajectory ends at {last:.1f} s, the log at {end:.1f} s")
    if not reference.known.any():
        missing.append("no pose has the time of a measurement of the log")
    return missing


def _unmapped(
    given: ExternalEstimate, reference: Reference, ours: Index, *, labelled: bool
) -> Sequence[str]:
    """What the reference's map has and the estimate's has not, or the other way about."""
    missing = []
    if given.landmark is not None:
        lacking, more = len(reference.landmark) - len(ours), len(given.landmark) - len(ours)
        if given.removed is not None:
            gone = np.array(given.removed.landmark_id)
            theirs = np.isin(gone, reference.landmark_id) if labelled else gone >= 0
            lacking = max(0, lacking - int(np.count_nonzero(theirs)))
        if lacking:
            of = len(reference.landmark)
            missing.append(f"{lacking} of {of} landmarks of the log are missing in the map")
        if more:
            missing.append(f"{more} landmarks of the map are unknown to {reference.name}")
    return missing
