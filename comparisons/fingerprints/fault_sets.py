"""Which faults may explain the first poses of an estimate together, before a filter runs with them.

What several do at once is nearly the sum of what each does alone, so that sets of them are chosen
by linear algebra.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import NONE, Family, Fault

_MOST_FAULTS = 3
"""Most that are looked for together."""
_LIKELY = 6
"""So many sets of each size are kept."""
_EXCHANGES = 5
"""Most rounds in which a member of a set is given up for another."""
_ACROSS = 1e-6
"""Least part of a derivative that others do not have, for it to be of use beside them."""
_PARALLEL = 1e-2
"""Most by which derivatives of length one differ that may be the same: they are differences."""


class FaultSet(NamedTuple):
    """Faults with a number, beside one without.

    Attributes:
        base: That without a number; none where there is none.
        families: Those with one.
        like: For each of these, others that do the same, or nearly, by their derivatives.
    """

    base: Fault
    families: tuple[Family, ...]
    like: tuple[tuple[Family, ...], ...]

    def others(self) -> Iterator[tuple[Family, ...]]:
        """Yield the families with another in the place of one."""
        for k, like in enumerate(self.like):
            for other in like:
                yield (*self.families[:k], other, *self.families[k + 1 :])


class _Rows(NamedTuple):
    """Rows of the fault without a number, -1 where there is none, and of those with one."""

    base: int = -1
    families: tuple[int, ...] = ()


class LinearEffects:
    """What each fault does alone to what is left (n,) of the first poses."""

    def __init__(
        self,
        faults: Sequence[tuple[Fault, Array]],
        families: Sequence[tuple[Family, Array]],
        size: int,
    ) -> None:
        """Set what was measured.

        Args:
            faults: Without a number, and the difference (n,) that each makes.
            families: With one, and the derivative (n,) by it.
            size: n, numbers that are compared.
        """
        self.size = size
        self._alone, self._derivatives = dict(faults), dict(families)
        self._faults = list(self._alone)
        self._whole = np.array(list(self._alone.values())).reshape(-1, size)
        self._families = list[Family]()
        self._like = list[list[Family]]()
        self._slope = np.empty((0, size))
        for family, slope in families:
            self._add(family, slope)
        self._planted = np.array(
            [family.plant is not None for family in self._families], dtype=bool
        )

    def _add(self, family: Family, slope: Array) -> None:
        """One more family, or what is like one that there is."""
        length = float(np.linalg.norm(slope))
        if not length:
            return
        along = slope / length
        sides = self._slope * np.sign(self._slope @ along)[:, None]
        same = np.flatnonzero(np.linalg.norm(sides - along, axis=1) < _PARALLEL)
        if len(same):
            self._like[same[0]].append(family)
        else:
            self._families.append(family)
            self._like.append([])
            self._slope = np.vstack((self._slope, along))

    def change(self, base: Fault, numbers: Iterable[tuple[Family, float]]) -> Array:
        """Return what faults change together (n,) as far as it is linear.

        numbers: of families, from that of no fault on.
        """
        change = np.zeros(self.size) if base is NONE else self._alone[base].copy()
        for family, number in numbers:
            change += number * self._derivatives[family]
        return change

    def likely(self, left: Array) -> Iterator[FaultSet]:
        """Yield sets of several faults that may leave the least, those of few first.

        Args:
            left: (n,) what is left without a fault.
        """
        joined = self._exchanged(left, self._extended(left, [_Rows()]))
        beside: Iterable[_Rows] = [_Rows(base) for base in range(len(self._faults))]
        for _ in range(2, _MOST_FAULTS + 1):
            joined = self._exchanged(left, self._extended(left, joined))
            beside = self._extended(left, beside)
            yield from map(self._named, (*joined, *beside))

    def _extended(self, left: Array, sets: Iterable[_Rows]) -> dict[_Rows, float]:
        """The likeliest of sets with one more fault that has a number."""
        return _least(
            {rows: rest for fault_set in sets for rows, rest in self._with_one(left, fault_set)}
        )

    def _exchanged(self, left: Array, sets: dict[_Rows, float]) -> dict[_Rows, float]:
        """Sets of which no member can be given up for another that leaves less."""
        for _ in range(_EXCHANGES):
            smaller = {
                _Rows(fault_set.base, fault_set.families[:k] + fault_set.families[k + 1 :])
                for fault_set in sets
                for k in range(len(fault_set.families))
            }
            better = _least(sets | self._extended(left, sorted(smaller)))
            ended, sets = list(better) == list(sets), better
            if ended:
                break
        return sets

    def _with_one(self, left: Array, rows: _Rows) -> Iterator[tuple[_Rows, float]]:
        """The likeliest sets that one more makes of a set, and the square of what each leaves."""
        some = list(rows.families)
        if rows.base >= 0:
            left = left + self._whole[rows.base]
        basis = np.linalg.qr(self._slope[some].T)[0]
        rest = left - basis @ (basis.T @ left)
        across = self._slope - (self._slope @ basis) @ basis.T
        square = np.sum(across**2, axis=1)
        useful = square > _ACROSS**2
        useful[some] = False
        if self._is_planted(rows):
            useful &= ~self._planted
        taken = (across @ rest) ** 2 / np.where(useful, square, np.inf)
        for row in np.argsort(-taken, kind="stable")[:_LIKELY]:
            if useful[row]:
                families = tuple(sorted((*rows.families, int(row))))
                yield _Rows(rows.base, families), float(rest @ rest - taken[row])

    def _is_planted(self, rows: _Rows) -> bool:
        """Whether one is planted in the filter: another may take its place."""
        base = rows.base >= 0 and self._faults[rows.base].plant is not None
        return bool(base or self._planted[list(rows.families)].any())

    def _named(self, rows: _Rows) -> FaultSet:
        return FaultSet(
            self._faults[rows.base] if rows.base >= 0 else NONE,
            tuple(self._families[row] for row in rows.families),
            tuple(tuple(self._like[row]) for row in rows.families),
        )


def _least(rests: dict[_Rows, float]) -> dict[_Rows, float]:
    """The sets that leave the least, by the square of it."""
    return dict(sorted(rests.items(), key=lambda entry: entry[::-1])[:_LIKELY])
