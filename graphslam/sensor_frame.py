"""The frame on the vehicle whose motions are measured, where these are not the vehicle's own."""

from __future__ import annotations

import numpy as np

from graphslam.arrays import Array, Index

_NOISE = 12.0
"""Median squared residual of an edge, whitened, up to which edges fit: four times the expected."""
_FAR = 100.0
"""So many times less must be left than beside the poses' own motions."""
_FEWEST = 10


def mount(first: Index, second: Index, motion: Array, poses: Array) -> Array:
    """Return x, y and heading of the frame whose motions (N, 3) are, beside poses (K, 3).

    A motion (t, h) of it is one of the vehicle by turn t + (1 - exp(i h)) place, in complex
    numbers: linear least squares, but for the turn's size.
    """
    moved = _moved(first, second, poses)
    columns = np.column_stack((motion[:, :2] @ (1.0, 1.0j), 1.0 - np.exp(1j * motion[:, 2])))
    turn, place = np.linalg.lstsq(columns, moved, rcond=None)[0]
    return np.array((place.real, place.imag, np.angle(turn)))


def other_frame(
    first: Index, second: Index, motion: Array, covariance: Array, poses: Array
) -> Array | None:
    """Return the mount that explains motions beside poses that are of another frame.

    Args:
        first: (N,) poses that motions depart from.
        second: (N,) poses that they lead to.
        motion: (N, 3) in the departing frame.
        covariance: (N, 3, 3).
        poses: (K, 3) that are to be explained, as a file's vertices.

    Returns:
        x, y and heading of the motions' frame in the poses'; None where the poses have these
        motions, or no frame of the vehicle has.
    """
    if len(first) < _FEWEST:
        return None
    found = mount(first, second, motion, poses)
    own, other = (
        float(np.median(_squared(first, second, motion, covariance, poses, frame)))
        for frame in (np.zeros(3), found)
    )
    return found if other <= _NOISE and own >= _FAR * other else None


def _moved(first: Index, second: Index, poses: Array) -> Array:
    """Return displacements (N,) in the departing frame, as complex numbers."""
    places, ahead = poses[:, :2] @ (1.0, 1.0j), np.exp(1j * poses[:, 2])
    return np.asarray((places[second] - places[first]) / ahead[first])


def _squared(
    first: Index, second: Index, motion: Array, covariance: Array, poses: Array, frame: Array
) -> Array:
    """Return squared residuals (N,), whitened, of motions as those of a frame on the vehicle."""
    turned = np.exp(1j * (poses[second, 2] - poses[first, 2]))
    moved = _moved(first, second, poses) + (turned - 1.0) * complex(*frame[:2])
    apart = moved * np.exp(-1j * frame[2]) - motion[:, :2] @ (1.0, 1.0j)
    heading = np.angle(turned * np.exp(-1j * motion[:, 2]))
    residual = np.column_stack((apart.real, apart.imag, heading))
    whitened = np.linalg.solve(covariance, residual[:, :, None])[:, :, 0]
    squared: Array = (residual * whitened).sum(axis=1)
    return squared


def in_words(ahead_m: float, left_m: float, *, digits: int = 2) -> str:
    """Say where a place is, as seen from a vehicle.

    Args:
        ahead_m: Negative behind.
        left_m: Negative to the right.
        digits: Of the numbers.
    """
    along, aside = "behind" if ahead_m < 0.0 else "ahead", "right" if left_m < 0.0 else "left"
    return f"{abs(ahead_m):.{digits}f} m {along} and {abs(left_m):.{digits}f} m to the {aside}"
