"""Numbers of faults, fitted together to the first poses of an estimate, as few as explain them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Family, Fault, together
from comparisons.fingerprints.companion import NEAR

Remainder = Callable[[Fault], Array | None]
"""(n,) what a filter with a fault leaves of the first poses; None where it does not reach them."""
_ROUNDS, STEP, _MOST_STEP = 12, 1e-4, 1.5
"""Of a fit: rounds, the step of a difference, and the largest of a round, in the number or its
logarithm."""
_EXPLAINED = 0.7
"""Least share of what is left that a round's numbers explain; beside another fault it is less."""
_NUMBERS = 3
"""Most numbers that are fitted together."""
_FACTORS = (2.0, -2.0, 5.0, -5.0, 8.0)
_OFFSETS = (0.05, -0.05, 0.3)
"""From the number of no fault, where a fit begins anew: of logarithms, and of what is added."""
_NEUTRAL = 1e-6
"""A number so near to that of no fault is none."""


@dataclass(frozen=True)
class FaultFit:
    """Faults with the numbers that fit.

    base: a fault beside them. at: (k,) numbers of the families, a factor's is its logarithm. left:
    (n,) what is left with them.
    """

    base: Fault
    families: tuple[Family, ...]
    at: Array
    left: Array

    @property
    def fault(self) -> Fault:
        """All of them at once, but for those that are none."""
        numbers = zip(self.families, self.at, strict=True)
        kept = [_member(one, at) for one, at in numbers if abs(at - _neutral(one)) > _NEUTRAL]
        return together(self.base, *kept)

    @property
    def planted(self) -> bool:
        """Whether one is planted in the filter: another may take its place."""
        return bool(self.base.plant or any(one.plant for one in self.families))

    def at_numbers(self, at: Array) -> Fault:
        """All of them at once, with other numbers (k,)."""
        members = (_member(one, number) for one, number in zip(self.families, at, strict=True))
        return together(self.base, *members)

    def moved(self, which: int) -> Fault:
        """All of them at once, one number moved by the step of a difference."""
        return self.at_numbers(self.at + STEP * (np.arange(len(self.at)) == which))

    def near(self, enough: float) -> bool:
        """Whether no more than so much is left anywhere."""
        return bool(np.abs(self.left).max() <= enough)

    def with_one(self, family: Family) -> FaultFit:
        """The same beside another family, as yet without a fault."""
        return replace(
            self, families=(*self.families, family), at=np.append(self.at, _neutral(family))
        )


def starts(family: Family) -> list[float]:
    """Return numbers from which a fit may begin, the first that of no fault."""
    neutral = _neutral(family)
    offsets = _FACTORS if family.factor else _OFFSETS
    return [neutral + one for one in (0.0, *offsets)]


def settled(fit: FaultFit, remainder: Remainder) -> FaultFit | None:
    """Return a fit with better numbers, by Gauss and Newton, as far as they explain what is left.

    The derivatives are differences. None where a filter breaks down, or has other instants with
    other numbers.
    """
    remainder = _of_length(remainder, len(fit.left))
    for _ in range(_ROUNDS):
        slope = _slope(fit, remainder)
        if slope is None:
            return None
        step = -np.linalg.lstsq(slope, fit.left)[0]
        if not np.linalg.norm(slope @ step) > _EXPLAINED * np.linalg.norm(fit.left):
            return fit  # rounding is left, or another fault
        step = np.clip(step, -_MOST_STEP, _MOST_STEP)
        left = remainder(fit.at_numbers(fit.at + step))
        if left is None:
            return None
        fit = replace(fit, at=fit.at + step, left=left)
        if np.abs(step).max() < STEP**2 or fit.near(1e-3 * NEAR):
            break
    return fit


def selected(
    base: Fault, families: Iterable[Family], remainder: Remainder, enough: float = NEAR
) -> Iterator[FaultFit]:
    """Yield fits of no number, of one, and so on, beside a fault, until only rounding is left.

    Forward selection: each next number is the one that, with those before it, leaves the least.
    enough: what rounding leaves.
    """
    left = remainder(base)
    fit = None if left is None else FaultFit(base, (), np.empty(0), left)
    if left is not None:
        remainder = _of_length(remainder, len(left))
    for _ in range(_NUMBERS):
        if fit is None or fit.near(enough):
            break
        yield fit
        one = _next(fit, families, remainder)
        fit = None if one is None else settled(fit.with_one(one), remainder)
    if fit is not None:
        yield fit


def nearest(fit: FaultFit, faults: Iterable[Fault], remainder: Remainder) -> Fault | None:
    """Return the fault that leaves the least beside the numbers of a fit; None where none helps."""
    best, least = None, float(np.linalg.norm(fit.left))
    remainder = _of_length(remainder, len(fit.left))
    for fault in faults:
        if fault.plant and fit.planted:
            continue
        left = remainder(together(fault, fit.fault))
        if left is not None and np.linalg.norm(left) < least:
            best, least = fault, float(np.linalg.norm(left))
    return best


def _of_length(remainder: Remainder, length: int) -> Remainder:
    """What a fault leaves where it is as much as another leaves; else None.

    A filter whose instants are others is compared in other numbers: between them by poses alone.
    """

    def as_long(fault: Fault) -> Array | None:
        left = remainder(fault)
        return left if left is not None and len(left) == length else None

    return as_long


def _next(fit: FaultFit, families: Iterable[Family], remainder: Remainder) -> Family | None:
    """The family that leaves the least beside those of a fit, by the derivatives."""
    slope, best, least = _slope(fit, remainder), None, np.inf
    for one in families:
        if slope is None or one in fit.families or (fit.planted and one.plant):
            continue
        other = remainder(fit.with_one(one).moved(len(fit.at)))
        if other is None:
            continue
        all_of = np.column_stack((slope, (other - fit.left) / STEP))
        rest = fit.left + all_of @ -np.linalg.lstsq(all_of, fit.left)[0]
        if np.linalg.norm(rest) < least:
            best, least = one, float(np.linalg.norm(rest))
    return best


def _slope(fit: FaultFit, remainder: Remainder) -> Array | None:
    """(n, k) derivatives of what is left by the numbers."""
    columns = []
    for which in range(len(fit.at)):
        other = remainder(fit.moved(which))
        if other is None:
            return None
        columns.append((other - fit.left) / STEP)
    return np.column_stack(columns) if columns else np.empty((len(fit.left), 0))


def _member(family: Family, at: float) -> Fault:
    return family.member(float(np.exp(at)) if family.factor else float(at))


def _neutral(family: Family) -> float:
    """The number of no fault, of a factor its logarithm."""
    return float(np.log(family.neutral)) if family.factor else family.neutral
