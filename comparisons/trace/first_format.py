"""Format 1 of a trace, of 0.2: a row an event, matrices as blobs. It is read, not written."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator
from typing import Any

import numpy as np

from comparisons.trace.batch import COLUMNS
from comparisons.trace.events import ADDITIVE
from comparisons.trace.rows import Cell, StoredRow, distinct

_MATRICES = (
    *("jacobian", "noise", "noise_jacobian", "residual", "correction", "gain"),
    *("covariance", "mean", "error"),
)
_AT = {name: at for at, name in enumerate(_MATRICES, 6)}
_REPEATED = ("jacobian", "noise", "noise_jacobian")
"""Matrices that are NULL where they are those of the event before of the same kind and sensor."""
_CHUNK, _CHUNK_BYTES = 128, 1 << 24
_LONGEST_TEXT = 1 << 22


class FirstFormat:
    """Reads a chunk of rows after another, and fills in what is repeated."""

    def __init__(self) -> None:
        """Start before the first event."""
        self._last: dict[tuple[Any, Any], tuple[Any, dict[str, Cell | None]]] = {}
        self._bytes = 0

    def chunk(self, file: sqlite3.Connection, after: int) -> Iterator[StoredRow]:
        """Yield some hundred rows, or some megabytes. after: number of the last event."""
        self._bytes = 0
        asked = "SELECT * FROM event WHERE number > ? ORDER BY number LIMIT ?"
        for row in file.execute(asked, (after, _CHUNK)):
            yield self.row(row)
            if self._bytes > _CHUNK_BYTES:
                break

    def row(self, row: tuple[Any, ...]) -> StoredRow:
        """Return a row of the table as an event is made of it."""
        number, kind, time_s, sensor, blocks, used = row[:6]
        before = self._before(kind, sensor, blocks)
        cells = []
        for name in COLUMNS.get(kind, ()) if isinstance(kind, str) else ():
            blob = row[_AT[name]] if name in _AT else None
            if name in _REPEATED:
                if blob is not None:
                    before[name] = self._cell(blob)
                cells.append(before.get(name))
            else:
                cells.append(None if blob is None else self._cell(blob))
        names = distinct(_json(blocks))
        text = _text(kind, sensor, row[15])
        return StoredRow(number, kind, time_s, names, text, used, tuple(cells))

    def _before(self, kind: Any, sensor: Any, blocks: Any) -> dict[str, Cell | None]:
        """Matrices of the event before of a kind and sensor, if it was on the same blocks."""
        found = self._last.get((kind, sensor))
        if found is None or found[0] != blocks:
            found = self._last[kind, sensor] = blocks, {}
        return found[1]

    def _cell(self, blob: Any) -> Cell:
        """The numbers of a blob."""
        if not isinstance(blob, bytes) or len(blob) % 8:
            return Cell(None)
        self._bytes += len(blob)
        found = np.frombuffer(blob, "<f8")
        return Cell(found if math.isfinite(found.dot(found)) else None)


def _text(kind: Any, sensor: Any, note: Any) -> Any:
    """An event's own text as format 2 has it."""
    if kind in ("update", "clone"):
        return sensor if kind == "update" else note
    found = _json(note)
    if isinstance(found, list):
        if kind == "prior":
            return [found, [ADDITIVE] * len(found)]
        if kind == "augment" and len(found) == 2:
            return [*found, ADDITIVE]
    return found


def _json(text: Any) -> Any:
    """What a text in JSON says; None where it is none, or beyond what names take."""
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
        return None
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None
