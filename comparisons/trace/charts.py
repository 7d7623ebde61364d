"""How a block's numbers stand to its error: what a filter adds, and what it subtracts.

In: names of charts as `events.CHARTS` has them, or a `BlockChart` of the filter's own. Out: `plus`,
the numbers that an error leads to, and `minus`, the error that leads from numbers to others. The
error is truth minus estimate, so `plus(estimate, error)` is the truth. Rotations are matrices from
body to world; the error of an attitude is a rotation vector, on the world's side (left) or the
body's (right); that of SE_2(3) is attitude, velocity, position, of a matrix [R v p] (Barrau and
Bonnabel 2017).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, wrapped
from comparisons.trace.events import ADDITIVE

_SMALL = 1e-4
"""Angles [rad] below which series take the place of quotients."""
_NUMBERS_OF_MATRIX, _NUMBERS_OF_QUATERNION = 9, 4
_TURNING = {(1, 1): (0, 1), (3, 3): (2, 3), (4, 3): (0, 3), (9, 3): (0, 3), (10, 9): (0, 3),
            (15, 9): (0, 3)}  # fmt: skip
"""By numbers and entries of the error of a chart that is not additive, which entries are angles."""
QUATERNIONS = ("wxyz", "xyzw")
"""Orders of a quaternion's numbers: the scalar first, or last."""


class BlockChart(NamedTuple):
    """Of a block whose numbers are none of the known kinds.

    Attributes:
        numbers: How many the block has.
        plus: (numbers, error) to the numbers of the truth.
        minus: (numbers, others) to the error that leads from the others to the numbers.
    """

    numbers: int
    plus: Callable[[Array, Array], Array]
    minus: Callable[[Array, Array], Array]


class JointChart:
    """Of several blocks, one after the other.

    numbers, errors: how many there are in all. turning: (n,) which errors are angles. angles: which
    numbers are.
    """

    def __init__(self, charts: Sequence[BlockChart], dims: Sequence[int]) -> None:
        """charts, dims: of each block."""
        self._parts: list[tuple[BlockChart, slice, slice]] = []
        self.numbers = self.errors = 0
        for chart, dim in zip(charts, dims, strict=True):
            first = self.numbers, self.errors
            if chart.minus is _subtracted and self._parts:
                last = self._parts[-1]
                if last[0].minus is _subtracted:  # neighbours are one part
                    first = last[1].start, last[2].start
                    self._parts.pop()
            self.numbers, self.errors = self.numbers + chart.numbers, self.errors + dim
            at, of = slice(first[0], self.numbers), slice(first[1], self.errors)
            self._parts.append((chart._replace(numbers=at.stop - at.start), at, of))
        self.turning, self.angles = np.zeros(self.errors, dtype=bool), list[int]()
        for chart, _, of in self._parts:
            begin, end = _TURNING.get((chart.numbers, of.stop - of.start), (0, 0))
            if chart.minus is not _subtracted:
                self.turning[of.start + begin : of.start + end] = True
            if chart.minus is _turned_back:
                self.angles.append(at.stop - 1)
        self.is_additive = all(chart.minus is _subtracted for chart in charts)

    def plus(self, numbers: Array, error: Array) -> Array:
        """Return the numbers (k,) of the truth at an error (n,)."""
        if self.is_additive:
            return numbers + error
        parts = [chart.plus(numbers[at], error[of]) for chart, at, of in self._parts]
        return np.concatenate(parts)

    def moved(self, numbers: Array, entry: int, by: float) -> Array:
        """Return the numbers (k,) at an error that has one entry, by so much."""
        others = numbers.copy()
        for chart, at, of in self._parts:
            if of.start <= entry < of.stop:
                if chart.plus is _added:
                    others[at.start + entry - of.start] += by
                else:
                    error = np.zeros(of.stop - of.start)
                    error[entry - of.start] = by
                    others[at] = chart.plus(numbers[at], error)
        return others

    def minus(self, numbers: Array, others: Array) -> Array:
        """Return the error (n,) that leads from others (k,) to numbers (k,)."""
        if self.is_additive:
            return numbers - others
        parts = [chart.minus(numbers[at], others[at]) for chart, at, _ in self._parts]
        return np.concatenate(parts)

    def sizes(self, numbers: Array) -> Array:
        """Return (n,) how large the numbers are that errors are added to; one of other charts."""
        sizes = np.ones(self.errors)
        for chart, at, of in self._parts:
            if chart.plus is _added:
                sizes[of] = np.abs(numbers[at])
        sizes[self.turning] = 1.0
        return sizes


def chart_of(name: str, dim: int, quaternions: str | None) -> BlockChart:
    """Return a known chart.

    Args:
        name: One of `events.CHARTS`.
        dim: Entries of the block's error.
        quaternions: The order of an attitude's four numbers, one of QUATERNIONS; None where it has
            the nine of its matrix, row by row.

    Raises:
        ValueError: A block of so many entries has no such chart.
    """
    if name == ADDITIVE:
        return BlockChart(dim, _added, _subtracted)
    kind, _, side = name.partition(" ")
    expected = {"angle": 1, "se2": 3, "so3": 3, "se23": 9}[kind]
    if dim != expected:
        raise ValueError(f"chart {name} has an error of {expected} entries, the block {dim}")
    if kind in ("angle", "se2"):
        return BlockChart(dim, _added, _turned_back)
    attitude = _NUMBERS_OF_MATRIX if quaternions is None else _NUMBERS_OF_QUATERNION
    group = _Attitudes(quaternions, side == "left", with_motion=kind == "se23")
    return BlockChart(attitude + (6 if kind == "se23" else 0), group.plus, group.minus)


def _added(numbers: Array, error: Array) -> Array:
    return numbers + error


def _subtracted(numbers: Array, others: Array) -> Array:
    return numbers - others


def _turned_back(numbers: Array, others: Array) -> Array:
    """Of an angle, or x, y and an angle: the difference, the angle's the short way round."""
    difference = numbers - others
    difference[-1:] = wrapped(difference[-1:])
    return difference


class _Attitudes:
    """Attitudes, alone or with velocity and position, with the error on one side."""

    def __init__(self, quaternions: str | None, is_left: bool, *, with_motion: bool) -> None:
        self._quaternions, self._is_left = quaternions, is_left
        self._with_motion = with_motion

    def plus(self, numbers: Array, error: Array) -> Array:
        rotation, motion = self._read(numbers)
        turn, spread = rotation_by(error[:3]), left_jacobian(error[:3])
        if not self._with_motion:
            return self._written(turn @ rotation if self._is_left else rotation @ turn)
        moved = spread @ error[3:].reshape(2, 3).T  # columns: velocity, position
        if self._is_left:
            return self._written(turn @ rotation, turn @ motion + moved)
        return self._written(rotation @ turn, motion + rotation @ moved)

    def minus(self, numbers: Array, others: Array) -> Array:
        (rotation, motion), (other, other_motion) = self._read(numbers), self._read(others)
        turn = rotation @ other.T if self._is_left else other.T @ rotation
        angle = rotation_vector(turn)
        if not self._with_motion:
            return angle
        by_left, by_right = motion - turn @ other_motion, other.T @ (motion - other_motion)
        moved = by_left if self._is_left else by_right
        return np.concatenate((angle, np.linalg.solve(left_jacobian(angle), moved).T.ravel()))

    def _read(self, numbers: Array) -> tuple[Array, Array]:
        """Return a rotation (3, 3), and velocity and position as columns (3, 2)."""
        if self._quaternions is None:
            first, rotation = _NUMBERS_OF_MATRIX, numbers[:_NUMBERS_OF_MATRIX].reshape(3, 3)
        else:
            first = _NUMBERS_OF_QUATERNION
            rotation = rotation_of(_scalar_first(numbers[:first], self._quaternions))
        return rotation, numbers[first:].reshape(-1, 3).T

    def _written(self, rotation: Array, motion: Array | None = None) -> Array:
        attitude = rotation.ravel()
        if self._quaternions is not None:
            attitude = quaternion_of(rotation)
            if self._quaternions == "xyzw":
                attitude = np.roll(attitude, -1)
        return attitude if motion is None else np.concatenate((attitude, motion.T.ravel()))


def _scalar_first(quaternion: Array, order: str) -> Array:
    return np.roll(quaternion, 1) if order == "xyzw" else quaternion


def _crossed(vector: Array) -> Array:
    """Return the matrix (3, 3) by which a vector is multiplied from the left in a cross product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_by(vector: Array) -> Array:
    """Return the rotation (3, 3) about a vector (3,), by its length [rad]."""
    angle, cross = math.sqrt(float(vector @ vector)), _crossed(vector)
    if angle < _SMALL:
        first, second = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0
    else:
        first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def left_jacobian(vector: Array) -> Array:
    """Return (3, 3), by which Exp(vector + d) is about Exp(left_jacobian d) Exp(vector)."""
    angle, cross = math.sqrt(float(vector @ vector)), _crossed(vector)
    if angle < _SMALL:
        first, second = 0.5 - angle**2 / 24.0, 1.0 / 6.0 - angle**2 / 120.0
    else:
        first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def rotation_vector(rotation: Array) -> Array:
    """Return the vector (3,) about which a rotation (3, 3) turns, by its length [rad]."""
    cosine = 0.5 * (float(np.trace(rotation)) - 1.0)
    if cosine > 0.0:
        skew = rotation - rotation.T
        vector = 0.5 * np.array((skew[2, 1], skew[0, 2], skew[1, 0]))
        sine = math.sqrt(float(vector @ vector))
        longer = math.atan2(sine, cosine) / sine if sine > _SMALL else 1.0 + sine**2 / 6.0
        return longer * vector
    quaternion = quaternion_of(rotation)
    sine, cosine = float(np.linalg.norm(quaternion[1:])), float(quaternion[0])
    return np.asarray(2.0 * np.arctan2(sine, cosine) / sine * quaternion[1:])


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion (4,), w x y z, of any length."""
    w, vector = quaternion[0], quaternion[1:]
    cross, squared = _crossed(vector), float(quaternion @ quaternion)
    turned = (w**2 - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * cross
    return np.asarray(turned / squared)


def quaternion_of(rotation: Array) -> Array:
    """Return the quaternion (4,), w x y z with w >= 0, of a rotation (3, 3).

    The eigenvector of Bar-Itzhack's matrix (2000), which a matrix that is orthonormal but for
    rounding has as well.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation
    k = np.array([
        [a + e + i, h - f, c - g, d - b],
        [h - f, a - e - i, b + d, c + g],
        [c - g, b + d, e - a - i, f + h],
        [d - b, c + g, f + h, i - a - e],
    ])  # fmt: skip
    quaternion: Array = np.linalg.eigh(k)[1][:, -1]
    return -quaternion if quaternion[0] < 0.0 else quaternion
