"""Planar motions as (x, y, heading), in metres and radians."""

from __future__ import annotations

import math

import numpy as np

from graphslam.arrays import Array


def compose(first: Array, second: Array) -> Array:
    """(3,) first, then second in the frame that first leads to; headings add unwrapped."""
    cos, sin = math.cos(first[2]), math.sin(first[2])
    return np.array(
        (
            first[0] + cos * second[0] - sin * second[1],
            first[1] + sin * second[0] + cos * second[1],
            first[2] + second[2],
        )
    )


def between(start: Array, end: Array) -> Array:
    """(3,) the motion from start to end, in the frame of start."""
    cos, sin = math.cos(start[2]), math.sin(start[2])
    east, north = end[0] - start[0], end[1] - start[1]
    return np.array((cos * east + sin * north, -sin * east + cos * north, end[2] - start[2]))


def relative(start: Array, end: Array, covariance: Array) -> tuple[Array, Array]:
    """(3,) end in the frame of start, heading wrapped, with its covariance (3, 3) in those axes.

    covariance: (6, 6) of the additive global error of both, start first.
    """
    motion = wrapped(between(start, end))
    cos, sin = math.cos(start[2]), math.sin(start[2])
    jacobian = np.zeros((3, 6))
    jacobian[:2, 3:5] = ((cos, sin), (-sin, cos))
    jacobian[:2, :2] = -jacobian[:2, 3:5]
    jacobian[:2, 2] = motion[1], -motion[0]
    jacobian[2, 2], jacobian[2, 5] = -1.0, 1.0
    return motion, jacobian @ covariance @ jacobian.T


def share(motion: Array, count: int) -> Array:
    """(3,) the motion that, done `count` times, leads where this one does.

    Beyond half a turn, near which no even motion may lead there, its way is that for half a turn.
    """
    arc = min(max(motion[2], -math.pi), math.pi) / count
    # In complex numbers the way is part (1 + q + ... + q^(count - 1)), q being one turn.
    part = complex(motion[0], motion[1]) / np.exp(1j * arc * np.arange(count)).sum()
    return np.array((part.real, part.imag, motion[2] / count))


def rotation(heading: float) -> Array:
    """(3, 3) that turns a pose's own axes, x, y, heading, into those it is seen in."""
    cos, sin = math.cos(heading), math.sin(heading)
    return np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))


def wrapped(difference: Array) -> Array:
    """The same motion with its heading in (-pi, pi]."""
    return np.array((difference[0], difference[1], math.pi - (math.pi - difference[2]) % math.tau))


def carried(covariance: Array, motion: Array) -> Array:
    """(3, 3) a right perturbation's covariance before a motion (3,), seen after it: Ad(T^-1)."""
    x, y, turn = motion
    cos, sin = math.cos(turn), math.sin(turn)
    adjoint = np.array(
        ((cos, sin, -cos * y + sin * x), (-sin, cos, sin * y + cos * x), (0.0, 0.0, 1.0))
    )
    result: Array = adjoint @ covariance @ adjoint.T
    return result


def moved(pose: Array, points: Array) -> Array:
    """Points (N, d) of a body at a pose (3,), in the frame of the pose; heights stay."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    result = points.copy()
    result[:, 0] = cos * points[:, 0] - sin * points[:, 1] + pose[0]
    result[:, 1] = sin * points[:, 0] + cos * points[:, 1] + pose[1]
    return result


def matrix(pose: Array) -> Array:
    """(4, 4) homogeneous transform of a planar pose."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    transform = np.eye(4)
    transform[:2] = ((cos, -sin, 0.0, pose[0]), (sin, cos, 0.0, pose[1]))
    return transform


def from_matrix(transform: Array) -> Array:
    """(3,) the planar part of a homogeneous transform (4, 4)."""
    heading = math.atan2(transform[1, 0], transform[0, 0])
    return np.array((transform[0, 3], transform[1, 3], heading))
