"""Numbers of faults, fitted together to the first poses of an estimate."""

from __future__ import annotations

from collections.abc import Callable
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
        numbers = zip(self.from_neutral, self.at, strict=True)
        members = [_member(family, at) for (family, moved), at in numbers if abs(moved) > _NEUTRAL]
        return together(self.base, *members)

    @property
    def from_neutral(self) -> list[tuple[Family, float]]:
        """How far each number, of a factor its logarithm, is from that of no fault."""
        return [
            (family, float(at - _neutral(family)))
            for family, at in zip(self.families, self.at, strict=True)
        ]

    @property
    def norm(self) -> float:
        """Of what is left."""
        return float(np.linalg.norm(self.left))

    def at_numbers(self, at: Array) -> Fault:
        """All of them at once, with other numbers (k,)."""
        members = (
            _member(family, number) for family, number in zip(self.families, at, strict=True)
        )
        return together(self.base, *members)

    def moved(self, which: int) -> Fault:
        """All of them at once, one number moved by the step of a difference."""
        return self.at_numbers(self.at + STEP * (np.arange(len(self.at)) == which))

    def near(self, enough: float) -> bool:
        """Whether no more than so much is left anywhere."""
        return bool(np.abs(self.left).max() <= enough)


def unfitted(families: tuple[Family, ...], base: Fault, left: Array) -> FaultFit:
    """Return a fit whose numbers are those of no fault. left: (n,) what a fault beside leaves."""
    return FaultFit(base, families, np.array([_neutral(family) for family in families]), left)


def starts(family: Family) -> list[float]:
    """Return numbers from which a fit may begin, the first that of no fault."""
    neutral = _neutral(family)
    offsets = _FACTORS if family.factor else _OFFSETS
    return [neutral + offset for offset in (0.0, *offsets)]


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


def _of_length(remainder: Remainder, length: int) -> Remainder:
    """What a fault leaves where it is as much as another leaves; else None.

    A filter whose instants are others is compared in other numbers: between them by poses alone.
    """

    def as_long(fault: Fault) -> Array | None:
        left = remainder(fault)
        return left if left is not None and len(left) == length else None

    return as_long


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
