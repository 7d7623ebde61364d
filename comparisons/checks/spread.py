"""Whether an estimate is as near to a sound filter as sound filters are to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.grade import LIKE_SIGMA, LIKE_VARIANCE, Likeness, likeness
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference

_LIKE = np.array((LIKE_SIGMA, np.log1p(LIKE_VARIANCE), np.log1p(LIKE_VARIANCE)))[:, None]


def within_spread(near: Likeness, sound: Sequence[Reference], *, labelled: bool) -> bool:
    """Return whether no part of an estimate is beyond what the sound filters differ by.

    Each pose, each landmark, and the last pose and map together must be no farther from the nearest
    filter than some other filter is, or than `like` allows, in mean and in covariance. near: the
    estimate against the nearest. sound: all filters, at the same times. labelled: ids are the
    log's.
    """
    if near.missing or near.unmapped:
        return False
    others = [
        _beside(reference, near, labelled=labelled)
        for reference in sound
        if reference.name != near.reference.name
    ]
    if not others:
        return False
    for at, part in enumerate(_distances(near)):
        bounds = np.array([other[at] for other in others]).max(axis=0)
        if (part > np.maximum(bounds, _LIKE)).any():
            return False
    return True


def _beside(other: Reference, near: Likeness, *, labelled: bool) -> list[Array]:
    """The distances of another filter's estimate from the nearest, in the rows of its parts."""
    given = ExternalEstimate(
        time_s=other.time_s,
        pose=other.pose,
        landmark_id=other.landmark_id,
        landmark=other.landmark,
        pose_covariance=other.pose_covariance,
        landmark_covariance=other.landmark_covariances(np.arange(len(other.landmark))),
        joint_covariance=other.joint_covariance,
    )
    found = likeness(given, near.reference, labelled=labelled)
    poses, landmarks, joint = _distances(found)
    places = np.zeros((3, len(near.reference.landmark)))
    places[:, found.theirs] = landmarks
    parts = {"poses": poses, "landmarks": places[:, near.theirs], "last pose and landmarks": joint}
    return [parts[part.name] for part in near.parts]


def _distances(found: Likeness) -> Iterator[Array]:
    """Of each part (3, N): in sigma, and logarithms of the variances that are least and largest.

    The least with the opposite sign. Without a covariance both are zero.
    """
    for part in found.parts:
        least, largest = np.maximum(part.least, 1e-300), np.maximum(part.largest, 1e-300)
        logarithms = np.nan_to_num((-np.log(least), np.log(largest)), nan=0.0, posinf=np.inf)
        yield np.vstack((part.sigma, logarithms))
