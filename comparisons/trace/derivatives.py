"""A filter's functions, evaluated and differentiated numerically where the filter was.

In: a function of numbers, the numbers, and how numbers stand to errors. Out: the value, the
derivative of the outcome's error by the error of the numbers, and what it may be off by. Central
differences with two steps, one half of the other, are extrapolated (Richardson 1911); where the two
disagree, as where a number is large beside the length over which the function bends, smaller steps
are tried.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from comparisons.arrays import Array, Mask
from comparisons.trace.charts import JointChart

_STEP = 1e-3
"""Relative to what a number is large by."""
_SMALLER, _MOST_SMALLER = 8.0, 6
"""By what steps are divided where two disagree, and how often."""
_DISAGREE = 1e-5
"""Relative to a column's largest entry."""
_TINY, _ROUGHLY = 1e-6, 0.1
"""Share of a step, with which a difference is that of another within so much but for rounding."""
_MOST_RAD = 1e6
"""Beyond it an angle, as of a filter that has diverged, goes round too often to be told."""
_MOST_TURNED = 0.5
"""Radians by which a step turns an angle at the most."""
_REMAINDER = 0.1
"""Share of the difference of two steps that their extrapolation may be off by."""
_ROUNDINGS = 16.0 * float(np.finfo(float).eps)


class Evaluated(NamedTuple):
    """value: (k,) of the function. jacobian: (m, n). uncertainty: (m, n) about its error."""

    value: Array
    jacobian: Array
    uncertainty: Array


class Steps(NamedTuple):
    """step: (n,) at which two agreed. relative: (m, n) what they differed by there.

    first: (n,) the steps that were tried first, by the sizes of the numbers.
    """

    step: Array
    relative: Array
    first: Array


def evaluate(
    function: Callable[[Array], Any],
    point: Array,
    charts: tuple[JointChart, JointChart | None],
    sigma: Array,
    known: Steps | None = None,
) -> tuple[Evaluated, Steps]:
    """Evaluate a function, and differentiate it.

    Args:
        function: Of numbers (k,), to numbers.
        point: (k,) where.
        charts: Of the numbers, and of what the function leads to; None of a measurement, whose
            numbers are added, and may go round by whole turns.
        sigma: (n,) about how large the errors of the numbers are.
        known: Steps that served nearby, where one difference of each is enough.

    Returns:
        What the function says, and the steps.

    Raises:
        ValueError: The function's numbers are not finite, or not as many as the chart says; or they
            change too fast.
    """
    before, after = charts
    value = _numbers(function(point.copy()))
    if after is not None and len(value) != after.numbers:
        raise ValueError(f"gives {len(value)} numbers, expected {after.numbers}")
    if after is not None and np.abs(value[after.angles]).max(initial=0.0) > _MOST_RAD:
        raise ValueError(f"gives an angle of more than {_MOST_RAD:g} rad")

    def column(k: int, step: float) -> Array:
        """Central difference by one entry."""
        ends = [_numbers(function(before.moved(point, k, sign * step))) for sign in (1.0, -1.0)]
        if any(len(end) != len(value) for end in ends):
            raise ValueError("gives another count of numbers beside the point")
        if after is None:
            forward, backward = _unturned(ends[0] - value, ends[1] - value)
        else:
            forward, backward = (after.minus(end, value) for end in ends)
            angles = np.abs((forward[after.turning], backward[after.turning]))
            if angles.max(initial=0.0) > 1.0:
                return np.full(len(forward), np.inf)
        return np.asarray((forward - backward) / (2.0 * step))

    width = len(value) if after is None else after.errors
    jacobian, uncertainty = np.zeros((width, before.errors)), np.zeros((width, before.errors))
    size = value if len(value) == width else np.full(width, np.abs(value).max(initial=0.0))
    rounding = _Rounding(size, point)
    steps = np.maximum(before.sizes(point), sigma) * _STEP
    steps[steps == 0.0] = _STEP
    first = steps.copy()
    relative = np.zeros((width, before.errors))
    turning = np.zeros(width, dtype=bool) if after is None else after.turning
    for k in range(before.errors):
        by_known = np.full(width, np.inf)
        if known is not None and 1.0 / _SMALLER < first[k] / known.first[k] < _SMALLER:
            by_known = column(k, float(known.step[k]))
        if known is None or not np.isfinite(by_known).all():
            found = _extrapolated(partial(column, k), float(steps[k]), rounding, turning)
            jacobian[:, k], uncertainty[:, k], steps[k], relative[:, k] = found
            continue
        steps[k], relative[:, k], jacobian[:, k] = known.step[k], known.relative[:, k], by_known
        error = 2.0 * relative[:, k] * np.abs(by_known)
        uncertainty[:, k] = error + rounding.of(by_known, float(steps[k]))
    return Evaluated(value, jacobian, uncertainty), Steps(steps, relative, first)


class _Rounding:
    """What rounding makes a difference quotient off by: of the function's numbers, and of its own.

    value: (m,) about the size of the outcome. point: (k,) the numbers.
    """

    def __init__(self, value: Array, point: Array) -> None:
        self._value, self._point = np.abs(value), float(np.abs(point).max(initial=0.0))

    def of(self, derivative: Array, step: float) -> Array:
        """Return (m,) of a derivative (m,) by a step."""
        moved: Array = self._value + np.abs(derivative) * self._point
        return _ROUNDINGS * moved / step


def _extrapolated(
    column: Callable[[float], Array], step: float, rounding: _Rounding, turning: Mask
) -> tuple[Array, Array, float, Array]:
    """Return a derivative (m,), about its error (m,), and the step, with what two differ by there.

    Each entry is of the step with which its error is least; the step is the last. turning: (m,)
    which entries are of angles.
    """
    best = error = relative = np.zeros(0)
    rough, tiny = column(_TINY * step), _TINY * step  # a function that goes round fast is unmasked
    fastest = float(np.abs(np.nan_to_num(rough[turning], posinf=0.0)).max(initial=0.0))
    step = min(step, _MOST_TURNED / fastest) if fastest > 0.0 else step
    for _ in range(_MOST_SMALLER):
        coarse, fine = column(step), column(0.5 * step)
        if np.isfinite(coarse + fine).all():
            apart, rounded = np.abs(fine - coarse), rounding.of(fine, step)
            agree = apart <= _DISAGREE * np.abs(fine) + rounded
            unlike = np.abs(fine - rough) - _ROUGHLY * np.abs(rough) - rounding.of(rough, tiny)
            agree &= ~(unlike > 0.0)
            apart = np.where(unlike > 0.0, np.abs(fine - rough), apart)
            off = np.where(agree, _REMAINDER, 1.0) * apart + rounded
            extrapolated = (4.0 * fine - coarse) / 3.0
            better = off < error if len(best) else np.ones(len(off), dtype=bool)
            best = np.where(better, extrapolated, best) if len(best) else extrapolated
            error = np.where(better, off, error) if len(error) else off
            size = np.abs(fine)
            relative = apart / np.where(size > 0.0, size, 1.0)
            if agree.all():
                break
        step /= _SMALLER
    if not len(best):
        raise ValueError("turns by more than a radian within any step")
    return best, error, 0.5 * step, relative


def _numbers(values: Any) -> Array:
    numbers = np.asarray(values, dtype=np.float64).ravel()
    if not np.isfinite(numbers).all():
        raise ValueError("gives a number that is not finite")
    return numbers


def _unturned(forward: Array, backward: Array) -> tuple[Array, Array]:
    """Return differences to either side without the whole turn by which a wrapped angle jumps.

    To either side of a point a smooth function differs by about the same, with opposite signs.
    """
    turns = 2.0 * np.pi * np.round((forward + backward) / (2.0 * np.pi))
    jumps_forward = np.abs(forward) >= np.abs(backward)
    return forward - turns * jumps_forward, backward - turns * ~jumps_forward
