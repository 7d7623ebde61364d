"""Rows of numbers, kept by region, so that a scan touches only the regions it sees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ekf_reference.dense.triangles import Array

Index = NDArray[np.intp]


class Rows(NamedTuple):
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

    @property
    def regions(self) -> Index:
        """(r,) all that hold rows, ascending."""
        return np.array(sorted(self._count), dtype=np.intp)

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

    def gather(self, regions: Index) -> Rows:
        """The rows of distinct regions (r,), in their order."""
        kept = [number for number in regions.tolist() if number in self._count]
        counts = [self._count[number] for number in kept]
        parts = [self._table[n][:c] for n, c in zip(kept, counts, strict=True)]
        value = np.concatenate(parts) if parts else np.empty((0, self.width))
        return Rows(np.repeat(np.array(kept, dtype=np.intp), counts), value)

    def put(self, rows: Rows) -> None:
        """Write back rows as `gather` gave them, with other values."""
        number = rows.region
        begin = np.flatnonzero(np.diff(number, prepend=-1))
        end = np.append(begin[1:], len(number))
        for first, last in zip(begin.tolist(), end.tolist(), strict=True):
            self._table[int(number[first])][: last - first] = rows.value[first:last]

    def replace(self, region: int, value: Array) -> None:
        """Set all rows (n, w) of one region."""
        self._table[region], self._count[region] = np.array(value, dtype=float), len(value)

    def _room(self, number: int, size: int) -> Array:
        table = self._table.get(number)
        if table is None:
            table = np.empty((max(16, size), self.width))
        elif len(table) < size:
            table = np.concatenate((table, np.empty((max(len(table), size), self.width))))
        self._table[number] = table
        return table
