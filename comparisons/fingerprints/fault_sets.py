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

MOST_FAULTS = 3
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


class _Joined(NamedTuple):
    """Rows of the fault without a number, -1 where there is none, and of those with one.

    rest: the square of what they leave.
    """

    rest: float
    base: int
    rows: tuple[int, ...]


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
        self._faults = [one for one, _ in faults]
        self._whole = np.array([made for _, made in faults]).reshape(-1, size)
        self._families = list[Family]()
        self._like = list[list[Family]]()
        self._slope = np.empty((0, size))
        for family, slope in families:
            self._add(family, slope)
        self._planted = np.array([one.plant is not None for one in self._families], dtype=bool)

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

    def likely(self, left: Array) -> Iterator[FaultSet]:
        """Yield sets of several faults that may leave the least, those of few first.

        Args:
            left: (n,) what is left without a fault.
        """
        joined, beside = [_Joined(np.inf, -1, ())], self._beside(left)
        for count in range(1, MOST_FAULTS + 1):
            joined = self._exchanged(left, self._extended(left, joined))
            if count > 1:
                yield from map(self._named, (*joined, *beside))
                beside = self._extended(left, beside)

    def _beside(self, left: Array) -> list[_Joined]:
        """One without a number, and one with."""
        bases = [_Joined(np.inf, base, ()) for base in range(len(self._faults))]
        return self._extended(left, bases)

    def _extended(self, left: Array, sets: Iterable[_Joined]) -> list[_Joined]:
        """Those that leave the least of sets with one more fault that has a number."""
        return _least(one for joined in sets for one in self._with_one(left, joined))

    def _exchanged(self, left: Array, sets: list[_Joined]) -> list[_Joined]:
        """Sets of which no member can be given up for another that leaves less."""
        for _ in range(_EXCHANGES):
            smaller = {
                (one.base, one.rows[:k] + one.rows[k + 1 :])
                for one in sets
                for k in range(len(one.rows))
            }
            others = self._extended(left, (_Joined(np.inf, *one) for one in sorted(smaller)))
            better = _least([*sets, *others])
            ended = [one[1:] for one in better] == [one[1:] for one in sets]
            sets = better
            if ended:
                break
        return sets

    def _with_one(self, left: Array, joined: _Joined) -> Iterator[_Joined]:
        """The sets of the least that one more makes of a set."""
        rows = list(joined.rows)
        if joined.base >= 0:
            left = left + self._whole[joined.base]
        basis = np.linalg.qr(self._slope[rows].T)[0]
        rest = left - basis @ (basis.T @ left)
        across = self._slope - (self._slope @ basis) @ basis.T
        square = np.sum(across**2, axis=1)
        useful = square > _ACROSS**2
        useful[rows] = False
        if self._is_planted(joined):
            useful &= ~self._planted
        taken = (across @ rest) ** 2 / np.where(useful, square, np.inf)
        for row in np.argsort(-taken, kind="stable")[:_LIKELY]:
            if useful[row]:
                rows_of_set = tuple(sorted((*joined.rows, int(row))))
                yield _Joined(float(rest @ rest - taken[row]), joined.base, rows_of_set)

    def _is_planted(self, joined: _Joined) -> bool:
        """Whether one is planted in the filter: another may take its place."""
        base = joined.base >= 0 and self._faults[joined.base].plant is not None
        return bool(base or self._planted[list(joined.rows)].any())

    def _named(self, joined: _Joined) -> FaultSet:
        base = self._faults[joined.base] if joined.base >= 0 else NONE
        return FaultSet(
            base,
            tuple(self._families[row] for row in joined.rows),
            tuple(tuple(self._like[row]) for row in joined.rows),
        )


def _least(sets: Iterable[_Joined]) -> list[_Joined]:
    """The sets that leave the least, each once."""
    once = {(one.base, one.rows): one for one in sets}
    return sorted(once.values())[:_LIKELY]
