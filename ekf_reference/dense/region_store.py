"""Rows of numbers, kept by region, so that a scan touches only the regions it sees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask


class RegionRows(NamedTuple):
    """The rows of some regions, one region after the other; copies.

    region: (n,) of each. value: (n, w).
    """

    region: Index
    value: Array


@dataclass
class RegionStore:
    """Tables of `width` numbers, one per region, that grow at their ends."""

    width: int
    _table: dict[int, Array] = field(default_factory=dict)
    _count: dict[int, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows in all regions."""
        return sum(self._count.values())

    def append(self, region: Index, value: Array) -> None:
        """Add rows (n, w), each to its region (n,)."""
        order = np.argsort(region, kind="stable")
        numbers, first = np.unique(region[order], return_index=True)
        ends = np.append(first, len(order))[1:]
        for number, begin, end in zip(numbers.tolist(), first, ends, strict=True):
            rows = order[begin:end]
            count = self._count.get(number, 0)
            table = self._room(number, count + len(rows))
            table[count : count + len(rows)] = value[rows]
            self._count[number] = count + len(rows)

    def gather(self, regions: Index | None = None) -> RegionRows:
        """The rows of distinct regions (r,), in their order; of all, ascending, by default."""
        asked = sorted(self._count) if regions is None else regions.tolist()
        kept = [number for number in asked if number in self._count]
        counts = [self._count[number] for number in kept]
        parts = [self._table[n][:c] for n, c in zip(kept, counts, strict=True)]
        value = np.concatenate(parts) if parts else np.empty((0, self.width))
        return RegionRows(np.repeat(np.array(kept, dtype=np.intp), counts), value)

    def put(self, rows: RegionRows) -> None:
        """Write back rows as `gather` gave them, with other values."""
        for number, first, last in _runs(rows.region):
            self._table[number][: last - first] = rows.value[first:last]

    def keep(self, rows: RegionRows, kept: Mask) -> None:
        """Drop those of the rows that `gather` gave, and `put` wrote, that are not kept (n,)."""
        if kept.all():
            return
        for number, first, last in _runs(rows.region):
            if not kept[first:last].all():
                left = rows.value[first:last][kept[first:last]]
                self._table[number], self._count[number] = left, len(left)

    def _room(self, number: int, size: int) -> Array:
        table = self._table.get(number)
        if table is None:
            table = np.empty((max(16, size), self.width))
        elif len(table) < size:
            table = np.concatenate((table, np.empty((max(len(table), size), self.width))))
        self._table[number] = table
        return table


def _runs(region: Index) -> Iterator[tuple[int, int, int]]:
    """Each region of rows (n,), and its first row and the one after its last."""
    begin = np.flatnonzero(np.diff(region, prepend=-1))
    end = np.append(begin, len(region))[1:]
    return zip(region[begin].tolist(), begin.tolist(), end.tolist(), strict=True)
