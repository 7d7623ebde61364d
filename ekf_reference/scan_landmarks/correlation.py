"""Cross-correlation of two sums of Gaussians, with its derivatives (Nieto 2005, eq. 5.13).

Lambda(x) is the overlap of the first sum, laid at pose x = (x, y, heading) into the frame of the
second, with the second. Each pair of Gaussians adds alpha_i beta_j N(q_j - y_i; 0, S_ij) with
y_i = R p_i + t and S_ij = R P_i R^T + Q_j. Erratum: 5.13 prints the mean p_i - q_j, which has the
scans part in opposite directions; q_j - p_i holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ekf_reference.scan_landmarks.sog import SumOfGaussians, rotation

Array = NDArray[np.float64]

_HALF_TURN = -1.0
"""The second derivative of a rotation is minus the rotation."""


@dataclass(frozen=True)
class Entries:
    """Symmetric 2 x 2 matrices by their entries, of any shape."""

    xx: Array
    xy: Array
    yy: Array


@dataclass(frozen=True)
class Derivatives:
    """value: Lambda. gradient: (3,). hessian: (3, 3)."""

    value: float
    gradient: Array
    hessian: Array


@dataclass(frozen=True)
class Pairs:
    """Each Gaussian of the first sum with its nearest ones of the second, as they lay at a pose.

    mean: (N, 2) p. own: (N,) entries of P. other: (N, K, 2) q. its: (N, K) entries of Q with
    inflation. weight: (N, K) alpha_i beta_j, 0 where there is no counterpart. column: (N, K) rows
    of the second sum. row: (N,) those of the first sum that have a counterpart.
    """

    mean: Array
    own: Entries
    other: Array
    its: Entries
    weight: Array
    column: NDArray[np.intp]
    row: NDArray[np.intp]

    @classmethod
    def near(
        cls,
        first: SumOfGaussians,
        second: SumOfGaussians,
        pose: Array,
        reach_m: float,
        most: int,
        inflation_m: float = 0.0,
    ) -> Pairs:
        """The `most` nearest within reach at a pose (3,), covariances inflated by a sigma."""
        place = first.mean @ rotation(float(pose[2])).T + pose[:2]
        count = min(most, len(second))
        _, column = second.tree.query(place, k=[*range(1, count + 1)], distance_upper_bound=reach_m)
        met = column < len(second)
        column = np.where(met, column, 0)
        kept = np.flatnonzero(met[:, 0])
        met, column = met[kept], column[kept]
        widest = int(met.sum(axis=1).max(initial=0))
        met, column = met[:, :widest], column[:, :widest]
        p, q = first.covariance[kept], second.covariance[column]
        wide = inflation_m**2
        return cls(
            first.mean[kept],
            Entries(p[:, 0, 0], p[:, 0, 1], p[:, 1, 1]),
            second.mean[column],
            Entries(q[..., 0, 0] + wide, q[..., 0, 1], q[..., 1, 1] + wide),
            np.where(met, first.weight[kept, None] * second.weight[column], 0.0),
            column,
            kept,
        )

    def value(self, pose: Array) -> float:
        """Lambda at a pose (3,)."""
        return float(self.terms(pose).sum())

    def terms(self, pose: Array) -> Array:
        """(N, K) what each pair adds at a pose (3,)."""
        return self._at(pose).term

    def derivatives(self, pose: Array) -> Derivatives:
        """Lambda, its gradient and Hessian by x, y [m] and heading [rad]; exact."""
        at = self._at(pose)
        term, (vx, vy), turned = at.term, at.v, at.by_heading
        # dv/dheading, and the two second derivatives of ln gamma that have a heading.
        sx, sy = at.u[0][:, None] + turned.sv[0], at.u[1][:, None] + turned.sv[1]
        wx, wy = _times(at.inverse, sx, sy)
        bend = turned.second(at) - (sx * wx + sy * wy)
        g = turned.gradient
        wvx, wvy, wg = term * vx, term * vy, term * g
        gradient = np.array((wvx.sum(), wvy.sum(), wg.sum()))
        hessian = np.empty((3, 3))
        hessian[0, 0] = (wvx * vx - term * at.inverse.xx).sum()
        hessian[0, 1] = hessian[1, 0] = (wvx * vy - term * at.inverse.xy).sum()
        hessian[1, 1] = (wvy * vy - term * at.inverse.yy).sum()
        hessian[0, 2] = hessian[2, 0] = (wvx * g - term * wx).sum()
        hessian[1, 2] = hessian[2, 1] = (wvy * g - term * wy).sum()
        hessian[2, 2] = (wg * g + term * bend).sum()
        return Derivatives(float(term.sum()), gradient, hessian)

    def scores(self, pose: Array) -> Array:
        """(3, N, K) the gradient of what each pair adds."""
        at = self._at(pose)
        return np.stack((at.term * at.v[0], at.term * at.v[1], at.term * at.by_heading.gradient))

    def scores_across(self, pose: Array) -> Array:
        """(3, N, K) the same, by the part of each pair's distance across its longer axis alone.

        Along a surface the gradients of one return's pairs are large, and cancel.
        """
        at = self._at(pose)
        i = at.inverse
        # S's longer axis is the shorter one of its inverse.
        angle = 0.5 * np.arctan2(-2.0 * i.xy, i.yy - i.xx)
        cos, sin = np.cos(angle), np.sin(angle)
        across = at.term * (cos * at.v[1] - sin * at.v[0])
        x, y = -sin * across, cos * across
        return np.stack((x, y, at.u[0][:, None] * x + at.u[1][:, None] * y))

    def _at(self, pose: Array) -> _Laid:
        return _Laid.of(self, pose)


@dataclass(frozen=True)
class _Laid:
    """Pairs at a pose.

    term: (N, K). v: S^-1 d. u: dy/dheading (N,) each. arm: y - t. own: R P R^T (N,).
    """

    term: Array
    inverse: Entries
    v: tuple[Array, Array]
    u: tuple[Array, Array]
    arm: tuple[Array, Array]
    own: Entries

    @classmethod
    def of(cls, pairs: Pairs, pose: Array) -> _Laid:
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        px, py = pairs.mean[:, 0], pairs.mean[:, 1]
        ax, ay = cos * px - sin * py, sin * px + cos * py
        p = pairs.own
        mixed = 2.0 * cos * sin * p.xy
        own = Entries(
            cos * cos * p.xx - mixed + sin * sin * p.yy,
            cos * sin * (p.xx - p.yy) + (cos * cos - sin * sin) * p.xy,
            sin * sin * p.xx + mixed + cos * cos * p.yy,
        )
        sxx = own.xx[:, None] + pairs.its.xx
        sxy = own.xy[:, None] + pairs.its.xy
        syy = own.yy[:, None] + pairs.its.yy
        over = 1.0 / (sxx * syy - sxy * sxy)
        inverse = Entries(syy * over, -sxy * over, sxx * over)
        dx = pairs.other[..., 0] - (ax + pose[0])[:, None]
        dy = pairs.other[..., 1] - (ay + pose[1])[:, None]
        vx, vy = _times(inverse, dx, dy)
        height = pairs.weight * np.sqrt(over) / (2.0 * math.pi)
        term = height * np.exp(-0.5 * (dx * vx + dy * vy))
        return cls(term, inverse, (vx, vy), (-ay, ax), (ax, ay), own)

    @property
    def by_heading(self) -> _Turned:
        return _Turned.of(self)


@dataclass(frozen=True)
class _Turned:
    """How ln gamma changes with heading. first: S' (N,). sv: S' v. gradient: (N, K)."""

    first: Entries
    sv: tuple[Array, Array]
    gradient: Array

    @classmethod
    def of(cls, at: _Laid) -> _Turned:
        c = at.own
        first = Entries(-2.0 * c.xy, c.xx - c.yy, 2.0 * c.xy)  # J C - C J
        (vx, vy), (ux, uy), inverse = at.v, at.u, at.inverse
        sv = (
            first.xx[:, None] * vx + first.xy[:, None] * vy,
            first.xy[:, None] * vx + first.yy[:, None] * vy,
        )
        pull = ux[:, None] * vx + uy[:, None] * vy + 0.5 * (vx * sv[0] + vy * sv[1])
        return cls(first, sv, pull - 0.5 * _trace(inverse, first))

    def second(self, at: _Laid) -> Array:
        """(N, K) the second derivative without the part that dv brings."""
        (vx, vy), (ax, ay), s = at.v, at.arm, self.first
        twice = Entries(-2.0 * s.xy, s.xx - s.yy, 2.0 * s.xy)
        bent = (
            twice.xx[:, None] * vx * vx
            + 2.0 * twice.xy[:, None] * vx * vy
            + twice.yy[:, None] * vy * vy
        )
        i = at.inverse
        sxx, sxy, syy = (entry[:, None] for entry in (s.xx, s.xy, s.yy))
        m00, m01 = i.xx * sxx + i.xy * sxy, i.xx * sxy + i.xy * syy
        m10, m11 = i.xy * sxx + i.yy * sxy, i.xy * sxy + i.yy * syy
        square = m00 * m00 + 2.0 * m01 * m10 + m11 * m11
        inward = _HALF_TURN * (vx * ax[:, None] + vy * ay[:, None])
        result: Array = inward + 0.5 * (bent - _trace(i, twice) + square)
        return result


def _times(matrix: Entries, x: Array, y: Array) -> tuple[Array, Array]:
    return matrix.xx * x + matrix.xy * y, matrix.xy * x + matrix.yy * y


def _trace(inverse: Entries, first: Entries) -> Array:
    """Trace of S^-1 M (N, K) for M (N,)."""
    trace: Array = (
        inverse.xx * first.xx[:, None]
        + 2.0 * inverse.xy * first.xy[:, None]
        + inverse.yy * first.yy[:, None]
    )
    return trace
