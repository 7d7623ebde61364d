"""Rows of a trace as events: every row is checked before it becomes one."""

from __future__ import annotations

import json
import math
import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from comparisons.arrays import Array, Mask
from comparisons.errors import InputError, printable
from comparisons.trace.events import (
    Augment,
    Blocks,
    Clone,
    Directions,
    Event,
    Predict,
    Prior,
    Remove,
    Reset,
    Snapshot,
    Update,
)

MOST_ENTRIES = 20_000
"""Of a state."""
_LONGEST_TEXT = 1 << 22
_CHUNK, _CHUNK_BYTES = 128, 1 << 24
_MOST_TEXTS = 4096
_IN_CACHE = 16384
"""Numbers of matrices that are checked at once."""
_ASYMMETRY, _NEGATIVE = 1e-6, 1e-9
"""Beyond rounding, of a covariance scaled to a unit diagonal: differences of entries that should be
equal, and eigenvalues below zero."""

Row = tuple[Any, ...]


class EventReader:
    """Makes events of rows, and follows which blocks there are.

    at: number of the last event, -1 before the first.
    """

    def __init__(self, path: Path) -> None:
        """path: named in errors."""
        self.at = -1
        self._path = path
        self._bytes = 0
        self._dims: dict[str, int] = {}
        self._size = 0
        self._blocks: dict[str, tuple[Blocks, int]] = {}
        self._last: dict[tuple[str, str | None], tuple[str, dict[str, Array]]] = {}
        self._unchecked: list[tuple[int, str, bool, Array]] = []
        self._make: dict[str, Callable[[Row], Event]] = {
            "prior": self._prior,
            "predict": self._predict,
            "update": self._update,
            "augment": self._augment,
            "clone": self._clone,
            "remove": self._remove,
            "reset": self._reset,
            "snapshot": self._snapshot,
            "directions": self._directions,
        }

    def events(self, rows: Iterable[Row]) -> list[Event]:
        """Return the next events, some hundred of them or some megabytes.

        Raises:
            InputError: A row cannot be an event; of several the first, with its number.
        """
        with np.errstate(all="ignore"):  # a number that is too large is refused by itself
            return self._events(rows)

    def _events(self, rows: Iterable[Row]) -> list[Event]:
        self._bytes, self._unchecked = 0, []
        found = []
        try:
            for row in rows:
                found.append(self._event(row))
                if len(found) == _CHUNK or self._bytes > _CHUNK_BYTES:
                    break
        except sqlite3.Error as error:
            self._check_covariances()
            raise InputError(
                f"{self._path}, after event {self.at}: SQLite cannot read it "
                f"({printable(str(error)):.100}); the sqlite3 shell's .recover may save the rest"
            ) from None
        except InputError:
            self._check_covariances()
            raise
        self._check_covariances()
        return found

    def _event(self, row: Row) -> Event:
        number, kind, time_s = row[:3]
        if number != self.at + 1:
            self._refuse(number, f"stands after event {self.at}, expected {self.at + 1}")
        make = self._make.get(kind)
        if make is None:
            self._refuse(number, f"kind {shown(kind)}, expected one of {', '.join(self._make)}")
        if time_s is not None and not (isinstance(time_s, float) and math.isfinite(time_s)):
            self._refuse(number, f"time_s {shown(time_s)}, expected a number of seconds")
        if not self._dims and kind != "prior":
            self._refuse(number, f"is a {kind}, expected the prior first")
        event = make(row)
        self.at = number
        return event

    def _prior(self, row: Row) -> Prior:
        number, time_s = row[0], row[2]
        if self._dims:
            self._refuse(number, "is a second prior; a filter that begins anew has a new trace")
        names, dims = texts(row[4]), _counts(row[15])
        if not names or dims is None or len(dims) != len(names):
            self._refuse(number, "blocks and note are not lists of names and of dimensions")
        self._dims = dict(zip(names, dims, strict=True))
        self._changed(number)
        p = self._shaped(row, 12, "covariance", self._size, self._size)
        self._unchecked.append((number, "covariance (P)", False, p))
        return Prior(number, time_s, names, dims, p)

    def _predict(self, row: Row) -> Predict:
        blocks, n = self._named(row)
        before = self._before(row)
        f = self._repeated(before, row, 6, "jacobian", n, n)
        q = self._repeated(before, row, 7, "noise", n, n)
        if row[7] is not None:
            self._unchecked.append((row[0], "noise (Q)", False, q))
        return Predict(row[0], row[2], blocks, f, q)

    def _update(self, row: Row) -> Update:
        number, _, time_s, sensor, _, used = row[:6]
        blocks, n = self._named(row)
        if not isinstance(sensor, str):
            self._refuse(number, f"sensor {shown(sensor)}, expected a name")
        if used not in (0, 1):
            self._refuse(number, f"used is {shown(used)}, expected 0 or 1")
        residual = self._array(row, 9, "residual")
        m = len(residual)
        if not m:
            self._refuse(number, "residual is empty")
        before = self._before(row)
        h = self._repeated(before, row, 6, "jacobian", m, n)
        r = self._repeated(before, row, 7, "noise", m, m)
        if row[7] is not None:
            self._unchecked.append((number, "noise (R)", True, r))
        correction = gain = None
        if row[10] is not None:
            correction = self._shaped(row, 10, "correction", self._size)
        if row[11] is not None:
            gain = self._shaped(row, 11, "gain", self._size, m)
        return Update(number, time_s, sensor, blocks, residual, h, r, bool(used), correction, gain)

    def _augment(self, row: Row) -> Augment:
        number, _, time_s = row[:3]
        blocks, n = self._named(row)
        name, d = self._new(row)
        before = self._before(row)
        g_x = self._repeated(before, row, 6, "jacobian", d, n)
        if row[7] is None:
            m = len(before["noise"]) if "noise" in before else 0
        else:
            m = math.isqrt(len(self._array(row, 7, "noise")))
        r = self._repeated(before, row, 7, "noise", m, m)
        g_z = self._repeated(before, row, 8, "noise_jacobian", d, m)
        if row[7] is not None and m:
            self._unchecked.append((number, "noise (R)", False, r))
        self._dims[name] = d
        self._changed(number)
        return Augment(number, time_s, name, blocks, g_x, g_z, r)

    def _clone(self, row: Row) -> Clone:
        blocks, d = self._named(row)
        if len(blocks) != 1:
            self._refuse(row[0], f"clones {len(blocks)} blocks, expected one")
        name = self._unused(row[0], row[15])
        self._dims[name] = d
        self._changed(row[0])
        return Clone(row[0], row[2], name, blocks[0])

    def _remove(self, row: Row) -> Remove:
        blocks, _ = self._named(row)
        for name in blocks:
            del self._dims[name]
        if not self._dims:
            self._refuse(row[0], "removes the last block of the state")
        self._changed(row[0])
        return Remove(row[0], row[2], blocks)

    def _reset(self, row: Row) -> Reset:
        blocks, n = self._named(row)
        j = self._repeated(self._before(row), row, 6, "jacobian", n, n)
        return Reset(row[0], row[2], blocks, j)

    def _snapshot(self, row: Row) -> Snapshot:
        blocks, n = self._named(row)
        return Snapshot(
            row[0],
            row[2],
            blocks,
            self._shaped(row, 12, "covariance", n, n),
            None if row[13] is None else self._array(row, 13, "mean"),
            None if row[14] is None else self._shaped(row, 14, "error", n),
        )

    def _directions(self, row: Row) -> Directions:
        blocks, n = self._named(row)
        note = _json(row[15])
        names = blind = None
        if isinstance(note, dict):
            names, blind = _distinct(note.get("names")), _distinct(note.get("blind"))
        if not names or not blind:
            self._refuse(row[0], "note is not {names: [...], blind: [...]}, both not empty")
        basis = self._shaped(row, 6, "jacobian", n, len(names))
        return Directions(row[0], row[2], blocks, basis, names, blind)

    def _named(self, row: Row) -> tuple[Blocks, int]:
        """Blocks that an event is on, and how many entries they have together."""
        text = row[4]
        found = self._blocks.get(text)
        if found is None:
            names = texts(text)
            if not names:
                self._refuse(row[0], f"blocks {shown(text)}, expected a list of distinct names")
            for name in names:
                if name not in self._dims:
                    self._refuse(row[0], f"block {shown(name)} is not in the state at that time")
            if len(self._blocks) == _MOST_TEXTS:
                self._blocks.clear()
            found = self._blocks[text] = names, sum(self._dims[name] for name in names)
        return found

    def _new(self, row: Row) -> tuple[str, int]:
        """Name and dimension of a block that begins."""
        note = _json(row[15])
        name, dim = note if isinstance(note, list) and len(note) == 2 else (None, None)
        if type(dim) is not int or not 0 < dim <= MOST_ENTRIES:
            self._refuse(row[0], f"note {shown(row[15])}, expected a name and a dimension")
        return self._unused(row[0], name), dim

    def _unused(self, number: int, name: Any) -> str:
        if not isinstance(name, str):
            self._refuse(number, "the new block's name is not a text")
        if name in self._dims:
            self._refuse(number, f"new block {shown(name)} is in the state already")
        return name

    def _changed(self, number: int) -> None:
        """Take note of another set of blocks."""
        self._blocks.clear()
        self._size = sum(self._dims.values())
        if self._size > MOST_ENTRIES:
            self._refuse(number, f"makes the state larger than {MOST_ENTRIES} entries")

    def _before(self, row: Row) -> dict[str, Array]:
        """Matrices of the event before of the same kind and sensor, if it was on these blocks."""
        key = row[1], row[3]
        found = self._last.get(key)
        if found is None or found[0] != row[4]:
            found = self._last[key] = row[4], {}
        return found[1]

    def _repeated(
        self, before: dict[str, Array], row: Row, column: int, name: str, *shape: int
    ) -> Array:
        """A matrix, or that of the event before."""
        if row[column] is not None:
            found = before[name] = self._shaped(row, column, name, *shape)
            return found
        same = before.get(name)
        if same is None or same.shape != shape:
            self._refuse(
                row[0],
                f"{name} is missing, and the event before of this kind, sensor and blocks has "
                f"none that is {' x '.join(map(str, shape))}",
            )
        return same

    def _shaped(self, row: Row, column: int, name: str, *shape: int) -> Array:
        found = self._array(row, column, name)
        if len(found) != math.prod(shape):
            self._refuse(
                row[0], f"{name} has {len(found)} numbers, expected {' x '.join(map(str, shape))}"
            )
        return found.reshape(shape)

    def _array(self, row: Row, column: int, name: str) -> Array:
        """The numbers (n,) of a blob."""
        blob = row[column]
        if not isinstance(blob, bytes) or len(blob) % 8:
            self._refuse(row[0], f"{name} is not a blob of float64 numbers")
        found: Array = np.frombuffer(blob, "<f8")
        self._bytes += len(blob)
        if not math.isfinite(found.dot(found)):
            self._refuse(row[0], f"{name} has a number that is not finite, or too large")
        return found

    def _check_covariances(self) -> None:
        """Raise InputError for the first noise or prior that no sound filter has."""
        alike = defaultdict(list)
        for number, name, definite, matrix in self._unchecked:
            alike[name, definite, len(matrix)].append((number, matrix))
        faults = []
        for (name, definite, n), ones in alike.items():
            stack = np.concatenate([matrix for _, matrix in ones]).reshape(-1, n, n)
            found = _fault(stack, definite=definite)
            if found is not None:
                faults.append((ones[found[0]][0], f"{name} {found[1]}"))
        if faults:
            self._refuse(*min(faults))

    def _refuse(self, number: Any, fault: str) -> NoReturn:
        raise InputError(f"{self._path}, event {shown(number)}: {fault}")


def _fault(stack: Array, *, definite: bool) -> tuple[int, str] | None:
    """Index and fault of the first matrix of (k, n, n) that is no covariance.

    definite: positive definite, else also semidefinite to _NEGATIVE.
    """
    few = max(1, _IN_CACHE // stack[0].size)
    for start in range(0, len(stack), few):
        some = stack[start : start + few]
        skew = _skew(some)
        bad = np.flatnonzero(skew | ~_sound(some, definite=definite))
        if len(bad):
            fault = "is not positive definite" if definite else "has a negative eigenvalue"
            return start + int(bad[0]), "is not symmetric" if skew[bad[0]] else fault
    return None


def _skew(stack: Array) -> Mask:
    """Which matrices of (k, n, n) are not symmetric."""
    difference = np.abs(stack - stack.swapaxes(1, 2))
    if not difference.any():
        return np.zeros(len(stack), dtype=bool)
    sigma = np.sqrt(np.abs(np.diagonal(stack, axis1=1, axis2=2)))
    beyond: Array = difference - _ASYMMETRY * sigma[:, :, None] * sigma[:, None, :]
    found: Mask = beyond.max((1, 2)) > 0.0
    return found


def _sound(stack: Array, *, definite: bool) -> Mask:
    """Which symmetric matrices of (k, n, n) are positive definite, or semidefinite."""
    symmetric = 0.5 * (stack + stack.swapaxes(1, 2))
    if definite:
        return _factored(symmetric)
    variance = np.diagonal(stack, axis1=1, axis2=2)
    sound: Mask = variance.min(1) >= 0.0
    if not variance.all():
        # A variance of zero goes with covariances of zero; then a one may stand in its place.
        sound &= ~((variance == 0.0)[:, :, None] & (symmetric != 0.0)).any((1, 2))
    entries = np.arange(stack.shape[1])
    symmetric[:, entries, entries] += np.where(variance == 0.0, 1.0, _NEGATIVE * variance)
    sound &= _factored(symmetric)
    return sound


def _factored(stack: Array) -> Mask:
    """Which matrices of (k, n, n) have a Cholesky factor."""
    try:
        np.linalg.cholesky(stack)
    except np.linalg.LinAlgError:
        if len(stack) == 1:
            return np.array([False])
        return np.concatenate([_factored(one[None]) for one in stack])
    return np.ones(len(stack), dtype=bool)


def texts(text: Any) -> tuple[str, ...] | None:
    """A list of distinct texts out of JSON; None where it is none."""
    return _distinct(_json(text))


def _distinct(found: Any) -> tuple[str, ...] | None:
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        return None
    return tuple(found) if len(set(found)) == len(found) else None


def _counts(text: Any) -> tuple[int, ...] | None:
    """A list of positive whole numbers out of JSON; None where it is none."""
    found = _json(text)
    if not isinstance(found, list):
        return None
    sound = all(type(one) is int and 0 < one <= MOST_ENTRIES for one in found)
    return tuple(found) if sound else None


def _json(text: Any) -> Any:
    """What a text in JSON says; None where it is none, or beyond what names take."""
    if not isinstance(text, str) or len(text) > _LONGEST_TEXT:
        return None
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def shown(value: Any) -> str:
    """A value of a column, short and on one line."""
    short = value[:40] if isinstance(value, str | bytes) else value
    return printable(repr(short))[:60]
