"""Cross-correlation of two sums of Gaussians, with its derivatives (Nieto 2005, eq. 5.13).

Lambda(x) is the overlap of the first sum, laid at pose x = (x, y, heading) into the frame of the
second, with the second. Each pair of Gaussians adds alpha_i beta_j N(q_j - y_i; 0, S_ij) with
y_i = R p_i + t and S_ij = R P_i R^T + Q_j. Erratum: 5.13 prints the mean p_i - q_j, which has the
scans part in opposite directions; q_j - p_i holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, rotation
from ekf_reference.scan_matching.sog import SumOfGaussians


@dataclass(frozen=True)
class CorrespondenceSearch:
    """Which pairs count: the `most` nearest within m metres and so many sigmas of S.

    inflation_m: sigma added to every Gaussian of the second sum. slack_m: how far the pose may
    move before a pair that is missing comes within reach.
    """

    most: int
    m: float
    sigmas: float
    inflation_m: float = 0.0
    slack_m: float = 0.0


class Entries(NamedTuple):
    """Symmetric 2 x 2 matrices (M,) by their entries."""

    xx: Array
    xy: Array
    yy: Array


@dataclass(frozen=True)
class Derivatives:
    """value: Lambda. gradient: (3,). hessian: (3, 3)."""

    value: float
    gradient: Array
    hessian: Array


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Gaussians of the first sum, each with its nearest ones of the second, as they lay at a pose.

    row, column: (M,) which of the first and of the second. mean: (2, M) p. own: (M,) entries of P.
    other: (2, M) q. its: (M,) entries of Q with inflation. weight: (M,) alpha_i beta_j.
    """

    row: Index
    column: Index
    mean: Array
    own: Entries
    other: Array
    its: Entries
    weight: Array

    @classmethod
    def near(
        cls,
        first: SumOfGaussians,
        second: SumOfGaussians,
        pose: Array,
        wanted: CorrespondenceSearch,
    ) -> Pairs:
        """At a pose (3,), within reach even after a motion by the slack."""
        place = first.mean @ rotation(float(pose[2])).T + pose[:2]
        count = min(wanted.most, len(second))
        _, column = second.tree.query(
            place, k=[*range(1, count + 1)], distance_upper_bound=wanted.m
        )
        row = np.flatnonzero(column < len(second))
        column, row = column.ravel().take(row), row // count
        p, q = first.entries, second.entries
        q = q + np.array(((wanted.inflation_m**2,), (0.0,), (wanted.inflation_m**2,)))
        own = np.stack(_turned(Entries(*p), float(pose[2])))
        own[::2] += wanted.slack_m**2
        sxx, sxy, syy = own.take(row, axis=1) + q.take(column, axis=1)
        dx, dy = second.columns.take(column, axis=1) - place.T.take(row, axis=1)
        square = dx * dx * syy - 2.0 * dx * dy * sxy + dy * dy * sxx
        met = np.flatnonzero(square <= wanted.sigmas**2 * (sxx * syy - sxy * sxy))
        row, column = row.take(met), column.take(met)
        return cls(
            row=row,
            column=column,
            mean=first.columns.take(row, axis=1),
            own=Entries(*p.take(row, axis=1)),
            other=second.columns.take(column, axis=1),
            its=Entries(*q.take(column, axis=1)),
            weight=first.weight.take(row) * second.weight.take(column),
        )

    def value(self, pose: Array) -> float:
        """Lambda at a pose (3,)."""
        return float(self.terms(pose).sum())

    def terms(self, pose: Array) -> Array:
        """(M,) what each pair adds at a pose (3,)."""
        return _Laid.of(self, pose).term

    def derivatives(self, pose: Array) -> Derivatives:
        """Lambda, its gradient and Hessian by x, y [m] and heading [rad]; exact."""
        at = _Laid.of(self, pose)
        turned = _Turned.of(at)
        term, (vx, vy), g = at.term, at.v, turned.gradient
        # dv/dheading is -S^-1 of this; with it the second derivatives of ln gamma by heading.
        sx, sy = at.u[0] + turned.sv[0], at.u[1] + turned.sv[1]
        wx, wy = _times(at.inverse, sx, sy)
        bend = turned.second(at) - (sx * wx + sy * wy)
        wvx, wvy, wg = term * vx, term * vy, term * g
        gradient = np.array((wvx.sum(), wvy.sum(), wg.sum()))
        hessian = np.empty((3, 3))
        hessian[0, 0] = wvx @ vx - term @ at.inverse.xx
        hessian[0, 1] = hessian[1, 0] = wvx @ vy - term @ at.inverse.xy
        hessian[1, 1] = wvy @ vy - term @ at.inverse.yy
        hessian[0, 2] = hessian[2, 0] = wvx @ g - term @ wx
        hessian[1, 2] = hessian[2, 1] = wvy @ g - term @ wy
        hessian[2, 2] = wg @ g + term @ bend
        return Derivatives(float(term.sum()), gradient, hessian)

    def scores(self, pose: Array) -> Array:
        """(3, M) the gradient of what each pair adds."""
        at = _Laid.of(self, pose)
        return np.stack((at.term * at.v[0], at.term * at.v[1], at.term * _Turned.of(at).gradient))

    def scores_across(self, pose: Array) -> Array:
        """(3, M) the same, by the part of each pair's distance across its longer axis alone.

        Along a surface the gradients of one return's pairs are large, and cancel.
        """
        at = _Laid.of(self, pose)
        i = at.inverse
        # S's longer axis is the shorter one of its inverse.
        angle = 0.5 * np.arctan2(-2.0 * i.xy, i.yy - i.xx)
        cos, sin = np.cos(angle), np.sin(angle)
        across = at.term * (cos * at.v[1] - sin * at.v[0])
        x, y = -sin * across, cos * across
        return np.stack((x, y, at.u[0] * x + at.u[1] * y))


@dataclass(frozen=True, kw_only=True)
class _Laid:
    """Pairs at a pose; all (M,).

    over: 1 / |S|. v: S^-1 d. u: dy/dheading. arm: y - t. own: R P R^T.
    """

    term: Array
    over: Array
    inverse: Entries
    v: tuple[Array, Array]
    u: tuple[Array, Array]
    arm: tuple[Array, Array]
    own: Entries

    @classmethod
    def of(cls, pairs: Pairs, pose: Array) -> _Laid:
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        px, py = pairs.mean
        ax, ay = cos * px - sin * py, sin * px + cos * py
        own = _turned(pairs.own, float(pose[2]))
        sxx, sxy, syy = own.xx + pairs.its.xx, own.xy + pairs.its.xy, own.yy + pairs.its.yy
        over = 1.0 / (sxx * syy - sxy * sxy)
        inverse = Entries(syy * over, -sxy * over, sxx * over)
        dx = pairs.other[0] - ax - pose[0]
        dy = pairs.other[1] - ay - pose[1]
        vx, vy = _times(inverse, dx, dy)
        height = pairs.weight * np.sqrt(over) * (0.5 / math.pi)
        term = height * np.exp(-0.5 * (dx * vx + dy * vy))
        return cls(
            term=term, over=over, inverse=inverse, v=(vx, vy), u=(-ay, ax), arm=(ax, ay), own=own
        )


class _Turned(NamedTuple):
    """How ln gamma changes with heading; all (M,).

    S' = J C - C J of C = R P R^T has no trace: it is (-a, b; b, a). sv: S' v. trace: of S^-1 S'.
    """

    a: Array
    b: Array
    sv: tuple[Array, Array]
    trace: Array
    gradient: Array

    @classmethod
    def of(cls, at: _Laid) -> _Turned:
        c, i, (vx, vy), (ux, uy) = at.own, at.inverse, at.v, at.u
        a, b = 2.0 * c.xy, c.xx - c.yy
        sx, sy = b * vy - a * vx, b * vx + a * vy
        trace = 2.0 * b * i.xy - a * (i.xx - i.yy)
        pull = (ux + 0.5 * sx) * vx + (uy + 0.5 * sy) * vy
        return cls(a, b, (sx, sy), trace, pull - 0.5 * trace)

    def second(self, at: _Laid) -> Array:
        """(M,) the second derivative without the part that dv brings.

        S'' = J S' - S' J is -2 (b, a; a, -b), and tr (S^-1 S')^2 = tr^2 - 2 det. The second
        derivative of a rotation is minus the rotation.
        """
        (vx, vy), (ax, ay), a, b, i = at.v, at.arm, self.a, self.b, at.inverse
        by_b = i.xx - i.yy - vx * vx + vy * vy
        by_a = 2.0 * (i.xy - vx * vy)
        square = 0.5 * self.trace * self.trace + at.over * (a * a + b * b)
        result: Array = b * by_b + a * by_a + square - (vx * ax + vy * ay)
        return result


def _turned(p: Entries, heading_rad: float) -> Entries:
    """R P R^T by the double angle."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    half, mean = 0.5 * (p.xx - p.yy), 0.5 * (p.xx + p.yy)
    cos2, sin2 = cos * cos - sin * sin, 2.0 * cos * sin
    along, mixed = cos2 * half - sin2 * p.xy, sin2 * half + cos2 * p.xy
    return Entries(mean + along, mixed, mean - along)


def _times(matrix: Entries, x: Array, y: Array) -> tuple[Array, Array]:
    return matrix.xx * x + matrix.xy * y, matrix.xy * x + matrix.yy * y
