"""Noise of motions between poses that came with covariances of their own, as ROS's Odometry has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.odometry import NOISE_TEXT, RelativePoses, displacements, poses_at

LARGEST_VARIANCE = 1e3
"""Drivers write larger ones for what they do not measure."""
LEAST_VARIANCE = 1e-6
"""[(m/s)^2] and [(rad/s)^2] of speeds: smaller ones are placeholders, of 1 mm/s and less."""
_POSE = ("x", "y", "heading")
_SPEEDS = (("speed", LEAST_VARIANCE), ("sideways speed", 0.0), ("yaw rate", LEAST_VARIANCE))
_LEAST_SIGMA = 1e-3
"""[m] and [rad] that each motion of odometry's own noise has besides."""


class Unusable(NamedTuple):
    """Why covariances of poses and of twists are of no use, empty for what may be of use."""

    pose: str = ""
    twist: str = ""


_MAY_BE_OF_USE = Unusable()


def reckoned_motion(
    instants_s: Array, sample_s: Array, rows: Array, unusable: Unusable = _MAY_BE_OF_USE
) -> tuple[RelativePoses, str]:
    """Return the motions between instants by messages of odometry, and where their noise is from.

    instants_s: (N,) within the samples' time (M,). rows: (M, 15) pose, variances of vx, vy and yaw
    rate, covariance (3, 3) of the pose. unusable: what is known of them besides.
    """
    motion = displacements(instants_s, poses_at(instants_s, sample_s, rows[:, :3]))
    added, words = odometry_noise(sample_s, rows, unusable)
    if added is None:
        return motion, f"{NOISE_TEXT}, for {words}"
    covariance = added_between(instants_s, sample_s, added) + _LEAST_SIGMA**2 * np.eye(3)
    words += f", and {_LEAST_SIGMA:g} m and rad a motion"
    return RelativePoses(motion.time_s, motion.displacement, covariance), words


def added_between(instants_s: Array, sample_s: Array, added: Array) -> Array:
    """Return the covariances (N - 1, 3, 3) between instants (N,), of those between samples (M,)."""
    total = np.concatenate((np.zeros((1, 9)), np.cumsum(added.reshape(-1, 9), axis=0)))
    reported = np.column_stack([np.interp(instants_s, sample_s, one) for one in total.T])
    return np.diff(reported, axis=0).reshape(-1, 3, 3)


def odometry_noise(
    time_s: Array, rows: Array, unusable: Unusable = _MAY_BE_OF_USE
) -> tuple[Array | None, str]:
    """(M - 1, 3, 3) covariances of the motions between odometry's messages, and words on them.

    time_s, rows, unusable: as in `reckoned_motion`. None where the messages hold no usable
    covariances: those of poses must grow as poses that are reckoned do; those of velocities lie
    between LEAST_VARIANCE and LARGEST_VARIANCE. In the arriving frame.
    """
    if len(rows) < 2:
        return None, "one message of Odometry"
    covariance, variance = rows[:, 6:].reshape(-1, 3, 3), rows[:-1, 3:6]
    grown, fault = None, unusable.pose or pose_fault(covariance)
    if not fault:
        grown = _growth(rows[:, :3], covariance)
        fault = "do not grow as those of reckoned poses do"
    if grown is not None:
        return grown, "the increments of Odometry's pose covariances"
    other = unusable.twist or _twist_fault(variance)
    if not other:
        steps = variance * np.diff(time_s)[:, None] ** 2
        words = f"Odometry's twist covariances, each sample's own (its pose covariances {fault})"
        return steps[:, :, None] * np.eye(3), words
    return None, f"Odometry's pose covariances {fault}, and its twist covariances {other}"


def pose_fault(covariance: Array) -> str:
    """Return why covariances (M, 3, 3) of x, y and heading are none; empty where they may be."""
    if not np.isfinite(covariance).all():
        return "are not finite"
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    for name, column in zip(_POSE, variances.T, strict=True):
        if column.min() < 0.0:
            return f"have a variance of {name} of {column.min():g}"
        if column.max() > LARGEST_VARIANCE:
            return f"have a variance of {name} of {column.max():g}, above {LARGEST_VARIANCE:g}"
    if not variances.any(axis=0).all():
        missing = [name for name, column in zip(_POSE, variances.T, strict=True) if not any(column)]
        return "are 0" if len(missing) == len(_POSE) else f"have no variance of {missing[0]}"
    if np.abs(covariance).max() > LARGEST_VARIANCE:
        return f"have an entry of {np.abs(covariance).max():g}, above {LARGEST_VARIANCE:g}"
    if len(covariance) > 1 and (covariance == covariance[0]).all():
        return "are the same at every pose"
    return ""


def _twist_fault(variance: Array) -> str:
    """Why variances (M, 3) of speeds are none; empty where they may be."""
    if not np.isfinite(variance).all():
        return "are not finite"
    if not variance.any():
        return "are 0"
    for (name, least), column in zip(_SPEEDS, variance.T, strict=True):
        if column.min() < least:
            return f"have a variance of {name} of {column.min():g}, below {least:g}"
        if column.max() > LARGEST_VARIANCE:
            return f"have a variance of {name} of {column.max():g}, above {LARGEST_VARIANCE:g}"
    return ""


def _growth(pose: Array, covariance: Array) -> Array | None:
    """What each motion adds, seen from where it arrives; None where any takes something away."""
    step = np.diff(pose[:, :2], axis=0)
    carry = np.broadcast_to(np.eye(3), (len(step), 3, 3)).copy()
    carry[:, 0, 2], carry[:, 1, 2] = -step[:, 1], step[:, 0]
    added = covariance[1:] - carry @ covariance[:-1] @ carry.transpose(0, 2, 1)
    added = (added + added.transpose(0, 2, 1)) / 2
    scale = np.abs(covariance).max(initial=0.0)
    if not scale or np.linalg.eigvalsh(added)[:, 0].min() < -1e-9 * scale:
        return None
    moving = np.hypot(*step.T) > 1e-3
    if not moving.any() or np.trace(added[moving], axis1=1, axis2=2).min() <= 0.0:
        return None
    c, s = np.cos(pose[1:, 2]), np.sin(pose[1:, 2])
    turned = np.zeros((len(step), 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = c
    turned[:, 0, 1], turned[:, 1, 0], turned[:, 2, 2] = s, -s, 1.0
    return turned @ added @ turned.transpose(0, 2, 1)
