"""Records what a Kalman filter does: a few lines around an existing filter."""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.trace.reader import APPLICATION, TABLES, VERSION
from comparisons.trace.rows import MOST_ENTRIES

_COLUMNS = {
    "prior": ("covariance", "note"),
    "predict": ("jacobian", "noise"),
    "update": ("sensor", "used", "residual", "jacobian", "noise", "correction", "gain"),
    "augment": ("jacobian", "noise", "noise_jacobian", "note"),
    "clone": ("note",),
    "remove": (),
    "reset": ("jacobian",),
    "snapshot": ("covariance", "mean", "error"),
    "directions": ("jacobian", "note"),
}
"""What an event of each kind has, beside its number, time and blocks; others are NULL."""


def _insert(kind: str, columns: tuple[str, ...]) -> str:
    names = ", ".join(("number", "time_s", "blocks", "kind", *columns))
    return f"INSERT INTO event ({names}) VALUES (?, ?, ?, '{kind}'{', ?' * len(columns)})"  # noqa: S608


_INSERT = {
    kind: [_insert(kind, columns[:count]) for count in range(len(columns) + 1)]
    for kind, columns in _COLUMNS.items()
}
"""Statements by kind and how many of its columns are given."""
PAGE_BYTES = 32768
COMMIT_EVENTS, COMMIT_BYTES = 2000, 1 << 24
"""A recording that is killed is valid up to its last commit."""
_LARGE = 4096
"""Bytes of a matrix; smaller ones are not counted."""
_DTYPE = np.dtype("<f8")
_STATEMENT, _VALUES = itemgetter(0), itemgetter(1)

Column = bytes | bytearray | str | int | None


class Recorder:
    """Writes a trace for `slamcheck audit`.

    The error state is truth minus estimate, in the coordinates of the filter's covariance, and
    consists of named blocks. Call a method where the filter does what its name says, with the
    matrices that the filter uses. Blocks may be left out where they are all blocks, in their order.

        with Recorder("run.trace") as record:
            record.prior({"position": 2, "velocity": 2}, P)
            record.predict(F, Q)
            record.update("gps", residual, H, R, ["position"])
            record.snapshot(P)

    Matrices are checked for their shape alone; what they say is the audit's business. A call that
    raises InputError records nothing, and the recording goes on; where the file cannot be written
    it ends, and what was committed before stays. Calls from several threads must not overlap.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        gates: Mapping[str, float] | None = None,
        components: Mapping[str, Sequence[str]] | None = None,
        append: bool = False,
    ) -> None:
        """Start a file.

        Args:
            path: Of the trace. An existing file is only ever appended to.
            gates: By sensor, the probability with which the gate lets a sound measurement pass.
            components: By sensor, names of the residual's entries.
            append: Go on with an existing trace.

        Raises:
            InputError: The file exists already, or cannot be written; or append is set, and there
                is none that is a trace; or a gate is no probability.
        """
        self._path = Path(path)
        self._dims: dict[str, int] = {}
        self._first = 0
        self._time_s: float | None = None
        self._rows: list[tuple[str, tuple[Any, ...]]] = []
        self._bytes = 0
        self._sizes: dict[tuple[str, ...] | None, tuple[str, int]] = {}
        self._last: dict[str | tuple[str, str], tuple[str, list[bytes]]] = {}
        self._ended: str | None = None
        self._process = os.getpid()
        sensors = self._sensors(gates or {}, components or {})
        if append:
            self._follow()
        else:
            self._create()
        try:
            self._open(sensors, new=not append)
        except sqlite3.Error as error:
            self._file.close()
            if not append:
                self._path.unlink()
            raise InputError(f"{path}: cannot be written ({error})") from None

    def __enter__(self) -> Self:
        """Return the recorder itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Commit and close, whatever happened."""
        self.close()

    def close(self) -> None:
        """Commit what is recorded and close the file."""
        if self._ended is None and self._process == os.getpid():
            self.commit()
            self._end("is closed")

    def commit(self) -> None:
        """Write what is recorded so far; it is done by itself every 2,000 events or 16 MiB.

        Raises:
            InputError: The file cannot be written, or is closed, or was opened by another process.
        """
        self._check_open()
        if self._process != os.getpid():
            raise InputError(
                f"{self._path}: was opened by another process; after a fork only the parent records"
            )
        rows, first = self._rows, self._first
        try:
            self._file.execute("BEGIN IMMEDIATE")
            for statement, alike in groupby(rows, _STATEMENT):
                self._file.executemany(statement, map(_VALUES, alike))
            self._rows, self._first, self._bytes = [], first + len(rows), 0
            self._file.execute("COMMIT")
        except sqlite3.Error as error:
            self._end(f"cannot be written ({error}); the recording ends before event {first}")
            self._check_open()
        except BaseException:  # an interrupt: the events stay for the next commit
            if self._file.in_transaction:
                self._file.execute("ROLLBACK")
                self._rows, self._first = rows, first
            raise

    def at(self, time_s: float) -> None:
        """Set the time of the events that follow.

        Args:
            time_s: In the filter's own clock.
        """
        time_s = float(time_s)
        if not math.isfinite(time_s):
            self._refuse("time_s is not finite")
        self._time_s = time_s

    def prior(self, blocks: Mapping[str, int], covariance: ArrayLike) -> None:
        """Record the first covariance.

        Args:
            blocks: Names and dimensions of all blocks, in the state's order.
            covariance: (n, n).
        """
        self._check_open()
        if self._dims:
            self._refuse("is a second prior; a filter that begins anew has a new trace")
        dims = {_name(name): self._dim(dim) for name, dim in blocks.items()}
        n = sum(dims.values())
        if not 0 < n <= MOST_ENTRIES:
            self._refuse(f"the state has {n} entries, expected 1 to {MOST_ENTRIES}")
        p = self._blob("P", covariance, (n, n))
        note = json.dumps(list(dims.values()))
        self._put("prior", json.dumps(list(dims)), [p, note])
        self._dims = dims
        self._sizes.clear()

    def predict(
        self,
        F: ArrayLike,  # noqa: N803
        Q: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
    ) -> None:
        """Record a prediction: e' = F e + w, w ~ N(0, Q).

        Args:
            F: (n, n) on the blocks.
            Q: (n, n).
            blocks: Those that the prediction moves.
        """
        text, n = self._size(blocks)
        shape = n, n
        f, q = self._blob("F", F, shape), self._blob("Q", Q, shape)
        self._put("predict", text, self._new("predict", text, [f, q]))

    def update(
        self,
        sensor: str,
        residual: ArrayLike,
        H: ArrayLike,  # noqa: N803
        R: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
        *,
        correction: ArrayLike | None = None,
        gain: ArrayLike | None = None,
    ) -> None:
        """Record a measurement that the filter used: residual = H e + v, v ~ N(0, R).

        Args:
            sensor: Its name.
            residual: (m,) measured minus predicted.
            H: (m, n) on the blocks.
            R: (m, m).
            blocks: Those that H stands on.
            correction: (N,) what was added to the estimate of all blocks, if it is to be checked.
            gain: (N, m) likewise.
        """
        if correction is None and gain is None:
            self._measured(1, sensor, residual, H, R, blocks, (None, None))
            return
        whole, m = self._size(None)[1], np.size(residual)
        added = None if correction is None else self._vector("correction", correction, whole)
        by = None if gain is None else self._blob("gain", gain, (whole, m))
        self._measured(1, sensor, residual, H, R, blocks, (added, by))

    def reject(
        self,
        sensor: str,
        residual: ArrayLike,
        H: ArrayLike,  # noqa: N803
        R: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
    ) -> None:
        """Record a measurement that the filter's gate rejected; arguments as of `update`.

        Args:
            sensor: Its name.
            residual: (m,) measured minus predicted.
            H: (m, n) on the blocks.
            R: (m, m).
            blocks: Those that H stands on.
        """
        self._measured(0, sensor, residual, H, R, blocks, (None, None))

    def _measured(
        self,
        used: int,
        sensor: str,
        residual: ArrayLike,
        h: ArrayLike,
        r: ArrayLike,
        blocks: Iterable[str] | None,
        gained: tuple[bytes | None, bytes | None],
    ) -> None:
        text, n = self._size(blocks)
        m = np.size(residual)
        if not m:
            self._refuse("residual is empty")
        z = self._vector("residual", residual, m)
        by_state, noise = self._blob("H", h, (m, n)), self._blob("R", r, (m, m))
        new = self._new(("update", _name(sensor)), text, [by_state, noise])
        self._put("update", text, [sensor, used, z, *new, *gained])

    def augment(
        self,
        name: str,
        G_x: ArrayLike,  # noqa: N803
        G_z: ArrayLike,  # noqa: N803
        R: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
    ) -> None:
        """Record a new block, behind all others: e_new = G_x e + G_z v, v ~ N(0, R).

        Args:
            name: Of the block.
            G_x: (d, n) on the blocks.
            G_z: (d, m); m may be 0 where nothing is added to what the other blocks tell.
            R: (m, m).
            blocks: Those that it is initialised from.
        """
        text, n = self._size(blocks)
        by_noise = self._numbers("G_z", G_z)
        if by_noise.ndim == 0:
            by_noise = by_noise.reshape(1, 1)
        if by_noise.ndim != 2 or not len(by_noise):
            self._refuse("G_z is not a matrix")
        d, m = by_noise.shape
        self._check_new(name, d)
        g_x, r = self._blob("G_x", G_x, (d, n)), self._blob("R", R, (m, m))
        new = self._new("augment", text, [g_x, r, by_noise.tobytes()])
        self._put("augment", text, [*new, json.dumps([name, d])])
        self._add(name, d)

    def clone(self, source: str, name: str) -> None:
        """Record a copy of a block, behind all others.

        Args:
            source: The block that is copied.
            name: Of the copy.
        """
        text, d = self._size((source,))
        self._check_new(name, d)
        self._put("clone", text, [name])
        self._add(name, d)

    def remove(self, *names: str) -> None:
        """Record blocks that are marginalised out.

        Args:
            names: Of the blocks.
        """
        text, _ = self._size(names)
        if len(names) == len(self._dims):
            self._refuse("removes the last block of the state")
        self._put("remove", text, [])
        for name in names:
            del self._dims[name]
        self._sizes.clear()
        self._last.clear()  # a block of this name may begin with another dimension

    def reset(
        self,
        J: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
    ) -> None:
        """Record that the error is expressed anew, as after an error-state correction: e' = J e.

        Args:
            J: (n, n) on the blocks.
            blocks: Those that it is on.
        """
        text, n = self._size(blocks)
        j = self._blob("J", J, (n, n))
        self._put("reset", text, self._new("reset", text, [j]))

    def snapshot(
        self,
        P: ArrayLike,  # noqa: N803
        blocks: Iterable[str] | None = None,
        *,
        mean: ArrayLike | None = None,
        error: ArrayLike | None = None,
    ) -> None:
        """Record the filter's covariance after the last event.

        Args:
            P: (n, n) joint covariance of the blocks.
            blocks: Those it is of.
            mean: The estimate, in the filter's own numbers.
            error: (n,) truth minus estimate, where the truth is known.
        """
        text, n = self._size(blocks)
        p = self._blob("P", P, (n, n))
        estimate = None if mean is None else self._numbers("mean", mean).tobytes()
        true = None if error is None else self._vector("error", error, n)
        self._put("snapshot", text, [p, estimate, true])

    def directions(
        self,
        basis: Mapping[str, ArrayLike],
        blind: Iterable[str],
        *,
        blocks: Iterable[str] | None = None,
    ) -> None:
        """Record directions that some sensors cannot tell, as a turn of the whole map.

        Once, at the beginning, where the filter is then: what these sensors seem to tell of them
        afterwards is spurious.

        Args:
            basis: (n,) by the direction's name, on the blocks.
            blind: Names of the sensors.
            blocks: Those that the basis is on.
        """
        text, n = self._size(blocks)
        names = [_name(one) for one in basis], [_name(one) for one in blind]
        if not all(names) or len(set(names[1])) < len(names[1]):
            self._refuse("directions or sensors are missing, or one is given twice")
        columns = [
            np.frombuffer(self._vector(f"basis of {name!r}", one, n), _DTYPE)
            for name, one in basis.items()
        ]
        note = json.dumps({"names": names[0], "blind": names[1]})
        blob = np.column_stack(columns).tobytes()
        self._put("directions", text, [blob, note])

    def _put(self, kind: str, blocks: str, columns: list[Column]) -> None:
        """Record an event; columns: those of its kind, a fresh list."""
        while columns and columns[-1] is None:
            columns.pop()  # a NULL takes as long to bind as a number
        rows = self._rows
        values = self._first + len(rows), self._time_s, blocks, *columns
        rows.append((_INSERT[kind][len(columns)], values))
        if len(rows) >= COMMIT_EVENTS or self._bytes >= COMMIT_BYTES:
            self.commit()

    def _new(self, key: str | tuple[str, str], blocks: str, matrices: list[bytes]) -> list[Column]:
        """Return matrices, None for those of the event before of this key on the same blocks.

        key: the event's kind, with the sensor if it has one.
        """
        before = self._last.get(key)
        self._last[key] = blocks, matrices
        if before is None or before[0] != blocks:
            return [*matrices]
        # For bytes sqlite3 would look for adapters.
        return [
            None if one == other else bytearray(one)
            for one, other in zip(matrices, before[1], strict=True)
        ]

    def _size(self, blocks: Iterable[str] | None) -> tuple[str, int]:
        """Blocks as they are stored, and how many entries they have together."""
        key = None if blocks is None else tuple(blocks)
        return self._sizes.get(key) or self._find(key)

    def _find(self, key: tuple[str, ...] | None) -> tuple[str, int]:
        self._check_open()
        names = tuple(self._dims) if key is None else key
        for name in names:
            if name not in self._dims:
                known = ", ".join(self._dims) or "none: record the prior first"
                self._refuse(f"block {name!r} is not in the state; it has {known}")
        if not names or len(set(names)) < len(names):
            self._refuse("expected blocks, none of them twice; record the prior first")
        found = self._sizes[key] = json.dumps(names), sum(self._dims[name] for name in names)
        return found

    def _check_new(self, name: str, dim: int) -> None:
        if _name(name) in self._dims:
            self._refuse(f"block {name!r} is in the state already; remove it first")
        if dim + sum(self._dims.values()) > MOST_ENTRIES:
            self._refuse(f"makes the state larger than {MOST_ENTRIES} entries")

    def _add(self, name: str, dim: int) -> None:
        self._dims[name] = dim
        self._sizes.clear()

    def _dim(self, dim: Any) -> int:
        if int(dim) != dim or not 0 < dim <= MOST_ENTRIES:
            self._refuse(f"dimension {dim!r}, expected 1 to {MOST_ENTRIES}")
        return int(dim)

    def _blob(self, name: str, matrix: ArrayLike, shape: tuple[int, int]) -> bytes:
        """Return a matrix as it is stored; a number stands for 1 x 1. Raises InputError."""
        if type(matrix) is np.ndarray and matrix.dtype is _DTYPE and matrix.shape == shape:
            blob = matrix.tobytes()
        else:
            blob = self._fitting(name, matrix, shape).tobytes()
        if len(blob) > _LARGE:
            self._bytes += len(blob)
        return blob

    def _fitting(self, name: str, matrix: ArrayLike, shape: tuple[int, int]) -> Array:
        found = self._numbers(name, matrix)
        if found.shape != shape and not (found.size == 1 and shape == (1, 1)):
            actual = " x ".join(map(str, found.shape)) or "a number"
            self._refuse(f"{name} is {actual}, expected {shape[0]} x {shape[1]}")
        return found

    def _vector(self, name: str, vector: ArrayLike, size: int) -> bytes:
        """Return a vector as it is stored; it may be a column or a row."""
        found = self._numbers(name, vector)
        if found.size != size or (found.ndim > 1 and max(found.shape) != size):
            actual = " x ".join(map(str, found.shape)) or "a number"
            self._refuse(f"{name} is {actual}, expected {size} numbers")
        return found.tobytes()

    def _numbers(self, name: str, values: ArrayLike) -> Array:
        try:
            found = np.asarray(values)
        except ValueError:
            self._refuse(f"{name} is not an array of numbers")
        if found.dtype != _DTYPE:
            if found.dtype.kind not in "fiub":
                self._refuse(f"{name} is not an array of numbers")
            found = found.astype(_DTYPE)
        return found

    def _refuse(self, fault: str) -> NoReturn:
        raise InputError(f"{self._path}, event {self._first + len(self._rows)}: {fault}")

    def _check_open(self) -> None:
        if self._ended is not None:
            raise InputError(f"{self._path}: {self._ended}")

    def _end(self, reason: str) -> None:
        """Record nothing from now on; what is not committed is undone."""
        self._ended = reason
        self._rows.clear()
        self._sizes.clear()
        self._file.close()

    def _sensors(
        self, gates: Mapping[str, float], components: Mapping[str, Sequence[str]]
    ) -> list[tuple[str, float | None, str | None]]:
        """Return rows of the table of sensors."""
        rows = []
        for name in {**gates, **components}:
            gate, parts = gates.get(name), components.get(name)
            if gate is not None and not 0.0 < gate < 1.0:
                raise InputError(f"{self._path}: gate of {name!r} is {gate}, expected 0 < p < 1")
            if parts is not None and (isinstance(parts, str) or len(set(parts)) < len(parts)):
                raise InputError(f"{self._path}: components of {name!r} are not distinct names")
            text = None if parts is None else json.dumps([_name(part) for part in parts])
            rows.append((_name(name), None if gate is None else float(gate), text))
        return rows

    def _create(self) -> None:
        try:
            with self._path.open("xb"):
                pass
        except FileExistsError:
            raise InputError(
                f"{self._path}: exists already; give a new name, or append=True"
            ) from None
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written ({error.strerror})") from None

    def _open(self, sensors: Iterable[tuple[str, float | None, str | None]], *, new: bool) -> None:
        """Open the file and describe the sensors. Raises sqlite3.Error."""
        self._file = sqlite3.connect(
            self._path.absolute(), isolation_level=None, check_same_thread=False
        )
        # A killed process loses nothing that it has written; that a computer fails is accepted.
        self._file.execute("PRAGMA synchronous = OFF")
        if new:
            self._file.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            self._file.execute(f"PRAGMA application_id = {APPLICATION}")
            self._file.execute(f"PRAGMA user_version = {VERSION}")
        self._file.execute("BEGIN IMMEDIATE")
        for table in TABLES.values() if new else ():
            self._file.execute(table)
        self._file.executemany("INSERT OR REPLACE INTO sensor VALUES (?, ?, ?)", sensors)
        self._file.execute("COMMIT")

    def _follow(self) -> None:
        """Read the trace that is appended to, for its last number and its blocks."""
        from comparisons.trace.events import Augment, Clone, Prior, Remove
        from comparisons.trace.reader import Trace

        trace = Trace(self._path)
        for event in trace if trace.counts.events else ():
            self._first = event.number + 1
            if isinstance(event, Prior):
                self._dims = dict(zip(event.blocks, event.dims, strict=True))
            elif isinstance(event, Augment):
                self._dims[event.name] = len(event.jacobian)
            elif isinstance(event, Clone):
                self._dims[event.name] = self._dims[event.source]
            elif isinstance(event, Remove):
                for name in event.blocks:
                    del self._dims[name]


def _name(name: str) -> str:
    """A name that can be stored. Raises InputError."""
    try:
        name.encode()
    except (AttributeError, UnicodeEncodeError):
        raise InputError(f"name {name!r:.60}: expected a text of whole characters") from None
    return name
