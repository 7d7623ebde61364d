"""`slamcheck audit`: what a filter's trace says of its algebra, its consistency and its gains.

The events are gone through once, by two independent solutions: graphslam's least squares over all
of them, and the covariance recursion, which goes on from each snapshot that is wrong, so that every
fault is found where it happens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.audit.consistency import Anchors, EventInnovations, departures
from comparisons.audit.localise import Cause, localise, name_of
from comparisons.audit.replay import (
    ROUNDING,
    Fused,
    Replay,
    apart,
    check_gain,
    covariance_gap,
    units,
)
from comparisons.audit.spurious import Learnt, SpuriousInformation
from comparisons.innovations import SensorInnovations
from comparisons.statistics import Averaged, averaged, faults
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
from comparisons.trace.reader import Trace, TraceCounts
from graphslam.arrays import Marginal
from graphslam.event_smoother import EventSmoother

FALSE_ALARMS = 1e-3
"""Share of sound traces that any of the statistical checks calls faulty."""
MOST_SEARCHED = 20
"""Faults of the algebra whose cause is sought; more of other causes are counted."""
MOST_KEPT = 5_000
"""Events since the last snapshot that are kept for this."""
MOST_ANCHORS = 200
LARGEST_ANCHORED = 500
"""Entries of a state whose smoothed marginals are kept on the way."""
_MOST_GAPS = 2_000

Progress = Callable[[str, int, int], None]
Verdict = Literal["sound", "faulty", "nothing checked"]


class Finding(NamedTuple):
    """What the audit found.

    check: algebra, covariance, correction, gain, innovations, smoother, nees or spurious.
    fault: false for what is named, not condemned. text: a sentence. event: where it is first seen,
    or None; sensor and blocks: which it is of.
    """

    check: str
    fault: bool
    text: str
    event: int | None
    sensor: str | None
    blocks: Blocks


class AlgebraGap(NamedTuple):
    """A snapshot against least squares over all events before it.

    sigma: largest difference of the estimate. covariance: largest |lambda - 1| of the pair, or the
    largest asymmetry.
    """

    event: int
    time_s: float | None
    sigma: float
    covariance: float


@dataclass(frozen=True, kw_only=True)
class Audit:
    """What an audit found, and the figures that it rests on.

    Attributes:
        trace: The file.
        counts: Its events, updates and snapshots.
        remarks: On the file.
        blocks: Dimensions of all blocks that there ever were, by name.
        tolerance: What rounding explains, in standard deviations.
        findings: Faults first, each kind in the order of time.
        gaps: Snapshots against least squares, evenly thinned where there are many.
        largest: The largest gap of all snapshots.
        first_open: The first that is more than the tolerance.
        agreement: Largest difference of the two solutions, in sigmas, up to the first fault.
        compared: How many snapshots were compared, those of the prior apart.
        gains: How many gains and corrections were compared with Kalman's.
        sensors: Innovations by sensor.
        smoother: Filter against smoother.
        nees: Errors against the recorded truth; None without.
        spurious: What was learnt of directions that sensors cannot tell; None where none are
            recorded.
    """

    trace: Path
    counts: TraceCounts
    remarks: tuple[str, ...]
    blocks: Mapping[str, int]
    tolerance: float
    findings: tuple[Finding, ...]
    gaps: tuple[AlgebraGap, ...]
    largest: AlgebraGap | None
    first_open: AlgebraGap | None
    agreement: float
    compared: int
    gains: int
    sensors: tuple[SensorInnovations, ...]
    smoother: Averaged | None
    nees: Averaged | None
    spurious: Learnt | None

    @property
    def verdict(self) -> Verdict:
        """Without a snapshot, gain or correction no algebra was checked."""
        if any(one.fault for one in self.findings):
            return "faulty"
        return "sound" if self.compared or self.gains else "nothing checked"

    @property
    def sound(self) -> bool:
        """The algebra was checked, and no finding is a fault."""
        return self.verdict == "sound"


def audit(path: str | Path, tolerance: float = ROUNDING, progress: Progress | None = None) -> Audit:
    """Audit a trace.

    Args:
        path: Of the trace, as a recorder has written it.
        tolerance: Largest difference of covariances and estimates that rounding explains, in
            standard deviations; more for filters in single precision.
        progress: Called with the stage, how many events are done, and of how many.

    Raises:
        InputError: The file is no trace, is damaged, or an event cannot be what it says.
    """
    trace = Trace(Path(path))
    return _Pass(trace, tolerance).run(progress or (lambda stage, done, of: None))


class _Pass:
    """One way through the events."""

    def __init__(self, trace: Trace, tolerance: float) -> None:
        self.trace, self.tolerance = trace, tolerance
        self.replay: Replay
        self.smoother: EventSmoother
        self.innovations = EventInnovations(trace.sensors)
        self.anchors = Anchors()
        self.nees: list[tuple[int, float, int]] = []
        self.blocks: dict[str, int] = {}
        self.gaps: list[AlgebraGap] = []
        self.largest: AlgebraGap | None = None
        self.first_open: AlgebraGap | None = None
        self.agreement, self.gains, self.searched, self.snapshots = 0.0, 0, 0, 0
        self.acted, self.compared = False, 0
        self.known: set[str] = set()
        self.sound = self.optimal = True
        self.broken: set[str] = set()
        self.found: dict[str, tuple[Finding, int]] = {}
        self.pending: list[Finding] = []
        self.start: Replay | None = None
        self.spurious: SpuriousInformation | None = None
        self.kept: list[Event] = []
        self.every = max(1, trace.counts.snapshots // MOST_ANCHORS)
        self.each_gap = max(1, trace.counts.snapshots // _MOST_GAPS)

    def run(self, progress: Progress) -> Audit:
        """Go through all events and judge."""
        total = self.trace.counts.events
        for event in self.trace:
            if event.number % 1000 == 0:
                progress("events", event.number, total)
            self._do(event)
        self._confirm(None)
        sensors = self.innovations.figures()
        level = FALSE_ALARMS / (len(sensors) + 2)
        smoother = self.anchors.against_smoother()
        nees = self._nees()
        spurious = None if self.spurious is None else self.spurious.result()
        self._name_spurious(spurious)
        for figures in sensors:
            self._judge_innovations(figures, level)
        self._judge_average("smoother", "filter minus smoother", smoother, level)
        self._judge_average("nees", "NEES per degree of freedom", nees, level)
        return Audit(
            trace=self.trace.path,
            counts=self.trace.counts,
            remarks=self.trace.remarks,
            blocks=self.blocks,
            tolerance=self.tolerance,
            findings=self._ordered(),
            gaps=tuple(self.gaps),
            largest=self.largest,
            first_open=self.first_open,
            agreement=self.agreement,
            compared=self.compared,
            gains=self.gains,
            sensors=sensors,
            smoother=smoother,
            nees=nees,
            spurious=spurious,
        )

    def _do(self, event: Event) -> None:
        """Let both solutions do an event."""
        match event:
            case Prior():
                self.blocks = dict(zip(event.blocks, event.dims, strict=True))
                self.replay = Replay(event)
                self.smoother = EventSmoother(event.blocks, event.dims, event.covariance)
                self._restart()
                return
            case Snapshot():
                self._snapshot(event)
                return
            case Directions():
                self.spurious = SpuriousInformation(event, self.replay)
                return
        self.acted = True
        if self.spurious is not None:
            self.spurious.take(event)
        if self.start is not None:
            self.kept.append(event)
            if len(self.kept) > MOST_KEPT:
                self.start = None
        if isinstance(event, Update):
            self._update(event)
        else:
            self._solve(event)
            self.replay.apply(event)

    def _solve(self, event: Predict | Reset | Augment | Clone | Remove) -> None:
        """Let least squares do an event that is no measurement."""
        match event:
            case Predict():
                self.smoother.predict(event.blocks, event.jacobian, event.noise)
            case Reset():
                self.smoother.predict(event.blocks, event.jacobian, None)
            case Augment():
                g = event.noise_jacobian
                noise = g @ event.noise @ g.T
                self.smoother.augment(event.name, event.blocks, event.jacobian, noise)
                self.blocks[event.name] = len(event.jacobian)
                self.innovations.begin(event)
            case Clone():
                self.smoother.clone(event.source, event.name)
                self.blocks[event.name] = self.blocks[event.source]
            case Remove():
                self.smoother.remove(event.blocks)

    def _update(self, event: Update) -> None:
        fused = self.replay.update(event)
        self.innovations.add(event, fused, self.replay.layout)
        if not event.used:
            return
        self.smoother.measure(event.blocks, event.jacobian, event.noise, event.residual)
        self.smoother.correct(fused.applied)
        if event.gain is not None or event.correction is not None:
            self._gain(event, fused)

    def _gain(self, event: Update, fused: Fused) -> None:
        self.gains += 1
        sigma: Array = np.sqrt(np.maximum(self.replay.covariance.diagonal(), 0.0))
        layout = self.replay.layout
        for one in check_gain(event, fused, sigma, layout, self.tolerance):
            text = f"{name_of(event)} {one.what}"
            check = "correction" if one.fault else "gain"
            self.pending.append(
                Finding(check, one.fault, text, event.number, event.sensor, one.blocks)
            )

    def _snapshot(self, snapshot: Snapshot) -> None:
        """Compare a snapshot with both solutions."""
        self.snapshots += 1
        self.compared += self.acted
        marginal = self.smoother.marginal()
        at = self.replay.layout.columns(snapshot.blocks)
        recorded, right = snapshot.covariance, self.replay.covariance[at][:, at]
        self._covariance(snapshot)
        self._gap(snapshot, marginal, at)
        scaled = apart(recorded, right)
        wrong = not float(scaled.max()) <= self.tolerance
        whole = len(recorded) == self.replay.layout.size and isinstance(at, slice)
        if wrong and not (not whole and self.broken >= set(snapshot.blocks)):
            self._localise(snapshot)
        else:
            self._confirm(None)
        if wrong:
            self.sound = False
            self.broken = set() if whole else self.broken | set(snapshot.blocks)
            if whole:
                self.replay.covariance = 0.5 * (recorded + recorded.T)
        if self.sound and self.optimal:
            self._compare(marginal)
        if snapshot.error is not None:
            self._error(snapshot, snapshot.error)
        if self.snapshots % self.every == 0 and len(marginal.mean) <= LARGEST_ANCHORED:
            self.anchors.add(snapshot.number, marginal, self.smoother.anchor())
        if whole or self.start is not None:
            self._restart()

    def _restart(self) -> None:
        """Begin an interval between snapshots."""
        self.start, self.kept = self.replay.copy(), []

    def _covariance(self, snapshot: Snapshot) -> None:
        """Symmetry and definiteness; a covariance may be singular, as of a clone."""
        p = snapshot.covariance
        unit = units(p, p)
        scaled = p / np.outer(unit, unit)
        skew = float(np.abs(scaled - scaled.T).max())
        least = float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])
        for bad, what in (
            (skew > self.tolerance, f"is asymmetric, by {skew:.2g} of its sigmas"),
            (least < -self.tolerance, f"is not positive semidefinite (least {least:.2g})"),
        ):
            if bad:
                text = f"the covariance at event {snapshot.number} {what}"
                self._add(Finding("covariance", True, text, snapshot.number, None, ()), what[:12])

    def _gap(self, snapshot: Snapshot, marginal: Marginal, at: slice | Index) -> None:
        """Compare with least squares over all events."""
        covariance = marginal.covariance[at][:, at]
        sigma = units(snapshot.covariance, covariance)
        # The error's mean is what the estimate is off by.
        off = float((np.abs(marginal.mean[at]) / sigma).max())
        spread = covariance_gap(snapshot.covariance, covariance)
        gap = AlgebraGap(snapshot.number, snapshot.time_s, off, spread)
        if self.snapshots % self.each_gap == 0:
            self.gaps.append(gap)
        if self.largest is None or max(off, spread) > max(self.largest[2:]):
            self.largest = gap
        if self.first_open is None and not max(off, spread) <= self.tolerance:
            self.first_open = gap

    def _compare(self, marginal: Marginal) -> None:
        """Note how far the two solutions are apart."""
        scaled = apart(self.replay.covariance, marginal.covariance)
        self.agreement = max(self.agreement, float(scaled.max()))

    def _localise(self, snapshot: Snapshot) -> None:
        """Say where and how a snapshot became wrong."""
        if self.start is None or self.searched > MOST_SEARCHED:
            self.pending = []
            text = f"the covariance at event {snapshot.number} is not that of the events before it"
            self._add(Finding("algebra", True, text, snapshot.number, None, ()), "unknown")
            return
        cause = localise(self.start, self.kept, snapshot, self.tolerance, self.known)
        if cause.what not in self.known:
            self.searched += 1
        if cause.known:
            self.known.add(cause.what)
        finding = self._finding(cause, snapshot)
        if cause.event is None and self.pending:
            first = self.pending[0]
            finding = finding._replace(event=first.event, sensor=first.sensor)
        self._confirm(finding.event)
        self._add(finding, cause.what if cause.known else "unknown")

    def _finding(self, cause: Cause, snapshot: Snapshot) -> Finding:
        check = "gain" if cause.sound else "algebra"
        event = cause.event
        if event is None:
            first, last = self.kept[0].number, snapshot.number
            text = f"between events {first} and {last}, {cause.what}"
            return Finding(check, True, text, first, None, cause.blocks)
        sensor = event.sensor if isinstance(event, Update) else None
        tail = ", as at later ones of its kind" if cause.repeated and not cause.sound else ""
        text = f"{name_of(event)}: {cause.what}{tail}"
        return Finding(check, not cause.sound, text, event.number, sensor, cause.blocks)

    def _confirm(self, until: int | None) -> None:
        """Accept what gains were found unlike, up to an event that made the covariance wrong."""
        for finding in self.pending:
            assert finding.event is not None  # noqa: S101 - gains are of updates
            if until is None or finding.event <= until:
                self.optimal = self.optimal and finding.fault
                key = finding.text.split(" ", 2)[2] if finding.sensor else finding.text
                self._add(finding, key)
        self.pending = []

    def _add(self, finding: Finding, kind: str) -> None:
        """Keep the first finding of a kind, and count the others."""
        key = f"{finding.check}|{finding.sensor}|{kind}"
        first, count = self.found.get(key, (finding, 0))
        self.found[key] = first, count + 1

    def _error(self, snapshot: Snapshot, error: Array) -> None:
        """Note the error squared, in units of the recorded covariance."""
        p = snapshot.covariance
        if faults(p[None])[0] == "":
            squared = float(error @ np.linalg.solve(p, error))
            self.nees.append((snapshot.number, squared, len(error)))

    def _nees(self) -> Averaged | None:
        if not self.nees:
            return None
        event, squared, dof = (np.array(column) for column in zip(*self.nees, strict=True))
        return averaged(squared, dof, event)

    def _judge_innovations(self, figures: SensorInnovations, level: float) -> None:
        name = figures.sensor
        if figures.unusable:
            text = f"sensor `{name}`: {figures.unusable:,} innovations have no valid covariance"
            self._add(Finding("innovations", True, text, None, name, ()), "unusable")
        for one in departures(figures, level):
            text = f"sensor `{name}`: {one.what} (p = {one.p_value:.1g})"
            if not self.optimal:
                text += "; its bands are those of Kalman's gain"
            finding = Finding("innovations", self.optimal, text, one.event, name, ())
            self._add(finding, one.what)

    def _judge_average(self, check: str, what: str, found: Averaged | None, level: float) -> None:
        if found is not None and found.p_value < level:
            low, high = found.band
            text = f"{what} is {found.mean:.3g}, expected {low:.3g} to {high:.3g}"
            fault = check == "nees" or self.optimal
            self._add(Finding(check, fault, text, found.worst, None, ()), what)

    def _name_spurious(self, found: Learnt | None) -> None:
        """Name what was learnt of directions that the sensors cannot tell; no error of algebra."""
        for one in () if found is None else found.directions:
            if one.largest is not None:
                text = (
                    f"the filter has learnt {one.name} to {one.sigma:.3g} {one.unit}".rstrip()
                    + f" from measurements that cannot tell it; most by {one.largest.sensor} at "
                    f"event {one.largest.event}"
                )
                finding = Finding("spurious", False, text, one.largest.event, None, ())
                self._add(finding, one.name)

    def _ordered(self) -> tuple[Finding, ...]:
        """Return findings, faults first, those of one event's algebra before what follows."""
        found = []
        for first, count in self.found.values():
            more = f"; and {count - 1:,} more" if count > 1 else ""
            found.append(first._replace(text=first.text + more))
        rank = {"covariance": 1, "algebra": 0, "correction": 0, "gain": 0}
        last = self.trace.counts.events
        return tuple(
            sorted(
                found,
                key=lambda f: (
                    not f.fault,
                    rank.get(f.check, 2),
                    last if f.event is None else f.event,
                ),
            )
        )
