"""When three landmarks may define a region (Nieto 2005, section 3.5, its three conditions)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array, Mask
from ekf_reference.dense.triangles import axes, determinant, turned

TOUCHING = 1e-9
"""Overlap, as a share of the longest edge, that is rounding of a shared edge or corner."""
CROSSING = 1e-6
"""The same of a segment in a triangle, far enough above it that what has it overlaps."""


def coordinate_correlation(covariance: Array) -> Array:
    """Correlation of landmarks, the lower of that in east and in north; (m, m), -1 to 1.

    covariance: (2 m, 2 m) [m^2]. Source: Nieto 2005, Example 3.1 and eq. 2.62. Erratum: 2.62 takes
    the absolute value; landmarks that move against each other deform a region the most,
    so the sign is kept.
    """
    own, cross = _blocks(covariance)
    own, cross = np.einsum("iaa->ia", own), np.einsum("ijaa->ija", cross)
    spread = np.sqrt(own[:, None] * own)
    known = spread <= 0.0
    lower: Array = np.where(known, 1.0, cross / np.where(known, 1.0, spread)).min(axis=-1)
    return lower


def relative_sigma(covariance: Array) -> Array:
    """Standard deviation [m] of relative positions in their worst direction; (m, m).

    covariance: (2 m, 2 m) [m^2].
    """
    own, cross = _blocks(covariance)
    apart = own[:, None] + own - cross - np.swapaxes(cross, -1, -2)
    sigma: Array = np.sqrt(np.maximum(np.linalg.eigvalsh(apart)[..., -1], 0.0))
    return sigma


def flip_margin(triangle: Array, covariance: Array) -> Array:
    """How many standard deviations the doubled area Delta is away from zero; (C,).

    triangle: (C, 3, 2). covariance: (C, 6, 6) of the landmarks with each other. Derivatives of
    Delta: Nieto 2005, eqs. C.20 to C.22. What is common to the landmarks cancels.
    """
    a, b = axes(triangle)
    by_landmarks = np.concatenate((turned(a - b), turned(b), -turned(a)), axis=-1)
    variance = np.einsum("...i,...ij,...j->...", by_landmarks, covariance, by_landmarks)
    return _ratio(np.abs(determinant(triangle)), np.sqrt(np.maximum(variance, 0.0)))


def ellipse_margin(triangle: Array, covariance: Array) -> Array:
    """Return by how many sigmas a landmark's ellipse may grow to the opposite axis (C,).

    The thesis' form (Nieto 2005, section 3.5, Fig. 3.10 a): the smallest over the three landmarks,
    correlations left out. triangle: (C, 3, 2). covariance: (C, 6, 6).
    """
    margins = []
    for corner in range(3):
        opposite = triangle[:, corner - 1] - triangle[:, corner - 2]
        length = np.linalg.norm(opposite, axis=-1, keepdims=True)
        normal, columns = turned(opposite) / length, slice(2 * corner, 2 * corner + 2)
        variance = np.einsum("ci,cij,cj->c", normal, covariance[:, columns, columns], normal)
        margins.append(_ratio(np.abs(determinant(triangle)) / length[:, 0], np.sqrt(variance)))
    least: Array = np.min(margins, axis=0)
    return least


def _ratio(size: Array, sigma: Array) -> Array:
    """Size in sigmas, infinite where there is no uncertainty."""
    certain = sigma <= 0.0
    return np.where(certain, np.inf, size / np.where(certain, 1.0, sigma))


def smallest_angle(triangle: Array) -> Array:
    """The smallest of the angles [rad] of triangles (C, 3, 2); (C,)."""
    ahead = np.roll(triangle, -1, axis=1) - triangle
    behind = np.roll(triangle, 1, axis=1) - triangle
    cross = np.abs(ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0])
    angle: Array = np.arctan2(cross, (ahead * behind).sum(axis=-1)).min(axis=1)
    return angle


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Bounds of the three conditions, and how large a region may be.

    least_correlation: of every pair of base landmarks. known_apart_m: standard deviation of a
    pair's relative position below which any correlation will do; 0 for none, as in the thesis.
    flip_sigmas: how many standard deviations a region must be away from turning over. margin: how
    these are counted, flip_margin or the thesis' ellipse_margin, which refuses everything where
    the pose is poorly known.
    least_angle_rad: of the three corners. longest_edge_m: of the three edges.
    """

    least_correlation: float = 0.9
    known_apart_m: float = 0.0
    flip_sigmas: float = 3.0
    margin: Callable[[Array, Array], Array] = flip_margin
    least_angle_rad: float = math.radians(15.0)
    longest_edge_m: float = 25.0

    def pairs(self, landmark: Array, covariance: Array) -> Mask:
        """Which landmarks may share a region; (m, m), False on the diagonal.

        landmark: (m, 2) [m]. covariance: (2 m, 2 m) [m^2].
        """
        return self.within_reach(landmark) & self.correlated(covariance)

    def within_reach(self, landmark: Array) -> Mask:
        """Which landmarks (m, 2) [m] are close enough to share a region; (m, m)."""
        reach = np.linalg.norm(landmark[:, None] - landmark, axis=-1) <= self.longest_edge_m
        close: Mask = reach & ~np.eye(len(landmark), dtype=bool)
        return close

    def correlated(self, covariance: Array) -> Mask:
        """Which points (2 m, 2 m) [m^2] meet the first condition, either way; (m, m)."""
        alike = self.highly_correlated(covariance)
        if self.known_apart_m > 0.0:
            alike |= relative_sigma(covariance) <= self.known_apart_m
        return alike

    def highly_correlated(self, covariance: Array) -> Mask:
        """Which points (2 m, 2 m) [m^2] meet it as the thesis has it, by correlation; (m, m)."""
        return coordinate_correlation(covariance) >= self.least_correlation

    def well_conditioned(self, triangle: Array, covariance: Array) -> Mask:
        """Which triangles (C, 3, 2) with covariances (C, 6, 6) keep their shape; (C,)."""
        wide = smallest_angle(triangle) >= self.least_angle_rad
        return wide & (self.margin(triangle, covariance) >= self.flip_sigmas)


def overlap(first: Array, second: Array) -> Mask:
    """Whether triangles (..., 3, 2) and (..., 3, 2) have area in common; (...,), broadcast.

    Two triangles are apart when the normal of one of their six edges separates them. A shared
    edge or corner is no overlap (Nieto 2005, Fig. 3.10 b).
    """
    shape = np.broadcast_shapes(first.shape, second.shape)
    first, second = np.broadcast_to(first, shape), np.broadcast_to(second, shape)
    edge = np.concatenate(
        (first - np.roll(first, 1, axis=-2), second - np.roll(second, 1, axis=-2)), axis=-2
    )
    length = np.linalg.norm(edge, axis=-1, keepdims=True)
    normal = turned(edge) / np.where(length > 0.0, length, 1.0)
    origin = first[..., :1, :]
    along_first = normal @ np.swapaxes(first - origin, -1, -2)
    along_second = normal @ np.swapaxes(second - origin, -1, -2)
    depth = np.minimum(along_first.max(axis=-1), along_second.max(axis=-1)) - np.maximum(
        along_first.min(axis=-1), along_second.min(axis=-1)
    )
    common: Mask = (depth > TOUCHING * length.max(axis=-2)).all(axis=-1)
    return common


def crosses(segment: Array, triangle: Array) -> Mask:
    """Whether segments (k, 2, 2) run through the inside of triangles (k, 3, 2); (k,).

    A segment along an edge, or up to a corner, does not cross. The two are apart when the triangle
    lies on one side of the segment, or the segment outside of one of the triangle's edges.
    """
    start, way = segment[:, 0], segment[:, 1] - segment[:, 0]
    side = np.stack([_cross(way, triangle[:, i] - start) for i in range(3)])
    through: Mask = (side.min(axis=0) < 0.0) & (side.max(axis=0) > 0.0)
    among = np.flatnonzero(through)  # few, as a rule
    (start, end), corner = np.moveaxis(segment[among], 1, 0), np.moveaxis(triangle[among], 1, 0)
    edge = [corner[i] - corner[i - 1] for i in range(3)]
    least = CROSSING * np.max([_square(v) for v in (end - start, *edge)], axis=0)
    area, side = _cross(edge[1], edge[2]), side[:, among]
    inside = (side.min(axis=0) < -least) & (side.max(axis=0) > least) & (np.abs(area) > least)
    inwards = np.sign(area)
    for origin, along in zip(np.roll(corner, 1, axis=0), edge, strict=True):
        ends = inwards * _cross(along, start - origin), inwards * _cross(along, end - origin)
        inside &= np.maximum(*ends) > least
    through[among] = inside
    return through


def _square(vector: Array) -> Array:
    return vector[..., 0] * vector[..., 0] + vector[..., 1] * vector[..., 1]


def _cross(first: Array, second: Array) -> Array:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def _blocks(covariance: Array) -> tuple[Array, Array]:
    """P_ii (m, 2, 2) and P_ij (m, m, 2, 2) of a covariance (2 m, 2 m)."""
    m = len(covariance) // 2
    cross = covariance.reshape(m, 2, m, 2).transpose(0, 2, 1, 3)
    which = np.arange(m)
    return cross[which, which], cross
