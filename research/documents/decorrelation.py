"""How local coordinates of a point reduce its correlation with the rest of the map.

Nieto 2005, sections 3.3 and 3.6: Example 3.1 (eqs. 3.4 and 3.5) and Example 3.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.triangles import axes, local_covariance, local_jacobians, to_local


class Correlations(NamedTuple):
    """Correlation coefficients (k, 2) of k states with the two coordinates of a point.

    world: its east and north. local: its alpha and beta. sigma_world_m: (2,) [m].
    sigma_local_m: (2,) [m], those of alpha and beta times the length of their axes.
    """

    world: Array
    local: Array
    sigma_world_m: Array
    sigma_local_m: Array


class Displacements(NamedTuple):
    """How far a point has moved (...,) [m]: in the world, and within its triangle."""

    world_m: Array
    local_m: Array


def local_cross_covariance(
    triangle: Array, point: Array, with_landmarks: Array, with_point: Array
) -> Array:
    """P_jL (k, 2), covariance of any k states with a point's alpha and beta.

    Source: Nieto 2005, eqs. 3.4, 3.5. triangle: (3, 2) [m]. point: (2,) [m]. with_landmarks: (k, 6)
    P_jb. with_point: (k, 2) P_jG. Raises DegenerateTriangleError.
    """
    h = local_jacobians(triangle, point)
    return with_landmarks @ h.by_landmarks.T + with_point @ h.by_point.T


def correlations(triangle: Array, point: Array, covariance: Array) -> Correlations:
    """Example 3.1: a point's correlation with other states, in the world and locally.

    triangle: (3, 2) [m]. point: (2,) [m]. covariance: (k + 8, k + 8) of k states (the distant
    landmark j, say), then the base landmarks, then the point. Raises DegenerateTriangleError.
    """
    k = len(covariance) - 8
    sigma = np.sqrt(np.diag(covariance))
    own = np.sqrt(np.diag(local_covariance(triangle, point, covariance[k:, k:])))
    cross = local_cross_covariance(
        triangle, point, covariance[:k, k : k + 6], covariance[:k, k + 6 :]
    )
    return Correlations(
        np.abs(covariance[:k, k + 6 :]) / np.outer(sigma[:k], sigma[k + 6 :]),
        np.abs(cross) / np.outer(sigma[:k], own),
        sigma[k + 6 :],
        own * np.linalg.norm(np.stack(axes(triangle)), axis=1),
    )


def displacements(
    triangle_then: Array, point_then: Array, triangle_now: Array, point_now: Array
) -> Displacements:
    """Example 3.2: how far estimates have moved since, in the world and in their triangle.

    triangle_then, triangle_now: (..., 3, 2) [m]. point_then, point_now: (..., 2) [m]. The change of
    alpha and beta is given in metres along the axes as they were then. Raises
    DegenerateTriangleError.
    """
    change = to_local(triangle_now, point_now) - to_local(triangle_then, point_then)
    a, b = axes(triangle_then)
    within = change[..., :1] * a + change[..., 1:] * b
    return Displacements(
        np.linalg.norm(point_now - point_then, axis=-1), np.linalg.norm(within, axis=-1)
    )
