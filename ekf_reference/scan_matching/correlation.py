"""Cross-correlation of two sums of Gaussians, with its derivatives (Nieto 2005, eq. 5.13).

Lambda(x) is the overlap of the first sum, laid at pose x = (x, y, heading) into the frame of the
second, with the second. Each pair of Gaussians adds alpha_i beta_j N(q_j - y_i; 0, S_ij) with
y_i = R p_i + t and S_ij = R P_i R^T + Q_j. Erratum: 5.13 prints the mean p_i - q_j, which has the
scans part in opposite directions; q_j - p_i holds.

Vectors are complex numbers, so that all pairs take few operations: (x, y) is x + i y, R p is
e^(i heading) p, and a dot product Re(a* b). A symmetric matrix S is half its trace m and its
deviator z = (xx - yy) / 2 + i xy: S v = m v + z v*, |S| = m^2 - |z|^2, S^-1 is (m, -z) / |S|, the
trace of a product 2 (m m' + Re(z* z')), and R S R^T is m and e^(2 i heading) z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.scan_matching.sog import Complex, SumOfGaussians

_ROWS, _COLUMNS = np.triu_indices(3)


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


class Derivatives(NamedTuple):
    """value: (...) Lambda. gradient: (..., 3). hessian: (..., 3, 3)."""

    value: Array
    gradient: Array
    hessian: Array

    def of_logarithm(self, unit: Array) -> tuple[Array, Array]:
        """(..., 3) and (..., 3, 3) those of ln Lambda, by coordinates scaled with units (3,)."""
        value = np.where(self.value > 0.0, self.value, 1.0)[..., None]
        slope = unit * self.gradient / value
        bend = np.multiply.outer(unit, unit) * self.hessian / value[..., None]
        return slope, bend - slope[..., :, None] * slope[..., None, :]

    def replaced(self, rows: Mask, other: Derivatives) -> Derivatives:
        """Those of the other in some rows (K,)."""
        if rows.all():
            return other
        return Derivatives(
            np.where(rows, other.value, self.value),
            np.where(rows[:, None], other.gradient, self.gradient),
            np.where(rows[:, None, None], other.hessian, self.hessian),
        )


def laid(point: Complex, pose: Array) -> Complex:
    """(..., N) points (N,) of a frame that lies at poses (..., 3)."""
    turn = np.exp(1j * pose[..., 2:])
    return np.asarray(turn * point + (pose[..., :1] + 1j * pose[..., 1:2]))


def plane(point: Complex) -> Array:
    """(M, 2) coordinates of points of any shape."""
    return point.reshape(-1, 1).view(np.float64)


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Gaussians of the first sum, each with its nearest ones of the second, as they lay at poses.

    begin: (K,) first pair of each pose. at, row, column: (M,) which pose, which of the first and of
    the second. p, q: (M,) means. own, its: (M,) deviators of P and Q. middle: (M,) half the trace
    of S. weight: (M,) alpha_i beta_j / (2 pi).

    Methods take the K poses (..., K, 3), or one (3,), and return as many.
    """

    begin: Index
    at: Index
    row: Index
    column: Index
    p: Complex
    q: Complex
    own: Complex
    its: Complex
    middle: Array
    weight: Array

    @classmethod
    def near(
        cls,
        first: SumOfGaussians,
        second: SumOfGaussians,
        pose: Array,
        wanted: CorrespondenceSearch,
        counted: Mask | None = None,
    ) -> Pairs:
        """At poses (K, 3) or (3,), within reach even after a motion by the slack.

        counted: (K, N) which of the first sum, or (N,); by default all.
        """
        pose = np.atleast_2d(pose)
        place = laid(first.point, pose).ravel()
        body = np.arange(len(place)) if counted is None else np.flatnonzero(counted)
        most = min(wanted.most, len(second))
        found = second.tree.query(plane(place[body]), k=most, distance_upper_bound=wanted.m)
        distance, column = (one.reshape(-1, most) for one in found)
        more = wanted.inflation_m**2 + wanted.slack_m**2
        own = (first.larger + more).take(body % len(first))
        # No farther than S reaches along its longer axis; those that are missing are at infinity.
        longest = own[:, None] + second.larger.take(column, mode="clip")
        near = np.flatnonzero(distance * distance <= wanted.sigmas**2 * longest)
        body, column = body.take(near // most), column.ravel().take(near)
        at, row = np.divmod(body, len(first))
        p, q = first.deviator.take(row), second.deviator.take(column)
        middle = first.half_trace.take(row) + second.half_trace.take(column) + wanted.inflation_m**2
        apart = second.point.take(column) - place.take(body)
        askew, reach = np.exp(2j * pose[:, 2]).take(at) * p + q, middle + wanted.slack_m**2
        square = reach * _square(apart) - _dot(askew, apart * apart)
        met = np.flatnonzero(square <= wanted.sigmas**2 * (reach * reach - _square(askew)))
        at, row, column = at.take(met), row.take(met), column.take(met)
        return cls(
            begin=np.searchsorted(at, np.arange(len(pose))),
            at=at,
            row=row,
            column=column,
            p=first.point.take(row),
            q=second.point.take(column),
            own=p.take(met),
            its=q.take(met),
            middle=middle.take(met),
            weight=first.weight.take(row) * second.weight.take(column) * (0.5 / np.pi),
        )

    def value(self, pose: Array) -> Array:
        """Lambda (...)."""
        return self._sums(self.terms(pose)).reshape(pose.shape[:-1])

    def terms(self, pose: Array) -> Array:
        """(..., M) what each pair adds."""
        return _Laid.of(self, pose).term

    def derivatives(self, pose: Array) -> Derivatives:
        """Lambda, its gradient and Hessian by x, y [m] and heading [rad] at K poses; exact."""
        at = _Laid.of(self, pose)
        turned, v = _Turned.of(at), at.v
        each = np.empty((1 + 3 + len(_ROWS), len(self.at)))
        each[0], each[1], each[2], each[3] = 1.0, v.real, v.imag, turned.gradient
        # Second derivatives over gamma: of a place xx, xy and yy, and with the heading.
        level, askew = 0.5 * _square(v) - at.middle, 0.5 * v * v - at.deviator
        each[4], each[5], each[7] = level + askew.real, askew.imag, level - askew.real
        mixed = turned.gradient * v - turned.w
        each[6], each[8] = mixed.real, mixed.imag
        each[9] = turned.gradient**2 + turned.second
        each *= at.term
        total = self._sums(each).T.reshape(*pose.shape[:-1], len(each))
        hessian = np.empty((*pose.shape[:-1], 3, 3))
        hessian[..., _ROWS, _COLUMNS] = hessian[..., _COLUMNS, _ROWS] = total[..., 4:]
        return Derivatives(total[..., 0], total[..., 1:4], hessian)

    def scores(self, pose: Array) -> Array:
        """(3, M) the gradient of what each pair adds, each at its pose."""
        at = _Laid.of(self, pose)
        v = at.term * at.v
        return np.stack((v.real, v.imag, at.term * _Turned.of(at).gradient))

    def scores_across(self, pose: Array) -> Array:
        """(3, M) the same, by the part of each pair's distance across its longer axis alone.

        Along a surface the gradients of one return's pairs are large, and cancel.
        """
        at = _Laid.of(self, pose)
        across = 1j * np.exp(0.5j * np.angle(-at.deviator))
        part = at.term * _dot(across, at.v) * across
        return np.stack((part.real, part.imag, _dot(1j * at.arm, part)))

    def _sums(self, term: Array) -> Array:
        """(..., K) of terms (..., M), by pose."""
        total = np.zeros((*term.shape[:-1], len(self.begin)))
        if len(self.at):
            some = self.begin < np.append(self.begin[1:], len(self.at))
            total[..., some] = np.add.reduceat(term, self.begin[some], axis=-1)
        return total


@dataclass(frozen=True, kw_only=True)
class _Laid:
    """Pairs at poses; all (..., M).

    arm: y - t. own: deviator of R P R^T. over: 1 / |S|. middle, deviator: of S^-1. v: S^-1 d.
    """

    term: Array
    arm: Complex
    own: Complex
    over: Array
    middle: Array
    deviator: Complex
    v: Complex

    @classmethod
    def of(cls, pairs: Pairs, pose: Array) -> _Laid:
        pose = np.atleast_2d(pose)
        turn, shift = np.exp(1j * pose[..., 2]), pose[..., 0] + 1j * pose[..., 1]
        if len(pairs.begin) > 1:
            turn, shift = turn.take(pairs.at, axis=-1), shift.take(pairs.at, axis=-1)
        arm, own = turn * pairs.p, turn * turn * pairs.own
        apart, askew = pairs.q - shift - arm, own + pairs.its
        over = 1.0 / (pairs.middle**2 - _square(askew))
        middle, deviator = over * pairs.middle, -over * askew
        v = middle * apart + deviator * np.conj(apart)
        term = pairs.weight * np.sqrt(over) * np.exp(-0.5 * _dot(apart, v))
        return cls(term=term, arm=arm, own=own, over=over, middle=middle, deviator=deviator, v=v)


class _Turned(NamedTuple):
    """How ln gamma changes with heading; all (M,).

    gradient: by heading. w: minus dv/dheading. second: the second derivative by heading.
    """

    gradient: Array
    w: Complex
    second: Array

    @classmethod
    def of(cls, at: _Laid) -> _Turned:
        """R P R^T has the derivatives S' and S'', with the deviators 2 i z and -4 z, no trace.

        Those of y are i arm and -arm, and tr (S^-1 S')^2 = tr^2 - 2 |S^-1 S'|.
        """
        back = np.conj(at.v)
        slope, pull = 1j * at.arm, 2j * at.own * back
        trace = 2.0 * _dot(at.deviator, 2j * at.own)
        gradient = ((slope + 0.5 * pull) * back).real - 0.5 * trace
        s = slope + pull
        w = at.middle * s + at.deviator * np.conj(s)
        second = 0.5 * trace**2 + 4.0 * at.over * _square(at.own) - _dot(s, w)
        second += _dot(at.own, 4.0 * at.deviator - 2.0 * at.v * at.v) - _dot(at.arm, at.v)
        return cls(gradient, w, second)


def _dot(a: Complex, b: Complex) -> Array:
    """Re(a* b)."""
    return np.asarray(a.real * b.real + a.imag * b.imag)


def _square(a: Complex) -> Array:
    return np.asarray(a.real**2 + a.imag**2)
