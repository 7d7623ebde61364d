"""Recorded matrices as evidence: which fault of a slot makes of sound values what was recorded.

A fault is named only where it reproduces all records that deviate, to rounding. Where no single one
reproduces a matrix, its rows are looked at one by one: two faults are then named, each for its row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from comparisons.explain.hypotheses import Hypothesis, Quantity, named
from comparisons.faults.grammar import Composition, Slot, Values, compositions

Shown = Callable[[Array, Index], Array]
"""Of changed values (R, r, c) of some records (R,), what is compared with the recorded ones."""


def as_they_are(values: Array, rows: Index) -> Array:
    """Return changed values as they are compared: by themselves."""
    return values


def explained(
    slot: Slot, quantity: Quantity, values: Values, shown: Shown = as_they_are
) -> list[str]:
    """Return the faults of a slot that reproduce what deviates; none where none do.

    Args:
        slot: What was recorded, or what it is made of.
        quantity: The records, (M, ...), as `shown` makes them of the slot's values.
        values: Sound values of the slot in all M records.
        shown: How records come of values.
    """
    direct = quantity.have.shape[1:] == slot.shape and shown is as_they_are
    off = _terms_off(quantity) if direct else None
    whole = named(quantity, _hypotheses(slot, values, shown, off))
    if whole or off is None or slot.covariance:
        return whole
    lines: list[str] = []
    for row in np.flatnonzero(off.any(axis=1)).tolist():
        others = np.ones(slot.shape, dtype=bool)
        others[row] = False
        lines += named(quantity.part(row), _of_row(slot, values, row, off & ~others))
    return lines


def _terms_off(quantity: Quantity) -> NDArray[np.bool_]:
    """(r, c) which terms deviate in some record."""
    every = np.arange(len(quantity.have))
    apart = np.abs(quantity.apart(every, quantity.meant))
    terms = ~(apart <= 1.0)
    off: NDArray[np.bool_] = np.asarray(terms.any(axis=0)).reshape(quantity.have.shape[1:])
    return off


def _hypotheses(
    slot: Slot, values: Values, shown: Shown, off: NDArray[np.bool_] | None
) -> Iterator[Hypothesis]:
    for fault in compositions(slot, values):
        if off is None or fault.mask is None or not (off & ~fault.mask).any():
            yield _as_hypothesis(fault, values, shown)


def _as_hypothesis(fault: Composition, values: Values, shown: Shown) -> Hypothesis:
    def predict(rows: Index, *numbers: float) -> Array:
        return shown(fault.values(values.rows(rows), *numbers), rows)

    return Hypothesis(fault.words, predict, fault.start)


def _of_row(slot: Slot, values: Values, row: int, off: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Faults of terms of one row, beside whatever is wrong in the others."""
    for fault in compositions(slot, values):
        mask = fault.mask
        if mask is None or (off & ~mask).any() or mask[np.arange(len(mask)) != row].any():
            continue
        hypothesis = _as_hypothesis(fault, values, as_they_are)
        yield replace(
            hypothesis,
            predict=lambda rows, *numbers, whole=hypothesis: whole.predict(rows, *numbers)[:, row],
        )
