"""Affine coordinates of points in triangles of landmarks (Nieto 2005, section 3.4.1, Appendix C).

A triangle is L1, L2, L3, the landmarks at the origin, at the end of axis a and at the end of
axis b. Leading dimensions broadcast: triangles (3, 2) with points (N, 2) share one region,
(N, 3, 2) with (N, 2) pair up, (T, 1, 3, 2) with (N, 2) give every point in every region.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Mask

FLATTEST = 1e-9
"""Doubled area over the longest edge squared below which a triangle is a line."""


class DegenerateTriangleError(ValueError):
    """Three base landmarks that are (nearly) on a line, coincide, or are not finite."""


class Jacobians(NamedTuple):
    """Derivatives of one kind of coordinates (two entries) by the other and by the triangle.

    by_point: (..., 2, 2). by_landmarks: (..., 2, 6), columns L1x, L1y, L2x, L2y, L3x, L3y.
    """

    by_point: Array
    by_landmarks: Array


def axes(triangle: Array) -> tuple[Array, Array]:
    """Axes a, b (..., 2) [m] of triangles (..., 3, 2) (Nieto 2005, eqs. 3.6, C.1)."""
    return triangle[..., 1, :] - triangle[..., 0, :], triangle[..., 2, :] - triangle[..., 0, :]


def determinant(triangle: Array) -> Array:
    """Delta (...,) [m^2] of triangles (..., 3, 2) (Nieto 2005, eq. C.6).

    The trap is its sign: Delta = b x a is *negative* where L1, L2, L3 run counter-clockwise.
    """
    a, b = axes(triangle)
    return b[..., 0] * a[..., 1] - b[..., 1] * a[..., 0]


def is_degenerate(triangle: Array) -> Mask:
    """Which triangles (..., 3, 2) span no area to speak of, or are not finite; (...,)."""
    longest = np.zeros(triangle.shape[:-2])
    for corner in range(3):
        edge = triangle[..., corner, :] - triangle[..., corner - 1, :]
        longest = np.maximum(longest, edge[..., 0] * edge[..., 0] + edge[..., 1] * edge[..., 1])
    return ~(np.abs(determinant(triangle)) > FLATTEST * longest)


def circumradius(triangle: Array) -> Array:
    """Radius [m] of the circle through the corners of triangles (C, 3, 2); (C,)."""
    edge = np.linalg.norm(triangle - np.roll(triangle, 1, axis=1), axis=-1)
    radius: Array = edge.prod(axis=1) / (2.0 * np.abs(determinant(triangle)))
    return radius


def to_local(triangle: Array, point: Array) -> Array:
    """Local coordinates alpha, beta (..., 2) of points (..., 2) [m] (Nieto 2005, 3.9, C.3).

    What eqs. 3.1, 3.10 and C.4 call h, once a measurement is a point in the world.

    Raises DegenerateTriangleError.
    """
    _require_area(triangle)
    return solve(triangle, point)


def solve(triangle: Array, point: Array) -> Array:
    """As to_local (3.9, C.3), for callers who have sorted out degenerate triangles themselves."""
    a, b = axes(triangle)
    d = point - triangle[..., 0, :]
    delta = b[..., 0] * a[..., 1] - b[..., 1] * a[..., 0]
    alpha = (d[..., 1] * b[..., 0] - d[..., 0] * b[..., 1]) / delta
    beta = (d[..., 0] * a[..., 1] - d[..., 1] * a[..., 0]) / delta
    return np.stack((alpha, beta), axis=-1)


def to_global(triangle: Array, local: Array) -> Array:
    """Points (..., 2) [m] at local coordinates (..., 2) (Nieto 2005, eqs. 3.7, C.2)."""
    a, b = axes(triangle)
    return triangle[..., 0, :] + local[..., :1] * a + local[..., 1:] * b


def contains(local: Array, tolerance: float = 0.0) -> Mask:
    """Whether local coordinates (..., 2) lie in their triangle; (...,).

    Nieto 2005, eqs. 3.7 and C.2 print alpha > 0, beta > 0, alpha + beta <= 1: this leaves out two
    of the three edges, so that a point on a shared edge may be in both regions or none. Here all
    edges belong, and who locates points breaks the tie.
    """
    inside: Mask = (local.min(axis=-1) >= -tolerance) & (local.sum(axis=-1) <= 1.0 + tolerance)
    return inside


def local_jacobians(triangle: Array, point: Array) -> Jacobians:
    """Derivatives of alpha, beta at points (..., 2) by the point and the landmarks.

    Source: Nieto 2005, eqs. C.5 to C.22. Erratum: C.14 is printed
    d alpha / d d13 = (d_x, -d_y) / Delta with d = x - L1; (d_y, -d_x) / Delta holds.
    Raises DegenerateTriangleError.
    """
    _require_area(triangle)
    a, b = axes(triangle)
    d = point - triangle[..., 0, :]
    delta = determinant(triangle)[..., None]
    local = solve(triangle, point)
    alpha, beta = local[..., :1], local[..., 1:]
    alpha_by_d = turned(b) / delta  # C.11
    beta_by_d = -turned(a) / delta  # C.12
    alpha_by_b = -turned(d) / delta  # C.14, corrected
    beta_by_a = turned(d) / delta  # C.15
    delta_by_1 = turned(a - b)  # C.20, d23 = b - a
    delta_by_2 = turned(b)  # C.21
    delta_by_3 = -turned(a)  # C.22
    by_alpha, by_beta = -alpha / delta, -beta / delta  # C.18, C.19
    alpha_by_landmarks = (
        -alpha_by_d - alpha_by_b + by_alpha * delta_by_1,  # C.7
        by_alpha * delta_by_2,  # C.8
        alpha_by_b + by_alpha * delta_by_3,  # C.9
    )
    beta_by_landmarks = (
        -beta_by_d - beta_by_a + by_beta * delta_by_1,
        beta_by_a + by_beta * delta_by_2,
        by_beta * delta_by_3,
    )
    shape = local.shape[:-1]
    by_point = np.stack(np.broadcast_arrays(alpha_by_d, beta_by_d), axis=-2)
    by_landmarks = np.stack(
        [
            np.concatenate(np.broadcast_arrays(*r), axis=-1)
            for r in (alpha_by_landmarks, beta_by_landmarks)
        ],
        axis=-2,
    )
    return Jacobians(
        np.broadcast_to(by_point, (*shape, 2, 2)), np.broadcast_to(by_landmarks, (*shape, 2, 6))
    )


def global_jacobians(triangle: Array, local: Array) -> Jacobians:
    """Derivatives of the points at alpha, beta (..., 2) by these and by the landmarks.

    From Nieto 2005, eq. 3.7: (a, b), and (1 - alpha - beta) I, alpha I, beta I. They are exact:
    a point is linear in the landmarks at given local coordinates.
    """
    by_local = np.stack(axes(triangle), axis=-1)
    weight = np.concatenate((1.0 - local.sum(axis=-1, keepdims=True), local), axis=-1)
    by_landmarks = np.einsum("...k,ij->...ikj", weight, np.eye(2))
    by_landmarks = by_landmarks.reshape(*local.shape[:-1], 2, 6)
    shape = np.broadcast_shapes(by_local.shape[:-2], local.shape[:-1])
    return Jacobians(
        np.broadcast_to(by_local, (*shape, 2, 2)), np.broadcast_to(by_landmarks, (*shape, 2, 6))
    )


def local_covariance(triangle: Array, point: Array, covariance: Array) -> Array:
    """Covariance (..., 2, 2) of the local coordinates of points (..., 2) known globally.

    covariance: (..., 8, 8) of L1, L2, L3 and the point, with each other (Nieto 2005, C.1).
    Raises DegenerateTriangleError.
    """
    j = local_jacobians(triangle, point)
    jacobian = np.concatenate((j.by_landmarks, j.by_point), axis=-1)
    return jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


def turned(vector: Array) -> Array:
    """(-y, x): vectors (..., 2) a quarter turn to the left."""
    return np.stack((-vector[..., 1], vector[..., 0]), axis=-1)


def _require_area(triangle: Array) -> None:
    flat = np.flatnonzero(is_degenerate(triangle))
    if len(flat):
        first = triangle.reshape(-1, 3, 2)[flat[0]].tolist()
        raise DegenerateTriangleError(
            f"{len(flat)} of {triangle.size // 6} triangles span no area, the first one {first}"
        )
