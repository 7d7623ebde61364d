"""Noise of motions between poses that came with covariances of their own, as ROS's Odometry has."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.odometry import NOISE_TEXT, RelativePoses, displacements, poses_at

LARGEST_VARIANCE = 1e3
"""Drivers write larger ones for what they do not measure."""
_LEAST_SIGMA = 1e-3
"""[m] and [rad] that each motion of odometry's own noise has besides."""


def reckoned_motion(instants_s: Array, sample_s: Array, rows: Array) -> tuple[RelativePoses, str]:
    """Return the motions between instants by messages of odometry, and where their noise is from.

    instants_s: (N,) within the samples' time (M,). rows: (M, 15) pose, variances of vx, vy and yaw
    rate, covariance (3, 3) of the pose.
    """
    motion = displacements(instants_s, poses_at(instants_s, sample_s, rows[:, :3]))
    added, words = odometry_noise(sample_s, rows)
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


def odometry_noise(time_s: Array, rows: Array) -> tuple[Array | None, str]:
    """(M - 1, 3, 3) covariances of the motions between odometry's messages, and words on them.

    time_s, rows: (M,), (M, 15) as in `reckoned_motion`. None where the messages hold no usable
    covariances: those of poses must grow as poses that are reckoned do; those of velocities lie
    above zero. In the arriving frame.
    """
    if not np.isfinite(rows[:, 3:]).all():
        return None, "covariances of Odometry are not finite"
    if len(rows) < 2:
        return None, "one message of Odometry"
    grown = _growth(rows[:, :3], rows[:, 6:].reshape(-1, 3, 3))
    if grown is not None:
        return grown, "the increments of Odometry's pose covariances"
    variance = rows[:-1, 3:6]
    positive = (variance[:, [0, 2]] > 0).all() and (variance >= 0).all()
    if positive and (variance <= LARGEST_VARIANCE).all():
        steps = variance * np.diff(time_s)[:, None] ** 2
        return steps[:, :, None] * np.eye(3), "Odometry's twist covariances, each sample's own"
    return None, (
        "Odometry's pose covariances do not grow as reckoned ones do, and its twist covariances "
        f"are not above zero and at most {LARGEST_VARIANCE:g}"
    )


def _growth(pose: Array, covariance: Array) -> Array | None:
    """What each motion adds, seen from where it arrives; None where any takes something away."""
    if np.abs(covariance).max() > LARGEST_VARIANCE:
        return None
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
