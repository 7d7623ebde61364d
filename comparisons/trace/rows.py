"""Rows of a trace as events: every row is checked before it becomes one."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from comparisons.arrays import Array, Mask
from comparisons.errors import InputError, quoted
from comparisons.trace.batch import COLUMNS, KINDS, Batch
from comparisons.trace.events import (
    ADDITIVE,
    CHARTS,
    Augment,
    Blocks,
    Clone,
    Directions,
    Evaluation,
    Event,
    Predict,
    Remove,
    Reset,
    Snapshot,
    TracePrior,
    Update,
)

MOST_ENTRIES = 20_000
"""Of a state."""
_NO_NUMBERS = "is no numbers, or has one that is not finite or too large"
_MOST_NAMED = 4096
_IN_CACHE = 16384
"""Numbers of matrices that are checked at once."""
_ASYMMETRY, _NEGATIVE = 1e-6, 1e-9
"""Beyond rounding, of a covariance scaled to a unit diagonal: differences of entries that should be
equal, and eigenvalues below zero."""
_ROUNDING = 1e-12
"""Entries of a noise below it, beside the variances of the errors that it is added to."""
_SINGLE = 64.0 * 2.0**-24
"""The same, of a covariance whose numbers are all of single precision."""
_IS_SINGULAR = "is singular"


class Cell:
    """A matrix, in the shape of the event that had it last; None for what is no finite numbers.

    checked: whether it was looked at as a semidefinite covariance, and as a definite one.
    """

    __slots__ = ("checked", "matrix")

    def __init__(self, matrix: Array | None) -> None:
        """matrix: as it is stored."""
        self.matrix = matrix
        self.checked = 0


class StoredRow(NamedTuple):
    """An event as it is stored, before it is checked.

    blocks: names, None where they are no list of distinct texts. text: its own, as the sensor's
    name. cells: its matrices, as COLUMNS of its kind has them; None for those that are not there.
    """

    number: int
    kind: str
    time_s: float | None
    blocks: Blocks | None
    text: Any
    used: int
    cells: tuple[Cell | None, ...]


def batch_rows(batch: Batch, first: int) -> Iterable[StoredRow]:
    """Yield the rows of a batch. first: number of its first event."""
    cells: list[Cell | None] = [Cell(array) for array in batch.arrays]
    cells.append(None)  # for -1
    names = [*map(distinct, batch.texts), None]
    said = [*batch.texts, None]
    columns = [(kind, len(COLUMNS[kind])) for kind in KINDS]
    for number, (time_s, at, used, blocks, text, matrices) in enumerate(
        zip(*batch[:6], strict=True), first
    ):
        kind, count = columns[at]
        time = None if time_s != time_s else time_s
        own = tuple([cells[matrix] for matrix in matrices[:count]])
        yield StoredRow(number, kind, time, names[blocks], said[text], used, own)


class EventReader:
    """Makes events of rows, and follows which blocks there are.

    at: number of the last event, -1 before the first. unsound: by the number of an event what is
    wrong with its noise, or the prior's P, where that is no covariance. singular: likewise, of an R
    that is a covariance without an inverse, as of a perfect measurement.
    """

    def __init__(self, path: Path) -> None:
        """path: named in errors."""
        self.at = -1
        self.unsound: dict[int, str] = {}
        self.singular: dict[int, str] = {}
        self._path = path
        self._last: Event | None = None
        self._dims: dict[str, int] = {}
        self._charts: dict[str, str] = {}
        self._size = 0
        self._named: dict[Blocks, int] = {}
        self._sigma: dict[str, Array] = {}
        self._unchecked: list[tuple[int, str, bool, Array, Blocks]] = []
        self._faults: dict[tuple[int, bool], tuple[Array, str]] = {}
        self._make: dict[str, Callable[[StoredRow], Event]] = {
            kind: getattr(self, f"_{kind}") for kind in KINDS
        }

    @property
    def state(self) -> list[list[Any]]:
        """Name, dimension and chart of every block after the last event."""
        return [[name, dim, self._charts[name]] for name, dim in self._dims.items()]

    def events(self, rows: Iterable[StoredRow]) -> list[Event]:
        """Return the next events.

        Raises:
            InputError: A row cannot be an event; of several the first, with its number.

        A noise that is no covariance is in `unsound`, one of a measurement that is singular in
        `singular`, for every event that has it.
        """
        found: list[Event] = []
        with np.errstate(all="ignore"):  # a number that is too large is refused by itself
            found.extend(map(self._event, rows))
            self._check_covariances()
        for event in found if self._faults else ():
            own = (
                event.covariance if isinstance(event, TracePrior) else getattr(event, "noise", None)
            )
            fault = self._faults.get((id(own), isinstance(event, Update)))
            if fault is not None:
                kind = self.singular if fault[1].endswith(_IS_SINGULAR) else self.unsound
                kind[event.number] = fault[1]
        return found

    def _event(self, row: StoredRow) -> Event:
        number, kind, time_s = row[:3]
        if time_s is not None and not math.isfinite(time_s):
            self._refuse(number, f"time_s {quoted(time_s)}, expected a number of seconds")
        if not self._dims and kind != "prior":
            self._refuse(number, f"is a {kind}, expected the prior first")
        event = self._last = self._make[kind](row)
        self.at = number
        return event

    def _prior(self, row: StoredRow) -> TracePrior:
        if self._dims:
            self._refuse(row.number, "is a second prior; a filter that begins anew has a new trace")
        names, (dims, charts) = row.blocks or (), _pair(row.text)
        sound = names and _counts(dims) and _all_charts(charts)
        if not sound or not len(names) == len(dims) == len(charts):
            self._refuse(row.number, "blocks and text are not names, and dimensions and charts")
        self._dims = dict(zip(names, dims, strict=True))
        self._charts = dict(zip(names, charts, strict=True))
        self._changed(row.number)
        p = self._covariance(row, 0, "covariance (P)", self._size)
        self._begins(names, dims, np.diagonal(p))
        plain = () if set(charts) == {ADDITIVE} else tuple(charts)
        return TracePrior(row.number, row.time_s, names, tuple(dims), p, self._own(row, 1), plain)

    def _predict(self, row: StoredRow) -> Predict:
        n = self._on(row)
        f = self._shaped(row, 0, n, n)
        q = self._covariance(row, 1, "noise (Q)", n)
        points = self._own(row, 2), self._own(row, 3)
        return Predict(row.number, row.time_s, row.blocks or (), f, q, *points)

    def _update(self, row: StoredRow) -> Update:
        n = self._on(row)
        if not isinstance(row.text, str):
            self._refuse(row.number, f"sensor {quoted(row.text)}, expected a name")
        if row.used not in (0, 1):
            self._refuse(row.number, f"used is {quoted(row.used)}, expected 0 or 1")
        residual = self._flat(row, 0)
        m = len(residual)
        if not m:
            self._refuse(row.number, "residual is empty")
        h = self._shaped(row, 1, m, n)
        r = self._covariance(row, 2, "noise (R)", m, definite=True)
        correction = gain = None
        if row.cells[3] is not None:
            correction = self._shaped(row, 3, self._size)
        if row.cells[4] is not None:
            gain = self._shaped(row, 4, self._size, m)
        return Update(
            *(row.number, row.time_s, row.text, row.blocks or (), residual, h, r, bool(row.used)),
            *(correction, gain, self._own(row, 5), self._own(row, 6), self._weight(row, 7)),
        )

    def _augment(self, row: StoredRow) -> Augment:
        n = self._on(row)
        name, d, chart = self._new(row)
        cell = row.cells[1]
        known = cell is not None and cell.matrix is not None
        m = math.isqrt(len(self._flat(row, 1))) if known else len(self._flat(row, 2)) // d
        g_x, g_z = self._shaped(row, 0, d, n), self._shaped(row, 2, d, m)
        r = self._covariance(row, 1, "noise (R)", m)
        self._dims[name], self._charts[name] = d, chart
        self._begins((name,), (d,), np.einsum("ij,jk,ik->i", g_z, r, g_z))
        self._changed(row.number)
        points = self._own(row, 3), self._own(row, 4), self._own(row, 5)
        weight = self._weight(row, 6)
        return Augment(
            *(row.number, row.time_s, name, row.blocks or (), g_x, g_z, r, *points, weight, chart)
        )

    def _clone(self, row: StoredRow) -> Clone:
        d, blocks = self._on(row), row.blocks or ()
        if len(blocks) != 1:
            self._refuse(row.number, f"clones {len(blocks)} blocks, expected one")
        name = self._unused(row.number, row.text)
        self._dims[name], self._charts[name] = d, self._charts[blocks[0]]
        self._sigma[name] = self._sigma[blocks[0]]
        self._changed(row.number)
        return Clone(row.number, row.time_s, name, blocks[0])

    def _remove(self, row: StoredRow) -> Remove:
        self._on(row)
        blocks = row.blocks or ()
        for name in blocks:
            del self._dims[name], self._charts[name]
        if not self._dims:
            self._refuse(row.number, "removes the last block of the state")
        self._changed(row.number)
        return Remove(row.number, row.time_s, blocks)

    def _reset(self, row: StoredRow) -> Reset:
        n = self._on(row)
        return Reset(row.number, row.time_s, row.blocks or (), self._shaped(row, 0, n, n))

    def _snapshot(self, row: StoredRow) -> Snapshot:
        n = self._on(row)
        p, error = self._shaped(row, 0, n, n), None
        if row.cells[2] is not None:
            error = self._shaped(row, 2, n)
        return Snapshot(row.number, row.time_s, row.blocks or (), p, self._own(row, 1), error)

    def _directions(self, row: StoredRow) -> Directions:
        n = self._on(row)
        names = blind = None
        if isinstance(row.text, dict):
            names, blind = distinct(row.text.get("names")), distinct(row.text.get("blind"))
        if not names or not blind:
            self._refuse(row.number, "text is not {names: [...], blind: [...]}, both not empty")
        basis = self._shaped(row, 0, n, len(names))
        return Directions(row.number, row.time_s, row.blocks or (), basis, names, blind)

    def _evaluation(self, row: StoredRow) -> Evaluation:
        last, n = self._last, self._on(row)
        if not isinstance(last, Predict | Update | Augment) or row.blocks != last.blocks:
            expected = "expected a prediction, an update or a new block of the same blocks before"
            self._refuse(row.number, f"is an evaluation, {expected} it")
        m = len(last.jacobian)
        jacobian, uncertainty = self._shaped(row, 0, m, n), self._shaped(row, 2, m, n)
        value, measured = self._flat(row, 1), self._own(row, 3)
        if isinstance(last, Update) and len(value) != m:
            self._refuse(row.number, f"value has {len(value)} numbers, expected {m}")
        if measured is not None and len(measured) != len(value):
            fault = f"measured has {len(measured)} numbers, expected {len(value)}"
            self._refuse(row.number, fault)
        return Evaluation(
            row.number, row.time_s, last.blocks, jacobian, value, uncertainty, measured
        )

    def _on(self, row: StoredRow) -> int:
        """How many entries the blocks of an event have together."""
        blocks = row.blocks
        if not blocks:
            self._refuse(row.number, "blocks are no list of distinct names")
        found = self._named.get(blocks)
        if found is None:
            for name in blocks:
                if name not in self._dims:
                    fault = f"block {quoted(name)} is not in the state at that time"
                    self._refuse(row.number, fault)
            if len(self._named) == _MOST_NAMED:
                self._named.clear()
            found = self._named[blocks] = sum(self._dims[name] for name in blocks)
        return found

    def _new(self, row: StoredRow) -> tuple[str, int, str]:
        """Name, dimension and chart of a block that begins."""
        if not is_block(row.text):
            fault = f"text {quoted(row.text)}, expected a name, a dimension and a chart"
            self._refuse(row.number, fault)
        name, dim, chart = row.text
        return self._unused(row.number, name), dim, chart

    def _unused(self, number: int, name: Any) -> str:
        if not isinstance(name, str):
            self._refuse(number, "the new block's name is not a text")
        if name in self._dims:
            self._refuse(number, f"new block {quoted(name)} is in the state already")
        return name

    def _changed(self, number: int) -> None:
        """Take note of another set of blocks."""
        self._named.clear()
        self._size = sum(self._dims.values())
        if self._size > MOST_ENTRIES:
            self._refuse(number, f"makes the state larger than {MOST_ENTRIES} entries")

    def _weight(self, row: StoredRow, column: int) -> float:
        """A share of a measurement's information; all of it where none is stored."""
        if row.cells[column] is None:
            return 1.0
        (weight,) = self._shaped(row, column, 1).tolist()
        if not 0.0 <= weight <= 1.0:
            self._refuse(row.number, f"weight is {weight:g}, expected 0 to 1")
        return float(weight)

    def _own(self, row: StoredRow, column: int) -> Array | None:
        """Numbers of any count (k,), if they are stored."""
        return None if row.cells[column] is None else self._flat(row, column)

    def _covariance(
        self, row: StoredRow, column: int, name: str, n: int, *, definite: bool = False
    ) -> Array:
        """A covariance (n, n), which is checked with others; NaN where it is no finite numbers."""
        cell, flag = row.cells[column], 1 + definite
        if cell is not None and cell.matrix is None:
            unknown = np.full((n, n), np.nan)
            self._faults[id(unknown), definite] = unknown, f"{name} {_NO_NUMBERS}"
            return unknown
        found = self._shaped(row, column, n, n)
        if cell is not None and not cell.checked & flag and found.size:
            cell.checked |= flag
            self._unchecked.append((row.number, name, definite, found, row.blocks or ()))
        return found

    def _shaped(self, row: StoredRow, column: int, *shape: int) -> Array:
        """A matrix, the same one each time that it is stored once."""
        cell = row.cells[column]
        if cell is None or cell.matrix is None:
            self._refuse_cell(row, column)
        if cell.matrix.shape != shape:
            if cell.matrix.size != math.prod(shape):
                name, expected = COLUMNS[row.kind][column], " x ".join(map(str, shape))
                fault = f"{name} has {cell.matrix.size} numbers, expected {expected}"
                self._refuse(row.number, fault)
            cell.matrix = cell.matrix.reshape(shape)
        return cell.matrix

    def _flat(self, row: StoredRow, column: int) -> Array:
        """The numbers (n,) of a matrix."""
        cell = row.cells[column]
        if cell is None or cell.matrix is None:
            self._refuse_cell(row, column)
        return cell.matrix.reshape(-1)

    def _refuse_cell(self, row: StoredRow, column: int) -> NoReturn:
        """Refuse an event without the numbers of a matrix."""
        fault = _NO_NUMBERS
        if row.cells[column] is None:
            fault = "is missing"
        self._refuse(row.number, f"{COLUMNS[row.kind][column]} {fault}")

    def _check_covariances(self) -> None:
        """Keep every noise or prior that no sound filter has, and what is wrong with it."""
        alike = defaultdict(list)
        for number, name, definite, matrix, blocks in self._unchecked:
            alike[name, definite, len(matrix)].append((number, matrix, blocks))
        self._unchecked = []
        for (name, definite, n), ones in alike.items():
            stack = np.concatenate([matrix for _, matrix, _ in ones]).reshape(-1, n, n)
            sigmas = partial(self._sigmas, [one[2] for one in ones])
            for index, fault in _faults(stack, sigmas, definite=definite):
                matrix = ones[index][1]
                self._faults[id(matrix), definite] = matrix, f"{name} {fault}"

    def _begins(self, names: Sequence[str], dims: Sequence[int], variance: Array) -> None:
        """Keep about how large the errors of new blocks are: (n,) variances."""
        sigma, start = np.sqrt(np.nan_to_num(np.maximum(variance, 0.0))), 0
        for name, dim in zip(names, dims, strict=True):
            self._sigma[name] = sigma[start : start + dim]
            start += dim

    def _sigmas(self, blocks: Sequence[Blocks], index: int) -> Array:
        """As they began, of one event's blocks (n,)."""
        return np.concatenate([np.zeros(0), *(self._sigma[name] for name in blocks[index])])

    def _refuse(self, number: int, fault: str) -> NoReturn:
        raise InputError(f"{self._path}, event {number}: {fault}")


def _faults(
    stack: Array, sigmas: Callable[[int], Array] = lambda index: np.zeros(0), *, definite: bool
) -> Iterator[tuple[int, str]]:
    """Yield index and fault of the matrices of (k, n, n) that are no covariances.

    sigmas: (n,) of the errors that each is added to, by its index; none where it is to none.
    definite: positive definite, where semidefinite ones are singular; else also semidefinite to
    _NEGATIVE.
    """
    few = max(1, _IN_CACHE // stack[0].size)
    for start in range(0, len(stack), few):
        some = stack[start : start + few]
        skew = _skew(some)
        for bad in np.flatnonzero(skew | ~_sound(some, definite=definite)).tolist():
            one = some[bad : bad + 1]
            if definite or not _sound_beside(one, sigmas(start + bad)):
                if _single_sound(one, definite=definite):
                    continue
                fault = "has a negative eigenvalue"
                if definite and not skew[bad] and _sound(one, definite=False)[0]:
                    fault = _IS_SINGULAR
                yield start + bad, "is not symmetric" if skew[bad] else fault


def _sound_beside(one: Array, sigma: Array) -> bool:
    """Whether a matrix (1, n, n) is semidefinite but for what is rounding beside sigmas (n,)."""
    if len(sigma) != one.shape[1]:
        return False
    rounding = _ROUNDING * np.outer(sigma, sigma)
    clean = np.where(np.abs(one) <= rounding, 0.0, one)
    return not _skew(clean)[0] and bool(_sound(clean, definite=False)[0])


def _single_sound(one: Array, *, definite: bool) -> bool:
    """Whether a matrix (1, n, n) of single precision is a covariance to that precision."""
    if (one != one.astype(np.float32)).any():
        return False
    return not _skew(one, _SINGLE)[0] and bool(_sound(one, definite=definite, least=_SINGLE)[0])


def _skew(stack: Array, most: float = _ASYMMETRY) -> Mask:
    """Which matrices of (k, n, n) are not symmetric."""
    difference = np.abs(stack - stack.swapaxes(1, 2))
    if not difference.any():
        return np.zeros(len(stack), dtype=bool)
    sigma = np.sqrt(np.abs(np.diagonal(stack, axis1=1, axis2=2)))
    beyond: Array = difference - most * sigma[:, :, None] * sigma[:, None, :]
    found: Mask = beyond.max((1, 2)) > 0.0
    return found


def _sound(stack: Array, *, definite: bool, least: float = _NEGATIVE) -> Mask:
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
    symmetric[:, entries, entries] += np.where(variance == 0.0, 1.0, least * variance)
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


def distinct(found: Any) -> Blocks | None:
    """A list of distinct texts; None where it is none."""
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        return None
    return tuple(found) if len(set(found)) == len(found) else None


def is_block(found: Any) -> bool:
    """Whether it is a list of what may be a name, and of a dimension and a chart."""
    return (
        isinstance(found, list)
        and len(found) == 3
        and _counts(found[1:2])
        and _all_charts(found[2:])
    )


def _pair(text: Any) -> tuple[Any, Any]:
    return (text[0], text[1]) if isinstance(text, list) and len(text) == 2 else (None, None)


def _counts(found: Any) -> bool:
    """Whether it is a list of positive whole numbers."""
    return isinstance(found, list) and all(
        type(one) is int and 0 < one <= MOST_ENTRIES for one in found
    )


def _all_charts(found: Any) -> bool:
    return isinstance(found, list) and all(isinstance(one, str) and one in CHARTS for one in found)
