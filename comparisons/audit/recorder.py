"""Records what a Kalman filter does: a few lines around an existing filter."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from comparisons.audit.trace_file import APPLICATION, TABLES, VERSION
from comparisons.errors import InputError

_INSERT = "INSERT INTO event VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
PAGE_BYTES = 32768
COMMIT_EVENTS = 2000
"""A recording that is killed is valid up to its last commit."""
_DTYPE = np.dtype("<f8")


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

    Matrices are checked for their shape alone; what they say is the audit's business.
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
                is none that is a trace.
        """
        self._path = Path(path)
        self._dims: dict[str, int] = {}
        self._number = 0
        self._time_s: float | None = None
        self._rows: list[tuple[Any, ...]] = []
        self._sizes: dict[tuple[str, ...] | None, tuple[str, int]] = {}
        self._last: dict[tuple[str, str | None, str], list[bytes | None]] = {}
        if append:
            self._follow()
        elif self._path.exists():
            raise InputError(f"{path}: exists already; give a new name, or append=True")
        try:
            self._file = sqlite3.connect(self._path)
            if not append:
                self._file.execute(f"PRAGMA page_size = {PAGE_BYTES}")
                self._file.execute(f"PRAGMA application_id = {APPLICATION}")
                self._file.execute(f"PRAGMA user_version = {VERSION}")
                for table in TABLES.values():
                    self._file.execute(table)
            for name in {**(gates or {}), **(components or {})}:
                gate, parts = (gates or {}).get(name), (components or {}).get(name)
                row = name, gate, None if parts is None else json.dumps(list(parts))
                self._file.execute("INSERT OR REPLACE INTO sensor VALUES (?, ?, ?)", row)
            self._file.commit()
        except sqlite3.Error as error:
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
        self.commit()
        self._file.close()

    def commit(self) -> None:
        """Write what is recorded so far; it is done by itself every two thousand events."""
        rows, self._rows = self._rows, []
        try:
            self._file.executemany(_INSERT, rows)
            self._file.commit()
        except sqlite3.Error as error:
            raise InputError(f"{self._path}: cannot be written ({error})") from None

    def at(self, time_s: float) -> None:
        """Set the time of the events that follow.

        Args:
            time_s: In the filter's own clock.
        """
        self._time_s = float(time_s)

    def prior(self, blocks: Mapping[str, int], covariance: ArrayLike) -> None:
        """Record the first covariance.

        Args:
            blocks: Names and dimensions of all blocks, in the state's order.
            covariance: (n, n).
        """
        self._dims = {name: int(dim) for name, dim in blocks.items()}
        self._sizes.clear()
        text, n = self._size(None)
        note = json.dumps(list(self._dims.values()))
        p = self._blob("P", covariance, (n, n))
        self._put("prior", None, text, covariance=p, note=note)

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
        f, q = self._blob("F", F, (n, n)), self._blob("Q", Q, (n, n))
        self._put("predict", None, text, *self._new("predict", None, text, f, q))

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
        whole = self._size(None)[1]
        m = np.size(residual)
        self._measured(
            sensor,
            residual,
            H,
            R,
            blocks,
            used=1,
            correction=None if correction is None else self._blob("c", correction, (whole,)),
            gain=None if gain is None else self._blob("K", gain, (whole, m)),
        )

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
            residual: (m,).
            H: (m, n).
            R: (m, m).
            blocks: Those that H stands on.
        """
        self._measured(sensor, residual, H, R, blocks, used=0)

    def _measured(
        self,
        sensor: str,
        residual: ArrayLike,
        h: ArrayLike,
        r: ArrayLike,
        blocks: Iterable[str] | None,
        **others: Any,
    ) -> None:
        text, n = self._size(blocks)
        z = np.atleast_1d(np.asarray(residual, _DTYPE))
        m = len(z)
        by_state, noise = self._blob("H", h, (m, n)), self._blob("R", r, (m, m))
        repeated = self._new("update", sensor, text, by_state, noise)
        self._put("update", sensor, text, *repeated, residual=z.tobytes(), **others)

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
            G_z: (d, m).
            R: (m, m).
            blocks: Those that it is initialised from.
        """
        text, n = self._size(blocks)
        self._unused(name)
        by_noise, noise = np.atleast_2d(np.asarray(G_z, _DTYPE)), np.asarray(R, _DTYPE)
        d, m = by_noise.shape
        g_x, r = self._blob("G_x", G_x, (d, n)), self._blob("R", noise, (m, m))
        found = self._new("augment", None, text, g_x, r, by_noise.tobytes())
        note = json.dumps([name, d])
        self._put("augment", None, text, *found[:2], noise_jacobian=found[2], note=note)
        self._dims[name] = d
        self._sizes.clear()

    def clone(self, source: str, name: str) -> None:
        """Record a copy of a block, behind all others.

        Args:
            source: The block that is copied.
            name: Of the copy.
        """
        text, _ = self._size((source,))
        self._unused(name)
        self._put("clone", None, text, note=name)
        self._dims[name] = self._dims[source]
        self._sizes.clear()

    def remove(self, *names: str) -> None:
        """Record blocks that are marginalised out.

        Args:
            names: Of the blocks.
        """
        text, _ = self._size(names)
        self._put("remove", None, text)
        for name in names:
            del self._dims[name]
        self._sizes.clear()

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
        j = self._new("reset", None, text, self._blob("J", J, (n, n)))
        self._put("reset", None, text, *j)

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
        self._put(
            "snapshot",
            None,
            text,
            covariance=self._blob("P", P, (n, n)),
            mean=None if mean is None else np.ravel(np.asarray(mean, _DTYPE)).tobytes(),
            error=None if error is None else self._blob("error", error, (n,)),
        )

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
        columns = np.column_stack([np.asarray(one, _DTYPE) for one in basis.values()])
        note = json.dumps({"names": list(basis), "blind": list(blind)})
        blob = self._blob("basis", columns, (n, len(basis)))
        self._put("directions", None, text, blob, note=note)

    def _put(
        self,
        kind: str,
        sensor: str | None,
        blocks: str,
        jacobian: bytes | None = None,
        noise: bytes | None = None,
        **others: Any,
    ) -> None:
        get = others.get
        self._rows.append(
            (
                self._number,
                kind,
                self._time_s,
                sensor,
                blocks,
                get("used"),
                jacobian,
                noise,
                get("noise_jacobian"),
                get("residual"),
                get("correction"),
                get("gain"),
                get("covariance"),
                get("mean"),
                get("error"),
                get("note"),
            )
        )
        self._number += 1
        if len(self._rows) >= COMMIT_EVENTS:
            self.commit()

    def _new(
        self,
        kind: str,
        sensor: str | None,
        blocks: str,
        *matrices: bytes | None,
    ) -> list[bytes | None]:
        """Return matrices, None for those of the event before that was like it."""
        before = self._last.get((kind, sensor, blocks))
        self._last[kind, sensor, blocks] = list(matrices)
        if before is None:
            return list(matrices)
        return [None if m == b else m for m, b in zip(matrices, before, strict=True)]

    def _size(self, blocks: Iterable[str] | None) -> tuple[str, int]:
        """Blocks as they are stored, and how many entries they have together."""
        key = None if blocks is None else tuple(blocks)
        found = self._sizes.get(key)
        if found is None:
            names = tuple(self._dims) if key is None else key
            for name in names:
                if name not in self._dims:
                    known = ", ".join(self._dims) or "none: record the prior first"
                    raise InputError(f"block {name!r} is not in the state; it has {known}")
            size = sum(self._dims[name] for name in names)
            found = self._sizes[key] = json.dumps(names), size
        return found

    def _unused(self, name: str) -> None:
        if name in self._dims:
            raise InputError(f"block {name!r} is in the state already; remove it first")

    def _blob(self, name: str, matrix: ArrayLike, shape: tuple[int, ...]) -> bytes:
        """Return a matrix as it is stored. Raises InputError where its shape is another."""
        found = np.asarray(matrix, _DTYPE)
        if found.shape != shape and found.size != 1:
            expected = " x ".join(map(str, shape))
            actual = " x ".join(map(str, found.shape))
            raise InputError(f"event {self._number}: {name} is {actual}, expected {expected}")
        if found.size == 1 and shape not in ((1,), (1, 1)):
            raise InputError(f"event {self._number}: {name} is a single number, expected {shape}")
        return found.tobytes()

    def _follow(self) -> None:
        """Read the trace that is appended to, for its last number and its blocks."""
        from comparisons.audit.events import Augment, Clone, Prior, Remove
        from comparisons.audit.trace_file import Trace

        for event in Trace(self._path):
            self._number = event.number + 1
            if isinstance(event, Prior):
                self._dims = dict(zip(event.blocks, event.dims, strict=True))
            elif isinstance(event, Augment):
                self._dims[event.name] = len(event.jacobian)
            elif isinstance(event, Clone):
                self._dims[event.name] = self._dims[event.source]
            elif isinstance(event, Remove):
                for name in event.blocks:
                    del self._dims[name]
