"""Errors of one trajectory against another, by evo's definitions: no log, no truth is needed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import relative_errors, rigid_motion
from comparisons.checks.pair_of_estimates import if_definite, nees_of
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.stamps import nearest_instants
from comparisons.plane import pose_difference, rms

TOGETHER_S = 0.01
"""Stamps that are no farther apart are of one instant, as evo's `--t_max_diff` has it."""


class PathErrors(NamedTuple):
    """Errors of an estimate's poses (K, 3) at the instants (N,) that both trajectories have.

    Attributes:
        time_s: (N,) of the reference.
        pose: (N, 3) of the estimate, aligned if that was asked for.
        place_m: (N,) distances from the reference's positions (evo's APE).
        heading_rad: (N,) turns from its headings, from 0 to pi.
        moved_m: (P,) differences of the motion over 10 m of the reference's path (evo's RPE).
        turned_rad: (P,) and of the turn on it.
        poses: K, those of the estimate.
        nees: Squared errors over their covariance per degree of freedom, expected 1; None where the
            estimate has no covariances, or was aligned.
    """

    time_s: Array
    pose: Array
    place_m: Array
    heading_rad: Array
    moved_m: Array
    turned_rad: Array
    poses: int
    nees: float | None

    def figures(self) -> dict[str, float | None]:
        """Return all errors by name, in metres and degrees."""
        every = {
            "ape_m": self.place_m,
            "ape_deg": np.degrees(self.heading_rad),
            "rpe_10m_m": self.moved_m,
            "rpe_10m_deg": np.degrees(self.turned_rad),
        }
        figures: dict[str, float | None] = {
            f"{name}.{word}": number
            for name, errors in every.items()
            for word, number in error_statistics(errors).items()
        }
        return figures | {"nees_per_dof": self.nees}


def path_errors(
    estimate: ExternalEstimate, reference: ExternalEstimate, *, align: bool = False
) -> PathErrors:
    """Compare two trajectories where their stamps agree.

    Args:
        estimate: Whose errors are asked for.
        reference: What it is compared with.
        align: Turn and move the estimate first, without scale, to fit the reference best in least
            squares of the positions.

    Raises:
        InputError: No stamps of the two agree.
    """
    ours, theirs = _matched(estimate.time_s, reference.time_s)
    if not len(ours):
        spans = " and ".join(
            f"{path.time_s[0]:.6f} to {path.time_s[-1]:.6f} s" for path in (estimate, reference)
        )
        raise InputError(
            f"no stamps of the trajectories are within {TOGETHER_S:g} s of each other: they have "
            f"{spans}"
        )
    pose, true = estimate.pose[ours], reference.pose[theirs]
    if align:
        pose = _aligned(pose, true)
    difference, covariance = pose_difference(pose, true), estimate.pose_covariance
    moved_m, turned_rad = relative_errors(pose, true)
    return PathErrors(
        time_s=reference.time_s[theirs],
        pose=pose,
        place_m=np.hypot(*difference[:, :2].T),
        heading_rad=np.abs(difference[:, 2]),
        moved_m=moved_m,
        turned_rad=turned_rad,
        poses=len(estimate.pose),
        nees=None if align or covariance is None else _nees(difference, covariance[ours]),
    )


def _matched(ours_s: Array, theirs_s: Array) -> tuple[Index, Index]:
    """Rows of stamps that agree: of the fewer stamps each with the nearest of the others."""
    if len(ours_s) > len(theirs_s):
        theirs, ours = _matched(theirs_s, ours_s)
        return ours, theirs
    nearest = nearest_instants(ours_s, theirs_s)
    together = np.abs(theirs_s[nearest] - ours_s) <= TOGETHER_S
    return np.flatnonzero(together), nearest[together]


def _aligned(pose: Array, reference: Array) -> Array:
    """Poses (N, 3) turned and moved to those of a reference (N, 3)."""
    motion = rigid_motion(pose[:, :2], reference[:, :2])
    origin, ahead = motion(np.array(((0.0, 0.0), (1.0, 0.0))))
    east, north = ahead - origin
    return np.column_stack((motion(pose[:, :2]), pose[:, 2] + np.arctan2(north, east)))


def _nees(difference: Array, covariance: Array) -> float | None:
    """Mean of squared differences (N, 3) over their covariances (N, 3, 3), a degree of freedom."""
    each = nees_of(difference, if_definite(covariance))
    known = each[np.isfinite(each)]
    return float(known.mean()) / difference.shape[1] if len(known) else None


def error_statistics(errors: Array) -> dict[str, float]:
    """Return statistics of errors (N,) as evo calls them; none where there are no errors."""
    if not len(errors):
        return {}
    return {
        "rms": rms(errors[:, None]),
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "std": float(errors.std()),
        "min": float(errors.min()),
        "max": float(errors.max()),
    }
