"""Mistakes as formulas with figures to be fitted, and accepted where they leave nothing over.

A quantity is what a filter recorded beside what it should have been. A hypothesis predicts what a
mistake would have recorded, given its figures; these are fitted by Gauss and Newton's method, which
is linear least squares where the formula is linear. It is named only when all records that deviate
are then reproduced to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index, wrapped
from comparisons.faults.grammar import Text, times

EQUAL = 1e-7
"""Figures that differ by less, relative to their size, are the same."""
_FITTED = 300
"""So many records are fitted, spread over those that deviate; all of them are then compared."""
_ITERATIONS = 8
_QUARTER, _LEAST_BEGUN = 4, 10
"""A fit of angles begins with a quarter of the records, so many at least."""
_SPARE = 2
"""More records than figures, so many at least, for a fit to be evidence."""
_LEAST_SPLIT = 3
"""So many records at least on either side of a bound that separates those that deviate."""
_DETERMINED = 1e-6
"""Smallest singular value, relative to the largest, of figures that can be separated."""

Predict = Callable[..., Array]
"""Of rows (R,) and a mistake's figures: what would have been recorded, (R, ...)."""


@dataclass(frozen=True)
class Hypothesis:
    """One mistake. start: figures to begin the fit with."""

    text: Text
    predict: Predict
    start: tuple[float, ...] = ()

    def counted(self, figures: tuple[float, ...], quantity: Quantity) -> str:
        """Return what to say with figures, and of how many records."""
        said = self.text.format if isinstance(self.text, str) else self.text
        return f"{said(*figures)}, {counted(quantity)}"


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """M records of one quantity.

    have, meant: (M, ...). tolerance: what rounding explains, of a shape that broadcasts to theirs.
    records: what they are of. angle: which entries differ the short way round. features: (M,)
    each, by which records that deviate may differ from the others; of whole numbers, if they are
    names.
    """

    have: Array
    meant: Array
    tolerance: Array | float
    records: str
    angle: bool | NDArray[np.bool_] = False
    features: Mapping[str, Array | Index] = field(default_factory=dict)

    def apart(self, rows: Index, expected: Array) -> Array:
        """Return (R, n) how far records are from these, in units of the tolerance."""
        difference = self.have[rows] - expected
        if np.any(self.angle):
            difference = np.where(self.angle, wrapped(difference), difference)
        return (difference / self.limit(rows)).reshape(len(rows), -1)

    def limit(self, rows: Index) -> Array:
        """Return the tolerance of records (R, ...)."""
        return np.broadcast_to(self.tolerance, self.have.shape)[rows]

    def part(self, *at: int) -> Quantity:
        """Return an entry of each record, or a row of it."""
        of: Any = (slice(None), *at)
        limit = np.broadcast_to(self.tolerance, self.have.shape)
        return replace(
            self,
            have=self.have[of],
            meant=self.meant[of],
            tolerance=limit[of],
            angle=np.broadcast_to(self.angle, self.have.shape[1:])[at],
        )

    def columns(self, at: slice) -> Quantity:
        """Return some columns of each record, a matrix."""
        limit = np.broadcast_to(self.tolerance, self.have.shape)
        return replace(
            self,
            have=self.have[:, :, at],
            meant=self.meant[:, :, at],
            tolerance=limit[:, :, at],
        )

    def off(self) -> NDArray[np.bool_]:
        """Return (M,) which records deviate."""
        every = np.arange(len(self.have))
        apart = np.abs(self.apart(every, self.meant))
        result: NDArray[np.bool_] = ~(apart.max(axis=1, initial=0.0) <= 1.0)
        return result


def named(quantity: Quantity, hypotheses: Iterable[Hypothesis]) -> list[str]:
    """Return the first hypothesis that reproduces all that deviates, with its figures and counts.

    Empty where nothing deviates, or nothing explains it.
    """
    fitted = best(quantity, hypotheses)
    return [] if fitted is None else [fitted[0].counted(fitted[1], quantity)]


def best(
    quantity: Quantity, hypotheses: Iterable[Hypothesis]
) -> tuple[Hypothesis, tuple[float, ...]] | None:
    """Return the first hypothesis that reproduces all that deviates, and its figures."""
    rows = np.flatnonzero(quantity.off())
    if not len(rows):
        return None
    spread = np.unique(np.linspace(0, len(rows) - 1, _FITTED).astype(np.intp))
    for hypothesis in hypotheses:
        figures = _fit(quantity, hypothesis, rows[spread])
        if figures is not None and _holds(quantity, hypothesis, figures, rows):
            return hypothesis, figures
    return None


def counted(quantity: Quantity) -> str:
    """Return in how many records, and in which, if a bound or a name separates them."""
    off = quantity.off()
    count = int(np.count_nonzero(off))
    where = f"in {count} of {len(off)} {quantity.records}"
    if min(count, len(off) - count) < _LEAST_SPLIT:
        return where
    for name, values in quantity.features.items():
        inside, outside = values[off], values[~off]
        if values.dtype.kind == "i":
            names = np.unique(inside)
            if len(names) == 1 and names[0] not in outside:
                return f"{where}, those of {name} {names[0]}"
        elif inside.min() > outside.max():
            return f"{where}, those with {name} >= {inside.min():.4g}"
        elif inside.max() < outside.min():
            return f"{where}, those with {name} <= {inside.max():.4g}"
    return where


def _holds(
    quantity: Quantity, hypothesis: Hypothesis, figures: tuple[float, ...], rows: Index
) -> bool:
    return bool(np.abs(quantity.apart(rows, hypothesis.predict(rows, *figures))).max() <= 1.0)


def _fit(quantity: Quantity, hypothesis: Hypothesis, rows: Index) -> tuple[float, ...] | None:
    """Figures that fit the rows, None where none do, or the rows do not decide on them.

    A figure by whose square the records differ has another least on the other side of its start.
    """
    start = np.array(hypothesis.start)
    if len(rows) < len(start) + _SPARE and len(start):
        return None
    figures = _least(quantity, hypothesis, rows, start)
    fitted = _reproducing(quantity, hypothesis, figures, rows)
    if fitted is not None or figures is None or len(start) != 1:
        return fitted
    other = _least(quantity, hypothesis, rows, 2.0 * start - figures)
    return _reproducing(quantity, hypothesis, other, rows)


def _reproducing(
    quantity: Quantity, hypothesis: Hypothesis, figures: Array | None, rows: Index
) -> tuple[float, ...] | None:
    """Figures as they are reported, if they reproduce the rows."""
    if figures is None:
        return None
    reported = tuple(np.where(np.abs(figures) < 1e-12, 0.0, figures).tolist())
    with np.errstate(invalid="ignore"):
        return reported if _holds(quantity, hypothesis, reported, rows) else None


def _least(quantity: Quantity, hypothesis: Hypothesis, rows: Index, start: Array) -> Array | None:
    """Figures that Gauss and Newton's method ends at; None where rows do not decide on them."""
    figures = start
    begin = _least_turned(quantity, rows) if np.any(quantity.angle) else rows
    for k in range(_ITERATIONS if len(figures) else 0):
        some = begin if k < _ITERATIONS // 2 else rows
        base = hypothesis.predict(some, *figures)
        apart, columns = quantity.apart(some, base).ravel(), []
        for i, value in enumerate(figures):
            step = 1e-6 * max(1.0, abs(value))
            other = figures.copy()
            other[i] += step
            change = hypothesis.predict(some, *other) - base
            columns.append((change / quantity.limit(some) / step).ravel())
        by_figures = np.column_stack(columns)
        size = np.linalg.norm(by_figures, axis=0)
        if not (np.isfinite(by_figures).all() and np.isfinite(apart).all() and (size > 0.0).all()):
            return None
        moved, _, _, values = np.linalg.lstsq(by_figures / size, apart, rcond=None)
        if values[-1] < _DETERMINED * values[0]:
            return None
        figures = figures + moved / size
        small = np.abs(moved / size).max() <= 1e-13 * max(1.0, float(np.abs(figures).max()))
        if small and len(some) == len(rows):
            break
    return figures


def _least_turned(quantity: Quantity, rows: Index) -> Index:
    """The quarter of some records that deviates least: none of these by more than half a turn."""
    off = np.abs(quantity.apart(rows, quantity.meant[rows])).max(axis=1)
    count = max(len(rows) // _QUARTER, min(len(rows), _LEAST_BEGUN))
    return np.sort(rows[np.argsort(off)[:count]])


def scaled(what: str, array: Array, mask: Array | float = 1.0) -> Hypothesis:
    """Return the hypothesis that the entries of an array (M, ...) in a mask have a factor."""

    def predict(rows: Index, factor: float) -> Array:
        result: Array = array[rows] * (1.0 + (factor - 1.0) * np.asarray(mask))
        return result

    return Hypothesis(times(what), predict, (1.0,))


def instead(text: str, array: Array) -> Hypothesis:
    """Return the hypothesis that other figures (M, ...) stand where the right ones belong."""
    return Hypothesis(text, lambda rows: array[rows])
