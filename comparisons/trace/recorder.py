"""Records what a Kalman filter does: a few lines around an existing filter."""

# ruff: noqa: N803 - matrices are called as the field calls them

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Self, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.errors import InputError, quoted, shorten
from comparisons.trace.batch import COLUMNS, KINDS, MOST_COLUMNS, ROW, pack
from comparisons.trace.charts import BlockChart, JointChart
from comparisons.trace.derivatives import Evaluated
from comparisons.trace.events import (
    ADDITIVE,
    CHARTS,
    OWN_CHART,
    Augment,
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
from comparisons.trace.functions import Function, FunctionOutcome, FunctionSampler
from comparisons.trace.reader import APPLICATION, TABLES, VERSION, last_state
from comparisons.trace.rows import MOST_ENTRIES

PAGE_BYTES = 32768
COMMIT_EVENTS, COMMIT_BYTES = 2000, 1 << 24
"""A recording that is killed, or whose computer fails, is valid up to its last commit."""
_DTYPE = np.dtype("<f8")
_NONE = [(-1,) * (MOST_COLUMNS - count) for count in range(MOST_COLUMNS + 1)]
PRIOR, PREDICT, UPDATE, AUGMENT, CLONE, REMOVE, RESET, SNAPSHOT, DIRECTIONS, EVALUATION = range(
    len(KINDS)
)

_OF_MEASUREMENT = "correction", "gain", "point", "numbers", "weight"
_OF_AUGMENTATION = "point", "after", "numbers", "weight", "chart"
"""What events say beside what the filter used."""

Blob = bytes | None


class MeasurementNotes(TypedDict, total=False):
    """What may be said of a measurement beside what the filter used.

    correction: (N,) what was added to the estimate of all blocks, if it is to be checked. gain:
    (N, m) likewise. point: the blocks' numbers about which it was linearised. numbers: of what was
    measured, in the log. weight: of a part of a measurement, the share of its information.
    """

    correction: ArrayLike
    gain: ArrayLike
    point: ArrayLike
    numbers: ArrayLike
    weight: ArrayLike
    function: Function
    measured: ArrayLike


class AugmentationNotes(TypedDict, total=False):
    """What may be said of a new block beside what the filter used.

    point: the blocks' numbers about which it was linearised. after: its own numbers. numbers: of
    what was measured, in the log. weight: as of `MeasurementNotes`; 0 where no measurement
    tells it, but a prior. chart: of its error, one of events.CHARTS. function: g, of the blocks'
    numbers to those of the new block.
    """

    function: Function
    point: ArrayLike
    after: ArrayLike
    numbers: ArrayLike
    weight: ArrayLike
    chart: str


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
        synced: bool = True,
        derivatives: float = 0.05,
        quaternions: str | None = None,
    ) -> None:
        """Start a file.

        Args:
            path: Of the trace. An existing file is only ever appended to.
            gates: By sensor, the probability with which the gate lets a sound measurement pass.
            components: By sensor, names of the residual's entries.
            append: Go on with an existing trace.
            synced: Wait at each commit until it is on the disk, so that a power failure leaves what
                was committed. Without it a kill still does, but a power failure may damage all.
            derivatives: Share of the events with a function that are differentiated, beyond the
                first hundred of each kind.
            quaternions: Order of the four numbers of an attitude, `wxyz` or `xyzw`; None where
                attitudes have the nine of their matrix, row by row. Functions need it alone.

        Raises:
            InputError: The file exists already, or cannot be written; or append is set, and there
                is none that is a trace; or a gate is no probability, or derivatives no share.
        """
        self._path = Path(path)
        self._dims: dict[str, int] = {}
        self._charts: dict[str, str] = {}
        self._first = 0
        self._time_s = math.nan
        self._rows: list[bytes] = []
        self._matrices: dict[bytes, int] = {}
        self._last: dict[str, bytes] = {}
        self._texts: dict[str, int] = {}
        self._sensors: dict[str, int] = {}
        self._bytes = self._updates = self._snapshots = 0
        self._sizes: dict[tuple[str, ...] | None, tuple[int, int]] = {}
        self._ended: str | None = None
        self._process = os.getpid()
        try:
            self._functions = FunctionSampler(derivatives, quaternions)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        sensors = self._described(gates or {}, components or {})
        if append:
            self._follow()
        else:
            self._create()
        try:
            self._open(sensors, new=not append, synced=synced)
        except sqlite3.Error as error:
            self._file.close()
            if not append:
                self._path.unlink()
            raise InputError(f"{path}: cannot be written ({error})") from None

    def __enter__(self) -> Self:
        """Return the recorder itself."""
        return self

    def __exit__(self, *error: object) -> None:
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
        if not self._rows:
            return
        state = [[name, dim, self._charts[name]] for name, dim in self._dims.items()]
        counts = self._first, len(self._rows), self._updates, self._snapshots
        row = (*counts, json.dumps(state), pack(self._rows, self._texts, self._matrices))
        inserted = False
        try:
            self._file.execute("BEGIN IMMEDIATE")
            self._file.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?)", row)
            inserted = True
            self._file.execute("COMMIT")
        except sqlite3.Error as error:
            self._end(f"cannot be written ({error}); the recording ends before event {counts[0]}")
            self._check_open()
        except BaseException:  # an interrupt: what is not written stays for the next commit
            if self._file.in_transaction:
                self._file.execute("ROLLBACK")
            elif inserted:
                self._begin()
            raise
        self._begin()

    def _begin(self) -> None:
        """Begin another batch."""
        self._first += len(self._rows)
        self._rows, self._matrices, self._texts = [], {}, {}
        self._bytes = self._updates = self._snapshots = 0
        self._sensors.clear()
        self._sizes.clear()

    def at(self, time_s: float) -> None:
        """Set the time of the events that follow.

        Args:
            time_s: In the filter's own clock.
        """
        time_s = float(time_s)
        if not math.isfinite(time_s):
            self._refuse("time_s is not finite")
        self._time_s = time_s

    def prior(
        self,
        blocks: Mapping[str, int],
        covariance: ArrayLike,
        *,
        point: ArrayLike | None = None,
        charts: Mapping[str, str | BlockChart] | None = None,
    ) -> None:
        """Record the first covariance.

        Args:
            blocks: Names and dimensions of all blocks, in the state's order.
            covariance: (n, n).
            point: The estimate, in the filter's own numbers.
            charts: Of blocks whose error is not added to their numbers, one of events.CHARTS, or
                the filter's own `BlockChart`.
        """
        self._check_open()
        if self._dims:
            self._refuse("is a second prior; a filter that begins anew has a new trace")
        dims = {_name(name): self._dim(dim) for name, dim in blocks.items()}
        n = sum(dims.values())
        if not 0 < n <= MOST_ENTRIES:
            self._refuse(f"the state has {n} entries, expected 1 to {MOST_ENTRIES}")
        p = self._blob("P", covariance, (n, n))
        begun = self._own("point", point)
        named = {name: self._chart_of_block(name, (charts or {}).get(name)) for name in dims}
        if strange := set(charts or ()) - set(dims):
            self._refuse(f"charts name {quoted(min(strange))}, which is no block")
        note = self._text(json.dumps([list(dims.values()), list(named.values())]))
        self._dims, self._charts = dims, named
        self._functions.begin(dims, np.frombuffer(p, _DTYPE).reshape(n, n))
        self._sizes.clear()
        self._put(PRIOR, self._text(json.dumps(list(dims))), (p, begun), note)

    def predict(
        self,
        F: ArrayLike,
        Q: ArrayLike,
        blocks: Iterable[str] | None = None,
        *,
        function: Function | None = None,
        point: ArrayLike | None = None,
        after: ArrayLike | None = None,
    ) -> None:
        """Record a prediction: e' = F e + w, w ~ N(0, Q).

        Args:
            F: (n, n) on the blocks.
            Q: (n, n).
            blocks: Those that the prediction moves.
            function: f, of their numbers before the step to those after it, with the filter's own
                inputs, whose derivative F should be. It needs point.
            point: Their numbers before it, if the trace is to be compared with a log, or with f.
            after: Their numbers after it.
        """
        text, n = self._size(blocks)
        shape = n, n
        f, q = self._blob("F", F, shape), self._blob("Q", Q, shape)
        if function is not None:
            points = self._own("point", point), self._own("after", after)
            evaluated = self._evaluated("F", blocks, function, point)
            self._put(PREDICT, text, (f, q, *points))
            if evaluated is not None:
                self._put_evaluation(evaluated, blocks)
        elif point is None and after is None:
            self._put(PREDICT, text, (f, q))
        else:
            self._put(PREDICT, text, (f, q, self._own("point", point), self._own("after", after)))

    def update(
        self,
        sensor: str,
        residual: ArrayLike,
        H: ArrayLike,
        R: ArrayLike,
        blocks: Iterable[str] | None = None,
        **more: Unpack[MeasurementNotes],
    ) -> None:
        """Record a measurement that the filter used: residual = H e + v, v ~ N(0, R).

        Args:
            sensor: Its name.
            residual: (m,) measured minus predicted.
            H: (m, n) on the blocks.
            R: (m, m).
            blocks: Those that H stands on.
            more: What else is to be checked, as of `MeasurementNotes`.
        """
        self._measured(1, sensor, residual, (H, R), blocks, more)

    def reject(
        self,
        sensor: str,
        residual: ArrayLike,
        H: ArrayLike,
        R: ArrayLike,
        blocks: Iterable[str] | None = None,
        **more: Unpack[MeasurementNotes],
    ) -> None:
        """Record a measurement that the filter's gate rejected; arguments as of `update`.

        Args:
            sensor: Its name.
            residual: (m,) measured minus predicted.
            H: (m, n) on the blocks.
            R: (m, m).
            blocks: Those that H stands on.
            more: As of `MeasurementNotes`; without correction and gain.
        """
        self._measured(0, sensor, residual, (H, R), blocks, more)

    def _measured(
        self,
        used: int,
        sensor: str,
        residual: ArrayLike,
        by: tuple[ArrayLike, ArrayLike],
        blocks: Iterable[str] | None,
        more: MeasurementNotes,
    ) -> None:
        text, n = self._size(blocks)
        m = residual.size if type(residual) is np.ndarray else np.size(residual)
        if not m:
            self._refuse("residual is empty")
        z = self._vector("residual", residual, m)
        h, r = self._blob("H", by[0], (m, n)), self._blob("R", by[1], (m, m))
        blobs: tuple[Blob, ...] = z, h, r
        evaluated, truth = None, None
        if more:
            blobs += self._more(UPDATE, more, m)
            if "measured" in more:
                truth = self._vector("measured", more["measured"], m)
            if "function" in more:
                slot, point = f"H of {sensor}", more.get("point")
                evaluated = self._evaluated(slot, blocks, more["function"], point, m)
        name = self._sensors.get(sensor)
        if name is None:
            name = self._sensors[sensor] = self._text(json.dumps(_name(sensor)))
        self._updates += 1
        self._put(UPDATE, text, blobs, name, used)
        if evaluated is not None:
            self._put_evaluation(evaluated, blocks, truth)

    def _more(self, kind: int, more: Mapping[str, Any], m: int = 0) -> tuple[Blob, ...]:
        """Return the further matrices of an event of a kind. m: entries of its residual."""
        found: dict[str, Blob] = {}
        for name, value in more.items():
            if value is None or name in ("chart", "function", "measured"):
                continue
            if name == "correction":
                found[name] = self._vector(name, value, self._size(None)[1])
            elif name == "gain":
                found[name] = self._blob(name, value, (self._size(None)[1], m))
            else:
                found[name] = self._own(name, value)
        columns = COLUMNS[KINDS[kind]][3:]
        if strange := set(found) - set(columns):
            raise TypeError(f"got an unexpected keyword argument {quoted(min(strange))}")
        return tuple(map(found.get, columns))

    def augment(
        self,
        name: str,
        G_x: ArrayLike,
        G_z: ArrayLike,
        R: ArrayLike,
        blocks: Iterable[str] | None = None,
        **more: Unpack[AugmentationNotes],
    ) -> None:
        """Record a new block, behind all others: e_new = G_x e + G_z v, v ~ N(0, R).

        Args:
            name: Of the block.
            G_x: (d, n) on the blocks.
            G_z: (d, m); m may be 0 where nothing is added to what the other blocks tell.
            R: (m, m).
            blocks: Those that it is initialised from.
            more: What else is to be checked, as of `AugmentationNotes`.
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
        chart, evaluated = self._chart(more.get("chart", ADDITIVE)), None
        blobs = g_x, r, by_noise.tobytes(), *self._more(AUGMENT, more)
        if (function := more.get("function")) is not None:
            new = (name, d, chart)
            evaluated = self._evaluated("G_x", blocks, function, more.get("point"), new)
        self._add(name, d, chart)
        self._put(AUGMENT, text, blobs, self._text(json.dumps([name, d, chart])))
        if evaluated is not None:
            self._put_evaluation(evaluated, blocks)

    def clone(self, source: str, name: str) -> None:
        """Record a copy of a block, behind all others.

        Args:
            source: The block that is copied.
            name: Of the copy.
        """
        text, d = self._size((source,))
        self._check_new(name, d)
        self._add(name, d, self._charts[source])
        self._put(CLONE, text, (), self._text(json.dumps(name)))

    def remove(self, *names: str) -> None:
        """Record blocks that are marginalised out.

        Args:
            names: Of the blocks.
        """
        text, _ = self._size(names)
        if len(names) == len(self._dims):
            self._refuse("removes the last block of the state")
        for name in names:
            del self._dims[name], self._charts[name]
        self._sizes.clear()
        self._put(REMOVE, text, ())

    def reset(self, J: ArrayLike, blocks: Iterable[str] | None = None) -> None:
        """Record that the error is expressed anew, as after an error-state correction: e' = J e.

        Args:
            J: (n, n) on the blocks.
            blocks: Those that it is on.
        """
        text, n = self._size(blocks)
        j = self._blob("J", J, (n, n))
        self._put(RESET, text, (j,))

    def renew(self, block: str, P: ArrayLike, *, after: ArrayLike | None = None) -> None:
        """Record that the covariance of a block is set on purpose, as where a bias starts anew.

        Its error becomes independent of all others: it is a prediction with F = 0 and Q = P.

        Args:
            block: Its name.
            P: (d, d) the block's covariance from now on; its covariances with others are zero.
            after: Its numbers from now on.
        """
        d = self._size((block,))[1]
        self.predict(np.zeros((d, d)), self._fitting("P", P, (d, d)), (block,), after=after)

    def snapshot(
        self,
        P: ArrayLike,
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
        true = None if error is None else self._vector("error", error, n)
        blobs = p, self._own("mean", mean), true
        self._snapshots += 1
        self._put(SNAPSHOT, text, blobs)

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
            np.frombuffer(self._vector(f"basis of {quoted(name)}", one, n), _DTYPE)
            for name, one in basis.items()
        ]
        note = self._text(json.dumps({"names": names[0], "blind": names[1]}))
        self._put(DIRECTIONS, text, (np.column_stack(columns).tobytes(),), note)

    def _evaluated(
        self,
        slot: str,
        blocks: Iterable[str] | None,
        function: Function,
        point: ArrayLike | None,
        outcome: int | tuple[str, int, str] | None = None,
    ) -> Evaluated | None:
        """Return what a function says where the filter was, if this event is to be evaluated.

        outcome: how many numbers are measured, or name, dimension and chart of the new block; None
        of a prediction, which leads to the same blocks.
        """
        if point is None:
            self._refuse(f"has a function for {slot}, and no point at which it is evaluated")
        names = tuple(self._dims) if blocks is None else tuple(blocks)
        dims = [self._dims[name] for name in names]
        sampler = self._functions
        if not sampler.is_due(slot, dims):
            return None
        try:
            before = sampler.joint(names, dims, [self._charts[name] for name in names])
            after: JointChart | None = before
            if isinstance(outcome, int):
                after = None
            elif outcome is not None:
                name, dim, chart = outcome
                after = sampler.joint((name,), (dim,), (chart,))
            evaluated = sampler.evaluate(
                function, point, before, FunctionOutcome(slot, after), names
            )
            if isinstance(outcome, int) and len(evaluated.value) != outcome:
                raise ValueError(f"gives {len(evaluated.value)} numbers, expected {outcome}")
        except Exception as error:
            sampler.warn(slot, f"{self._path}, event {self._number}", error)
            return None
        return evaluated

    def _put_evaluation(
        self, evaluated: Evaluated, blocks: Iterable[str] | None, measured: Blob = None
    ) -> None:
        text, _ = self._size(blocks)
        parts = evaluated.jacobian, evaluated.value, evaluated.uncertainty
        self._put(EVALUATION, text, (*(part.tobytes() for part in parts), measured))

    def event(self, event: Event) -> None:
        """Record an event as it was read, or as another filter did it, at its own time.

        Args:
            event: Of any kind; its number plays no part, nor does the recorder's time where the
                event has one.
        """
        if event.time_s is not None:
            self.at(event.time_s)
        match event:
            case TracePrior(blocks=blocks, dims=dims, covariance=p, point=point):
                charts = dict(zip(blocks, event.charts, strict=False))
                self.prior(dict(zip(blocks, dims, strict=True)), p, point=point, charts=charts)
            case Predict(blocks=blocks, jacobian=f, noise=q):
                self.predict(f, q, blocks, point=event.point, after=event.after)
            case Update(sensor=sensor, residual=residual, jacobian=h, noise=r):
                notes = _noted(event, _OF_MEASUREMENT)
                self._measured(int(event.used), sensor, residual, (h, r), event.blocks, notes)
            case Augment(jacobian=g_x, noise_jacobian=g_z, noise=r):
                notes = _noted(event, _OF_AUGMENTATION)
                self.augment(event.name, g_x, g_z, r, event.blocks, **notes)
            case Clone():
                self.clone(event.source, event.name)
            case Remove():
                self.remove(*event.blocks)
            case Reset():
                self.reset(event.jacobian, event.blocks)
            case Snapshot(covariance=p, mean=mean, error=error):
                self.snapshot(p, event.blocks, mean=mean, error=error)
            case Evaluation(jacobian=jacobian, value=value, uncertainty=uncertainty):
                evaluated = Evaluated(value, jacobian, uncertainty)
                self._put_evaluation(evaluated, event.blocks, self._own("measured", event.measured))
            case Directions():
                basis = dict(zip(event.names, event.basis.T, strict=True))
                self.directions(basis, event.blind, blocks=event.blocks)

    def _put(
        self, kind: int, blocks: int, blobs: Iterable[Blob], text: int = -1, used: int = 0
    ) -> None:
        """Record an event, which the state is already after.

        blocks, text: of the batch. blobs: its matrices, as COLUMNS has them.
        """
        known, at = self._matrices, []
        for blob in blobs:
            if blob is None:
                at.append(-1)
                continue
            index = known.get(blob)
            if index is None:
                index = known[blob] = len(known)
                self._bytes += len(blob)
            at.append(index)
        rows = self._rows
        rows.append(ROW.pack(self._time_s, kind, used, blocks, text, *at, *_NONE[len(at)]))
        if len(rows) >= COMMIT_EVENTS or self._bytes >= COMMIT_BYTES:
            self.commit()

    def _text(self, spoken: str) -> int:
        """Return the index of a text, in JSON, in the batch."""
        return self._texts.setdefault(spoken, len(self._texts))

    def _size(self, blocks: Iterable[str] | None) -> tuple[int, int]:
        """Index of the blocks' text, and how many entries they have together."""
        key = None if blocks is None else tuple(blocks)
        return self._sizes.get(key) or self._find(key)

    def _find(self, key: tuple[str, ...] | None) -> tuple[int, int]:
        self._check_open()
        names = tuple(self._dims) if key is None else key
        for name in names:
            if name not in self._dims:
                known = ", ".join(self._dims) or "none: record the prior first"
                self._refuse(
                    f"block {quoted(name)} is not in the state; it has {shorten(known, 200)}"
                )
        if not names or len(set(names)) < len(names):
            self._refuse("expected blocks, none of them twice; record the prior first")
        size = sum(self._dims[name] for name in names)
        found = self._sizes[key] = self._text(json.dumps(names)), size
        return found

    def _check_new(self, name: str, dim: int) -> None:
        if _name(name) in self._dims:
            self._refuse(f"block {quoted(name)} is in the state already; remove it first")
        if dim + sum(self._dims.values()) > MOST_ENTRIES:
            self._refuse(f"makes the state larger than {MOST_ENTRIES} entries")

    def _add(self, name: str, dim: int, chart: str) -> None:
        self._dims[name], self._charts[name] = dim, chart
        self._sizes.clear()

    def _chart_of_block(self, name: str, chart: str | BlockChart | None) -> str:
        """Return the name of a block's chart."""
        if isinstance(chart, BlockChart):
            self._functions.define(name, chart)
            return OWN_CHART
        return self._chart(ADDITIVE if chart is None else chart)

    def _chart(self, chart: str) -> str:
        if chart not in CHARTS:
            self._refuse(f"chart {quoted(chart)}, expected one of {', '.join(CHARTS)}")
        return chart

    def _dim(self, dim: Any) -> int:
        if int(dim) != dim or not 0 < dim <= MOST_ENTRIES:
            self._refuse(f"dimension {quoted(dim)}, expected 1 to {MOST_ENTRIES}")
        return int(dim)

    def _blob(self, name: str, matrix: ArrayLike, shape: tuple[int, int]) -> bytes:
        """Return a matrix as it is stored; a number stands for 1 x 1. Raises InputError.

        One that repeats the last of its name is the same object, whose hash is known.
        """
        if not (type(matrix) is np.ndarray and matrix.dtype is _DTYPE and matrix.shape == shape):
            matrix = self._fitting(name, matrix, shape)
        found, last = matrix.tobytes(), self._last.get(name)
        if found == last:
            return last
        self._last[name] = found
        return found

    def _fitting(self, name: str, matrix: ArrayLike, shape: tuple[int, int]) -> Array:
        found = self._numbers(name, matrix)
        if found.shape != shape and not (found.size == 1 and shape == (1, 1)):
            actual = " x ".join(map(str, found.shape)) or "a number"
            self._refuse(f"{name} is {actual}, expected {shape[0]} x {shape[1]}")
        return found

    def _own(self, name: str, values: ArrayLike | None) -> Blob:
        """Return numbers of any count as they are stored."""
        return None if values is None else self._numbers(name, values).tobytes()

    def _vector(self, name: str, vector: ArrayLike, size: int) -> bytes:
        """Return a vector as it is stored; it may be a column or a row."""
        if type(vector) is np.ndarray and vector.dtype is _DTYPE and vector.shape == (size,):
            return vector.tobytes()
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

    @property
    def _number(self) -> int:
        """Of the next event."""
        return self._first + len(self._rows)

    def _refuse(self, fault: str) -> NoReturn:
        raise InputError(f"{self._path}, event {self._number}: {fault}")

    def _check_open(self) -> None:
        if self._ended is not None:
            raise InputError(f"{self._path}: {self._ended}")

    def _end(self, reason: str) -> None:
        """Record nothing from now on; what is not committed is undone."""
        self._ended = reason
        self._rows = []
        self._begin()
        self._file.close()

    def _described(
        self, gates: Mapping[str, float], components: Mapping[str, Sequence[str]]
    ) -> list[tuple[str, float | None, str | None]]:
        """Return rows of the table of sensors."""
        rows = []
        for name in {**gates, **components}:
            gate, parts = gates.get(name), components.get(name)
            if gate is not None and not 0.0 < gate < 1.0:
                raise InputError(
                    f"{self._path}: gate of {quoted(name)} is {quoted(gate)}, expected 0 < p < 1"
                )
            if parts is not None and (isinstance(parts, str) or len(set(parts)) < len(parts)):
                raise InputError(
                    f"{self._path}: components of {quoted(name)} are not distinct names"
                )
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

    def _open(
        self, sensors: Iterable[tuple[str, float | None, str | None]], *, new: bool, synced: bool
    ) -> None:
        """Open the file and describe the sensors. Raises sqlite3.Error."""
        self._file = sqlite3.connect(
            self._path.absolute(), isolation_level=None, check_same_thread=False
        )
        # EXTRA: the journal's removal, which is the commit, is on the disk as well.
        self._file.execute(f"PRAGMA synchronous = {'EXTRA' if synced else 'OFF'}")
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
        """Read of the trace that is appended to its last number and its blocks."""
        self._first, state = last_state(self._path)
        self._dims = {name: dim for name, dim, _ in state}
        self._charts = {name: chart for name, _, chart in state}


def _noted(event: Event, names: Iterable[str]) -> Any:
    """Return what an event says beside what the filter used, by the names of the recorder's."""
    values = {name: getattr(event, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _name(name: str) -> str:
    """A name that can be stored. Raises InputError."""
    try:
        name.encode()
    except (AttributeError, UnicodeEncodeError):
        raise InputError(f"name {quoted(name)}: expected a text of whole characters") from None
    return name
