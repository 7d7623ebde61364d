"""Which measurements a filter left out on purpose, and by which rule.

Read from its trace, or found by reference filters that leave out the same. What is left out has no
label in the log that references and smoother are then given, so that its instants stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.filter_variants import BackwardEkf, ScalarEkf, SequentialEkf
from comparisons.arrays import Array, Index
from comparisons.audit.own_filter import distances_of
from comparisons.checks.grade import LIKE_SIGMA, Likeness, likeness
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate, Removed
from comparisons.fingerprints.companion import Companion, EstimateLeftError, part_of_step
from comparisons.logs.log import NO_LANDMARK, LandmarkMeasurements, Log
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import EKF, ONE_BY_ONE, filter_of
from comparisons.statistics import chi2_quantile
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import MeasurementModel
from ekf_reference.core.measurements import Association, Measurements
from ekf_reference.core.state import KalmanState

_LEVELS = (0.95, 0.975, 0.99, 0.995, 0.997, 0.999)
"""Probabilities of textbooks' gates."""
_ORDERS: dict[str, type[Ekf]] = {
    EKF: Ekf,
    ONE_BY_ONE: SequentialEkf,
    f"{ONE_BY_ONE}, the last first": BackwardEkf,
    f"{ONE_BY_ONE}, of range and of bearing": ScalarEkf,
}
"""Filters that may leave something out."""
_MOST_FIRST = 3
"""So many first measurements of each landmark may be left out."""
_MOST_PRUNED = 9
"""A landmark with more measurements is not removed for their number."""
_SHARE = 0.05
"""Of a sound filter's distance, that a run may be away from the estimate."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SelectedMeasurements(LandmarkMeasurements):
    """Measurements of a labelled log of which those without a label are left out."""

    @property
    def labelled(self) -> bool:
        """Every measurement that is used names its landmark."""
        return True


class LeftOut(NamedTuple):
    """Measurements that a filter left out, rows (k,) of the log. rule: in words."""

    rows: Index
    rule: str

    def said(self, log: Log) -> str:
        """Return it as a remark."""
        count = int(np.count_nonzero(log.measurements.landmark >= 0))
        return (
            f"the filter leaves out {len(self.rows)} of {count} measurements: {self.rule}; "
            "references and smoother leave out the same"
        )


def without(log: Log, rows: Index, gate: float | None = None) -> Log:
    """Return a labelled log without the labels of some measurements, which nobody uses then.

    gate: of the others, the normalised innovation squared beyond which a filter leaves them out.
    """
    landmark = log.measurements.landmark.copy()
    landmark[rows] = NO_LANDMARK
    return labelled_as(log, landmark, gate)


def labelled_as(log: Log, label: NDArray[np.int64], gate: float | None = None) -> Log:
    """Return a log with labels (M,) of its measurements; nobody uses those without."""
    measurements = log.measurements
    columns = {field.name: getattr(measurements, field.name) for field in fields(measurements)} | {
        "landmark": label
    }
    if gate is not None:
        columns["label_gate"] = gate
    return replace(log, measurements=SelectedMeasurements(**columns))


def first_rows(label: NDArray[np.int64], count: int) -> Index:
    """Return the rows of the first so many measurements of each landmark."""
    order = np.argsort(label, kind="stable")
    _, begin, of = np.unique(label[order], return_index=True, return_inverse=True)
    rank = np.empty(len(label), dtype=np.intp)
    rank[order] = np.arange(len(label)) - begin[of]
    return np.flatnonzero((rank < count) & (label >= 0))


def seldom_measured(label: NDArray[np.int64], landmarks: NDArray[np.int64]) -> int:
    """Return n where these are all landmarks with at most n measurements, zero where they are not.

    label: (M,) of the measurements. landmarks: (D,) labels.
    """
    labels, count = np.unique(label[label >= 0], return_counts=True)
    among = np.isin(labels, landmarks)
    if not among.any() or among.all() or not np.isin(landmarks, labels).all():
        return 0
    most = int(count[among].max())
    return most if (count[~among] > most).all() else 0


def with_removed(given: ExternalEstimate, log: Log) -> ExternalEstimate:
    """Return an estimate with the landmarks that it lacks as removed, if they are seldom measured.

    These are all that have no more than some number of measurements.
    """
    label = log.measurements.landmark
    if given.removed is not None or given.landmark_id is None or not log.measurements.labelled:
        return given
    absent = np.setdiff1d(label[label >= 0], given.landmark_id)
    most = seldom_measured(label, absent)
    if not 0 < most <= _MOST_PRUNED:
        return given
    words = f"those with fewer than {most + 1} measurements"
    return replace(given, removed=Removed(tuple(absent.tolist()), words))


def left_out_of(log: Log, run: EkfRun) -> LeftOut | None:
    """Return what the filter of a trace left out; None if it left out nothing, or by no rule."""
    index = run.landmark_index
    label, used = log.measurements.landmark[: len(index)], index >= 0
    rest = set(np.flatnonzero(~used & (label >= 0)).tolist())
    rows, rules = np.array(sorted(rest), dtype=np.intp), list[str]()
    if not rest or not used.any():
        return None
    first = _first_of(label, rest)
    if first:
        rules.append(_first_words(first))
        rest.difference_update(first_rows(label, first).tolist())
    never = np.setdiff1d(label[sorted(rest)], label[used])
    if most := seldom_measured(label, never):
        rules.append(f"those of landmarks with fewer than {most + 1} measurements")
        rest.difference_update(np.flatnonzero(np.isin(label, never)).tolist())
    if rest:
        gate = _gate_of(log, run, rest)
        if not gate:
            return None
        rules.append(gate)
    return LeftOut(rows, " and ".join(rules))


def _first_of(label: NDArray[np.int64], rest: set[int]) -> int:
    """Return how many first measurements of each landmark are among some rows."""
    counts = [n for n in range(1, _MOST_FIRST + 1) if rest.issuperset(first_rows(label, n))]
    return max(counts, default=0)


def _first_words(count: int) -> str:
    each = "the first" if count == 1 else f"the first {count}"
    return f"{each} of each landmark"


def _gate_of(log: Log, run: EkfRun, rest: set[int]) -> str:
    """Say by which gate a trace's filter left out rows; "" where no usual gate explains it."""
    rows = np.array(sorted(rest))
    used = np.flatnonzero(run.landmark_index >= 0)
    for distance in distances_of(run, log):
        passed, failed = distance[used], distance[rows]
        if np.isnan(failed).any():
            continue
        low, high = np.nanmax(passed, initial=0.0), failed.min()
        levels = [p for p in _LEVELS if low <= chi2_quantile(p, 2) < high]
        if levels:
            return _gate_words(levels[0])
        if chi2_quantile(_LEVELS[0], 2) < low < high:
            return f"those beyond a gate between {low:.3g} and {high:.3g}"
    return ""


def _gate_words(level: float) -> str:
    return (
        f"those beyond a gate of {chi2_quantile(level, 2):.3g}, the {100 * level:g} % of two "
        "degrees of freedom"
    )


class _Followed(Companion):
    """Notes how far a run came. reached_s: the last time at which it was still near."""

    reached_s = -np.inf

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """All that was measured until this time is fused."""
        super().before_predict(ekf, time_s, control, duration_s)
        self.reached_s = time_s


@dataclass
class _Gated:
    """An association that notes what it rejects, as measurements' own bytes."""

    rule: Association
    rejected: set[bytes]

    def assign(
        self, state: KalmanState, model: MeasurementModel, measurements: Measurements
    ) -> Index:
        """Assign as the rule does."""
        assigned = self.rule.assign(state, model, measurements)
        self.rejected.update(z.tobytes() for z in measurements.z[assigned < 0])
        return assigned


class _Try(NamedTuple):
    """A filter with a rule. near: beside the estimate, None where the run was given up.

    equal_s, reached_s: the last time at which it was equal to rounding, and still near.
    """

    order: str
    first: int
    gate: float
    equal_s: float
    reached_s: float
    near: Likeness | None
    rejected: set[bytes]

    @property
    def rank(self) -> tuple[bool, bool, float, float]:
        """The nearer, the larger."""
        grade = None if self.near is None else self.near.grade
        return grade == "equal", grade is not None, self.equal_s, self.reached_s


def find_left_out(
    given: ExternalEstimate, prepared: Prepared[SolveConfig], sound: Likeness
) -> tuple[LeftOut, Likeness] | None:
    """Return what a filter without a trace left out, and the reference that does so and is like it.

    given: its poses at the reference's times, and no others. sound: what it is most like of what
    leaves nothing out.
    """
    log, label = prepared.log, prepared.log.measurements.landmark
    rows, rules, most = np.zeros(0, dtype=np.intp), list[str](), 0
    if given.landmark_id is not None:
        absent = np.setdiff1d(label[label >= 0], given.landmark_id)
        if most := seldom_measured(label, absent):
            rows = np.flatnonzero(np.isin(label, absent))
    search = _Search(given, prepared, sound, rows)
    best = search.best()
    if best.near is None or best.near.grade is None:
        return None
    if best.first:
        rules.append(_first_words(best.first))
    if len(rows) and most > best.first:
        rules.append(f"those of landmarks with fewer than {most + 1} measurements")
    if best.gate:
        rules.append(_gate_words(best.gate))
    left = np.union1d(rows, first_rows(label, best.first))
    z = np.column_stack((log.measurements.range_m, log.measurements.bearing_rad))
    beyond = [k for k, measurement in enumerate(z) if measurement.tobytes() in best.rejected]
    left = np.union1d(left, np.array(beyond, dtype=np.intp))
    left = left[label[left] >= 0].astype(np.intp)
    return (LeftOut(left, " and ".join(rules)), best.near) if len(left) else None


@dataclass
class _Search:
    """Runs of filters that leave something out, beside an estimate. rows: left out in any case."""

    given: ExternalEstimate
    prepared: Prepared[SolveConfig]
    sound: Likeness
    rows: Index

    def best(self) -> _Try:
        """Return the nearest, by order of updates and first measurements, and then by gate."""
        tries = sorted(self._firsts(), key=lambda attempt: attempt.rank, reverse=True)
        best = tries[0]
        farthest_s = max(attempt.reached_s for attempt in tries)
        for attempt in () if best.rank[1] else tries:
            if attempt is tries[0] or attempt.reached_s == farthest_s:
                best = max([best, *self._gates(attempt)], key=lambda gated: gated.rank)
            if best.rank[1]:
                break
        return best

    def _firsts(self) -> Iterator[_Try]:
        for first in range(_MOST_FIRST):
            for order in _ORDERS:
                yield (attempt := self._run(order, first, 0.0))
                if attempt.rank[0]:
                    return

    def _gates(self, best: _Try) -> Iterator[_Try]:
        for level in _LEVELS[::-1]:
            yield (attempt := self._run(best.order, best.first, level))
            if attempt.rank[0]:
                return

    def _run(self, order: str, first: int, gate: float) -> _Try:
        """Run a filter of an order of updates until it leaves the estimate."""
        given, prepared, rejected = self.given, self.prepared, set[bytes]()
        left = np.union1d(self.rows, first_rows(prepared.log.measurements.landmark, first))
        limit = float(chi2_quantile(gate, 2)) if gate else None
        log = without(prepared.log, left.astype(np.intp), limit)
        between = part_of_step(log)
        beside = _Followed(given, self.sound, _SHARE, LIKE_SIGMA, between)

        def started(ekf: Ekf) -> Companion:
            ekf.association = _Gated(ekf.association, rejected)
            return beside

        near = None
        try:
            other = replace(prepared, log=log)
            reference = filter_of(order, _ORDERS[order], other, given.time_s, started)
            if reference is not None:
                near = likeness(given, reference, labelled=True)
        except EstimateLeftError:
            pass
        return _Try(order, first, gate, beside.last_s, beside.reached_s, near, rejected)
