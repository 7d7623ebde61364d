"""Errors of blocks over a trace by the recorded truth, beside their sigmas: kept to be drawn."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.audit.replay import BlockLayout
from comparisons.trace.events import Snapshot


class BlockErrorCurve(NamedTuple):
    """A block at n snapshots.

    Attributes:
        block: Its name.
        event: (n,) numbers of the snapshots.
        time_s: (n,) NaN where none is recorded.
        error: (n, d) in the filter's own chart and units.
        sigma: (n, d) by the recorded covariance; NaN where a variance is negative.
    """

    block: str
    event: Index
    time_s: Array
    error: Array
    sigma: Array


class ErrorCurves:
    """Of the blocks that the prior has."""

    def __init__(self, layout: BlockLayout) -> None:
        """Start empty. layout: of the prior."""
        self._names = frozenset(layout.dims)
        self._rows: dict[str, list[tuple[int, float, Array, Array]]] = defaultdict(list)

    def add(self, snapshot: Snapshot, layout: BlockLayout) -> None:
        """Add a snapshot with an error. layout: of its state."""
        if snapshot.error is None:
            return
        time_s = np.nan if snapshot.time_s is None else snapshot.time_s
        with np.errstate(invalid="ignore"):
            sigma = np.sqrt(snapshot.covariance.diagonal())
        sigmas = layout.parts(snapshot.blocks, sigma)
        for name, error in layout.parts(snapshot.blocks, snapshot.error).items():
            if name in self._names:
                self._rows[name].append((snapshot.number, time_s, error, sigmas[name]))

    def curves(self) -> tuple[BlockErrorCurve, ...]:
        """Return the curve of each block, in the order of the state."""
        return tuple(
            BlockErrorCurve(name, *(np.array(column) for column in zip(*rows, strict=True)))
            for name, rows in self._rows.items()
        )
