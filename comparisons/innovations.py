"""Normalised innovations squared by sensor, and whether innovations are white: of any filter.

Measurements of one instant share the pose's error, so the filter whitens together what it fuses
together: with S = L L^T of the stacked innovation nu, L^-1 nu holds independent standard normal
numbers if the filter is consistent, within an instant and over time. A measurement's range is then
judged given the measurements fused before it at that instant, and its bearing given its range as
well. Each squared has one degree of freedom, and the averages over a whole run have an exact band.

What a gate rejects is missing: with a gate at 99 % the average of a consistent filter is 4 % low.
Association by distance shortens innovations, too. Where the gate's probability is known, a passed
vector is lengthened to the quantile that its length has among those that pass. Then it is standard
normal again, exactly.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, gammainc, gammaincinv

from comparisons.arrays import Array, Index
from comparisons.figures import Aside, Key, Mark
from comparisons.statistics import (
    OUTSIDE,
    Band,
    Nis,
    Whiteness,
    average,
    faults,
    mean_band,
    whiteness,
)
from comparisons.trace.events import SensorDescription
from comparisons.words import Row

MOST_WINDOWS = 60
"""So many averages over a run are drawn."""
_LEAST_IN_WINDOW = 10
NO_SENSOR = SensorDescription(None, ())

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Windows:
    """Average NIS over stretches of a run. time_s, event, mean, low, high: (n,)."""

    time_s: Array
    event: Array
    mean: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Gating:
    """Measurements (k,) with a valid S: event, time_s, rejected. passes: share of sound ones."""

    event: Index
    time_s: Array
    rejected: Mask
    passes: float | None

    @property
    def count(self) -> int:
        """How many were rejected."""
        return int(np.count_nonzero(self.rejected))

    @property
    def instants(self) -> tuple[Index, Index, Index]:
        """Rows at which instants begin, and of each how many were measured and rejected.

        Measurements of an instant share the state's error, and so what becomes of them.
        """
        starts = np.flatnonzero(np.diff(self.time_s, prepend=np.nan) != 0.0)
        ones = np.column_stack((np.ones(len(self.event), np.intp), self.rejected.astype(np.intp)))
        measured, rejected = np.add.reduceat(ones, starts, axis=0).T if len(starts) else ones.T
        return starts, measured, rejected

    def longest(self) -> tuple[int, int, int]:
        """Return the longest series of instants that were rejected as a whole.

        Returns:
            Its first row, the one behind its last, and how many instants it has; none without any.
        """
        starts, measured, rejected = self.instants
        steps = np.diff(np.concatenate(([0], (measured == rejected).astype(np.int8), [0])))
        first, end = np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)
        if not len(first):
            return 0, 0, 0
        at = int(np.argmax(end - first))
        ends = np.append(starts, len(self.event))
        return int(ends[first[at]]), int(ends[end[at]]), int(end[at] - first[at])

    @property
    def band(self) -> Band | None:
        """Shares of rejections that 95 % of sound runs have, about, by the beta distribution."""
        n = len(self.event)
        if self.passes is None or not n:
            return None
        mean = n * (1.0 - self.passes)
        low, high = (
            betaincinv(mean + 0.5, n - mean + 0.5, q) for q in (0.5 * OUTSIDE, 1.0 - 0.5 * OUTSIDE)
        )
        return Band(float(low), float(high))


@dataclass(frozen=True, kw_only=True)
class InnovationFigures:
    """One sensor's innovations.

    Attributes:
        sensor: name of the sensor.
        nis: the sensor as a whole, then its components.
        whiteness: each component, by time and by landmark.
        unusable: innovations that could not be whitened.
    """

    sensor: Key[str]
    nis: Annotated[tuple[Nis, ...], Mark(name="")]
    whiteness: tuple[Whiteness, ...]
    unusable: int

    def nis_rows(self, group: str) -> list[Row]:
        """Return the averages of the sensor and its components, in a group of rows."""
        return [
            Row(
                group,
                f"NIS of {n.name}, mean (expected {n.expected_words})",
                f"{n.mean:.3g}",
                f"{n.band[0]:.3g} to {n.band[1]:.3g}",
                n.band.holds(n.mean),
            )
            for n in self.nis
        ]


@dataclass(frozen=True, kw_only=True)
class SensorInnovations(InnovationFigures):
    """The measurements (n,) of a sensor that were used and have a valid S, with their figures.

    event, time_s: (n,). squared: (n,) NIS, of dof (n,) entries each. components: (n, c) whitened,
    with their names; None where measurements differ in size. least: of the expected NIS, what a
    gate within batches leaves at least; 1 where its effect is undone.

    Attributes:
        measured: measurements with a valid innovation covariance.
        rejected: those of them that the filter's gate rejected.
        nominal_rejected: the share that it rejects of sound ones, if it has a gate.
    """

    measured: int
    rejected: int
    nominal_rejected: float | None
    windows: Aside[Windows]
    gating: Aside[Gating]
    event: Aside[Index]
    time_s: Aside[Array]
    squared: Aside[Array]
    dof: Aside[Index]
    components: Aside[Array | None]
    names: Aside[tuple[str, ...]]
    least: Aside[float] = 1.0


class InnovationLog:
    """Whitened innovations of one sensor as they come, in little memory.

    A measurement has as many entries as its sensor has named components; where none are named, or
    an event has another number of entries, it is one measurement.
    """

    def __init__(self, name: str, sensor: SensorDescription = NO_SENSOR) -> None:
        """Start empty."""
        self._name, self._sensor = name, sensor
        self._values, self._rows = array("d"), array("d")

    def width(self, entries: int) -> int:
        """Return the entries of one measurement of an event."""
        named = len(self._sensor.components)
        return named if named and entries % named == 0 else entries

    def add(
        self,
        event: int | Index,
        time_s: float | Array,
        whitened: Array,
        *,
        used: bool = True,
        number: int | Array | Index = -1,
        landmark: int | Index = -1,
    ) -> None:
        """Keep measurements (k,), their entries (m,) one after the other, NaN without a valid S.

        event, time_s: when. used: false for what the gate rejected. number: in the log, negative
        where unknown. landmark: which it is of, negative where unknown. Each of all, or (k,).
        """
        width = self.width(len(whitened))
        rows: Array = np.empty((len(whitened) // width, 6))
        for column, value in zip(
            rows.T, (width, event, time_s, used, number, landmark), strict=True
        ):
            column[:] = value
        self._values.frombytes(whitened.tobytes())
        self._rows.frombytes(rows.tobytes())

    def judge(self, initialised: ArrayLike = ()) -> SensorInnovations:
        """Judge all but further parts of a measurement, and those that initialised their landmark.

        What was fused in parts is judged by the first; what initialises predicts nothing.
        initialised: (L,) number of the measurement that each landmark was initialised by.
        """
        rows = np.frombuffer(self._rows).reshape(-1, 6)
        size, event, used, number, landmark = rows[:, (0, 1, 3, 4, 5)].T.astype(np.intp)
        judged = _first(number, used)
        of = np.flatnonzero(judged & (number >= 0) & (landmark >= 0))
        judged[of] = np.asarray(initialised, dtype=np.intp)[landmark[of]] != number[of]
        values = np.frombuffer(self._values)[np.repeat(judged, size)]
        size, event, used, landmark = (c[judged] for c in (size, event, used, landmark))
        row, gate = np.repeat(np.arange(len(size)), size), self._sensor.gate
        squared: Array = np.bincount(row, values**2, len(size)).astype(np.float64)
        usable = np.isfinite(squared)
        kept, least = usable & (used > 0), 1.0
        if gate is not None:
            # Within a batch each is whitened given others, while the gate saw it alone.
            alone = np.bincount(event)[event] == 1
            values = values * np.where(alone, _lengthened(squared, size, gate), 1.0)[row]
            squared = np.bincount(row, values**2, len(size)).astype(np.float64)
            taken = (1.0 - _passed(size, gate)) * ~alone
            least -= float(taken[kept].sum()) / max(int(kept.sum()), 1)
        event, time_s = event[kept], rows[judged, 2][kept]
        squared, dof = squared[kept], size[kept]
        components, names = None, self._sensor.components
        if len(np.unique(dof)) == 1:
            components = values[kept[row]].reshape(len(dof), -1)
            if len(names) != dof[0]:
                names = tuple(f"component {i}" for i in range(dof[0]))
        gating = Gating(
            rows[judged, 1].astype(np.intp)[usable],
            rows[judged, 2][usable],
            used[usable] == 0,
            gate,
        )
        return SensorInnovations(
            sensor=self._name,
            nis=tuple(_nis(self._name, squared, dof, components, names)),
            whiteness=tuple(_whiteness(components, names, time_s, landmark[kept])),
            windows=_windows(event, time_s, squared, dof),
            unusable=int(np.count_nonzero(~usable)),
            measured=len(gating.event),
            rejected=gating.count,
            nominal_rejected=None if gate is None else 1.0 - gate,
            gating=gating,
            event=event,
            time_s=time_s,
            squared=squared,
            dof=dof,
            components=components,
            names=names if components is not None else (),
            least=least,
        )


def whiten_alone(innovation: Array, spread: Array, noise: Array, weight: Array) -> Array:
    """Whiten parts of measurements, innovations (n, c), each alone and as if it had been whole.

    spread: (n, c, c) S of the part. noise: (n, c, c) R / weight. weight: (n,), 1 for what is whole.
    NaN where S is no covariance.
    """
    s = spread + (weight[:, None, None] - 1.0) * noise
    bad = (faults(s) != "")[:, None]
    safe = np.where(bad[:, :, None], np.eye(s.shape[-1]), s)
    standard = np.linalg.solve(np.linalg.cholesky(safe), innovation[:, :, None])[:, :, 0]
    return np.where(bad, np.nan, standard)


def split_windows(count: int) -> list[Index]:
    """Return the rows of each stretch of a series: at most 60, of ten rows where there are more."""
    windows = min(MOST_WINDOWS, max(1, count // _LEAST_IN_WINDOW))
    return list(np.array_split(np.arange(count), windows)) if count else []


def _first(number: Index, used: Index) -> Mask:
    """Measurements (n,) but those whose number in the log was used, or rejected, before."""
    first: Mask = number < 0
    rows = np.flatnonzero(~first)
    first[rows[np.unique(2 * number[rows] + used[rows], return_index=True)[1]]] = True
    return first


def _lengthened(nis: Array, dof: Index, gate: float) -> Array:
    """Factors (n,) by which vectors that passed a gate are standard normal again."""
    passed = gammainc(0.5 * dof, 0.5 * nis) / gate
    found: Array = np.ones(len(nis))
    some = (nis > 0.0) & (passed < 1.0)
    found[some] = np.sqrt(2.0 * gammaincinv(0.5 * dof[some], passed[some]) / nis[some])
    return found


def _passed(dof: Index, gate: float) -> Array:
    """Of NIS of dof (n,) that sound measurements have, the share that those have which pass."""
    limit = gammaincinv(0.5 * dof, gate)
    found: Array = gammainc(0.5 * dof + 1.0, limit) / gate
    return found


def _nis(
    name: str, squared: Array, dof: Index, components: Array | None, names: Sequence[str]
) -> list[Nis]:
    if not len(dof):
        return []
    if components is None:
        per, count = float(dof.mean()), len(dof)
        band = mean_band(count, per)
        freedom = float(dof.sum())
        return [Nis(name, round(per), count, float(squared.mean()), band, freedom=freedom)]
    columns = components**2
    found = [average(name, columns)]
    if len(names) > 1:
        found += [average(one, columns[:, i : i + 1]) for i, one in enumerate(names)]
    return found


def _whiteness(
    components: Array | None, names: Sequence[str], time_s: Array, landmark: Index
) -> list[Whiteness]:
    """Of each component, in time and, where landmarks are known, from one to the next of each."""
    if components is None:
        return []
    instant = np.cumsum(np.diff(time_s, prepend=time_s[:1]) != 0.0)
    root = np.sqrt(np.bincount(instant))
    order = np.argsort(landmark, kind="stable")
    order = order[landmark[order] >= 0]
    found = []
    for column, name in zip(components.T, names, strict=True):
        found.append(whiteness(name, "time", np.bincount(instant, column) / root))
        if len(order):
            found.append(whiteness(name, "landmark", column[order], landmark[order]))
    return [one for one in found if one is not None]


def _windows(event: Index, time_s: Array, squared: Array, dof: Index) -> Windows:
    parts = split_windows(len(event))
    bands = [mean_band(len(part), float(dof[part].mean())) for part in parts]
    return Windows(
        time_s=np.array([time_s[part].mean() for part in parts]),
        event=np.array([0.5 * (event[part[0]] + event[part[-1]]) for part in parts]),
        mean=np.array([squared[part].mean() for part in parts]),
        low=np.array([band.low for band in bands]),
        high=np.array([band.high for band in bands]),
    )
