"""`slamcheck audit`: what a filter's trace says of its algebra, its consistency and its gains.

The events are gone through once, by two independent solutions: graphslam's least squares over all
of them, and the covariance recursion, which goes on from each snapshot that is wrong, so that every
fault is found where it happens.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import PlainSerializer

from comparisons.arrays import Index
from comparisons.audit.algebra import AlgebraCheck, AuditFinding, name_of
from comparisons.audit.consistency import (
    BlockErrors,
    ConsistencyDeparture,
    EventInnovations,
    Smoothed,
    departures,
)
from comparisons.audit.error_curves import BlockErrorCurve, ErrorCurves
from comparisons.audit.estimate_figures import EstimateFigures, EstimateKind, figures_of_steps
from comparisons.audit.explained import ExplainedInnovations, explained_innovations
from comparisons.audit.functions import FunctionCheck, FunctionFigures
from comparisons.audit.least_squares import AnchoredSmoother
from comparisons.audit.replay import BlockLayout, Fused
from comparisons.audit.spurious import Learnt, LearntDirection, SpuriousInformation
from comparisons.audit.states import BlockState, StateHistory
from comparisons.audit.uses import MeasurementUse
from comparisons.covariances import covariance_gap, entry_differences, units
from comparisons.errors import InputError
from comparisons.explain.recorded_steps import steps_of
from comparisons.figures import Aside, Figure, package_versions
from comparisons.innovations import SensorInnovations
from comparisons.rounding import ROUNDING, SINGULAR
from comparisons.statistics import Averaged
from comparisons.trace.events import (
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
from comparisons.trace.reader import TraceReader
from graphslam.arrays import Marginal

FALSE_ALARMS = 1e-3
"""Share of sound traces that any of the statistical checks calls faulty."""
MOST_ANCHORS = 200
_MOST_GAPS = 2_000
_FIRST = float("inf")
"""What explains all that innovations show goes before them."""
_CONSEQUENCE = 0.5
"""What innovations show explains other figures: these go first only where they show far more."""

Progress = Callable[[str, int, int], None]
Verdict = Literal["sound", "faulty", "nothing checked"]


@dataclass(frozen=True)
class AlgebraGap:
    """A snapshot against least squares over all events before it.

    Attributes:
        event: number of the snapshot.
        time_s: its time, if recorded.
        sigma: largest difference of the estimate, in standard deviations.
        covariance: largest relative difference along any direction, or the largest asymmetry.
    """

    event: int
    time_s: float | None
    sigma: Figure
    covariance: Figure

    @property
    def worst(self) -> float:
        """The larger of both."""
        return max(self.sigma, self.covariance)


@dataclass(frozen=True, kw_only=True)
class Audit:
    """What an audit found, and the figures that it rests on.

    Attributes:
        trace: the file; of it a result file has the name.
        events: how many.
        updates: of them.
        snapshots: of them.
        remarks: on the file.
        blocks: dimensions of all blocks that there ever were, by name; in a result file at most
            200.
        tolerance: largest difference that counts as rounding, in standard deviations.
        verdict: `sound`, `faulty` or `nothing checked`: no snapshot, gain or correction.
        findings: faults first: of the algebra in the order of time, then what is rarest; what is
            slight last.
        largest_gap: the snapshot that is farthest from least squares.
        first_open: the first that is farther than the tolerance.
        gaps: of snapshots, evenly thinned where there are many.
        oracle_agreement: largest difference of the two solutions, in standard deviations, up to the
            first fault.
        gains_compared: how many gains and corrections were compared with Kalman's.
        functions: matrices beside the derivatives of the filter's functions, where it has recorded
            these.
        sensors: innovations by sensor.
        smoother: filter against smoother.
        nees: errors by the recorded truth.
        nees_by_block: the same of each block that the prior has, where it has several.
        spurious: what was learnt of directions that sensors cannot tell, if recorded.
        versions: of packages.
        files: in the folder.
        not_checked: checks without an answer, and what the trace lacks for it.
        learnt: what `spurious` is of, with curves; no part of a result file.
        error_curves: errors of blocks by the recorded truth, of the snapshots of `gaps`; likewise.
        explained: noises and constants that explain the innovations; likewise.
        unsolved: the event from which on nothing is compared with least squares, for its noise is
            no covariance; likewise.
        timed: every update has a time, and times do not fall; likewise.
        states: the blocks with their charts, and when each was there; likewise.
        gains_unlike: how many of the compared are not Kalman's; likewise.
        follows_kalman: all gains are Kalman's, as far as recorded, so that its covariance is that
            of least squares; likewise.
    """

    trace: Annotated[Path, PlainSerializer(lambda path: path.name, str)]
    events: int
    updates: int
    snapshots: int
    remarks: tuple[str, ...]
    blocks: Annotated[Mapping[str, int], PlainSerializer(lambda b: dict(islice(b.items(), 200)))]
    tolerance: float
    verdict: Verdict
    findings: tuple[AuditFinding, ...]
    largest_gap: AlgebraGap | None
    first_open: AlgebraGap | None
    gaps: tuple[AlgebraGap, ...]
    oracle_agreement: float
    gains_compared: int
    functions: tuple[FunctionFigures, ...]
    sensors: tuple[SensorInnovations, ...]
    smoother: Averaged | None
    nees: Averaged | None
    nees_by_block: Mapping[str, Averaged]
    spurious: tuple[LearntDirection, ...] | None
    versions: dict[str, str] = field(default_factory=package_versions)
    files: tuple[str, ...] = ()
    not_checked: dict[str, str] = field(default_factory=dict)
    learnt: Aside[Learnt | None]
    error_curves: Aside[tuple[BlockErrorCurve, ...]]
    explained: Aside[ExplainedInnovations | None]
    unsolved: Aside[int | None]
    timed: Aside[bool]
    states: Aside[tuple[BlockState, ...]]
    gains_unlike: Aside[int]
    follows_kalman: Aside[bool]

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
        InputError: The file is no trace, is damaged, or an event cannot be what it says; or the
            tolerance is none.
    """
    if not 0.0 <= tolerance < math.inf:
        raise InputError(f"tolerance is {tolerance}, expected a finite number of 0 or more")
    trace = TraceReader(Path(path))
    with np.errstate(all="ignore"):  # a filter that has broken down may overflow anything
        return _Pass(trace, tolerance).run(progress or (lambda stage, done, of: None))


class _Pass:
    """One way through the events."""

    def __init__(self, trace: TraceReader, tolerance: float) -> None:
        self.trace, self.tolerance = trace, tolerance
        self.unsolved: int | None = None
        self.algebra = AlgebraCheck(tolerance)
        self.smoother: AnchoredSmoother
        self.innovations = EventInnovations(trace.sensors)
        self.uses = MeasurementUse(trace.sensors)
        self.functions, self.as_functions = FunctionCheck(trace.sensors, tolerance), True
        self.prior: TracePrior
        self.errors: BlockErrors
        self.error_curves: ErrorCurves
        self.states = StateHistory()
        self.gaps: list[AlgebraGap] = []
        self.largest: AlgebraGap | None = None
        self.first_open: AlgebraGap | None = None
        self.agreement, self.snapshots = 0.0, 0
        self.acted, self.compared = False, 0
        self.timed, self.last_s = trace.counts.updates > 0, -math.inf
        self.spurious: SpuriousInformation | None = None
        self.every = max(1, trace.counts.snapshots // MOST_ANCHORS)
        self.each_gap = max(1, trace.counts.snapshots // _MOST_GAPS)

    def run(self, progress: Progress) -> Audit:
        """Go through all events and judge."""
        total = self.trace.counts.events
        for event in self.trace:
            if event.number % 1000 == 0:
                progress("events", event.number, total)
            self._date(event)
            self._do(event)
            self.states.take(event)
        self.algebra.end()
        self._judge_functions()
        sensors = self.innovations.figures()
        level = FALSE_ALARMS / (len(sensors) + 3)
        figures = self._figures()
        spurious = None if self.spurious is None else self.spurious.result()
        self._name_spurious(spurious)
        for name, departure in self.innovations.turned():
            text = f"sensor `{name}`: {departure.what}"
            finding = AuditFinding("innovations", True, text, departure.event, sensor=name)
            self.algebra.add(finding, departure.what, departure.weight)
        departing = [departures(one, level) for one in sensors]
        of_estimate = figures.departures(level)
        explained, consequences = self._explain(departing, of_estimate, level)
        cause = explained.name if explained is not None and explained.fits else ""
        for sensor, found in zip(sensors, departing, strict=True):
            self._judge_innovations(sensor, found, cause)
        for kind, those in of_estimate.items():
            self._judge_estimate(kind, those, cause if kind in consequences else "")
        findings = tuple(
            replace(finding, time_s=self.states.time_s(finding.event))
            for finding in self.algebra.findings()
        )
        checked = self.compared or self.algebra.gains or self.functions.compared
        verdict: Verdict = "sound" if checked else "nothing checked"
        return Audit(
            trace=self.trace.path,
            **self.trace.counts._asdict(),
            remarks=(*self.trace.remarks, *self._unsolved()),
            blocks={block.name: block.dims for block in self.states.blocks},
            tolerance=self.tolerance,
            verdict="faulty" if any(one.fault for one in findings) else verdict,
            findings=findings,
            largest_gap=self.largest,
            first_open=self.first_open,
            gaps=tuple(self.gaps),
            oracle_agreement=self.agreement,
            gains_compared=self.algebra.gains,
            gains_unlike=self.algebra.unlike,
            follows_kalman=self.algebra.optimal,
            functions=self.functions.figures(),
            sensors=sensors,
            smoother=figures.smoothed.averaged,
            nees=figures.nees.get(""),
            nees_by_block={name: nees for name, nees in figures.nees.items() if name},
            spurious=None if spurious is None else spurious.directions,
            learnt=spurious,
            error_curves=self.error_curves.curves(),
            explained=explained,
            unsolved=self.unsolved,
            timed=self.timed,
            states=self.states.blocks,
        )

    def _date(self, event: Event) -> None:
        """Note whether an update has no time, or time falls."""
        if event.time_s is None:
            self.timed &= not isinstance(event, Update)
            return
        self.timed &= event.time_s >= self.last_s
        self.last_s = event.time_s

    def _do(self, event: Event) -> None:
        """Let both solutions do an event; least squares end at a noise that is no covariance."""
        unsound = self.trace.unsound.get(event.number, "")
        if unsound and self.unsolved is None:
            self.unsolved = event.number
        match event:
            case Predict() | Update() | Reset() | Augment() | Clone() | Remove():
                self.acted = True
                if self.spurious is not None and self.unsolved is None:
                    self.spurious.take(event)
                fused = self.algebra.take(event, unsound)
                self._evaluate(event, fused)
                self._follow(event, fused)
                self._judge_use(event, fused)
                if self.unsolved is None:
                    self.smoother.take(event, fused)
            case Evaluation():
                self._evaluate(event, None)
            case Snapshot():
                self._snapshot(event)
            case TracePrior():
                self.prior = event
                layout = BlockLayout(event.blocks, event.dims)
                self.errors, self.error_curves = BlockErrors(layout), ErrorCurves(layout)
                self.algebra.take(event, unsound)
                self._evaluate(event, None)
                if not unsound:
                    self.smoother = AnchoredSmoother(event)
            case Directions() if self.unsolved is None:
                self.spurious = SpuriousInformation(event, self.algebra.replay)

    def _follow(self, event: Event, fused: Fused | None) -> None:
        """Keep innovations. fused: what the recursion made of an update."""
        match event:
            case Update() if fused is not None:
                self.innovations.add(event, fused, self.algebra.replay.layout)
            case Augment():
                self.innovations.begin(event)
            case _:
                pass

    def _evaluate(self, event: Event, fused: Fused | None) -> None:
        """Compare with functions of the filter. fused: what the recursion made of an update."""
        algebra = self.algebra
        before = algebra.before if algebra.known else None
        spread = None if fused is None else fused.spread
        self.functions.take(event, before, spread, algebra.replay)

    def _judge_functions(self) -> None:
        """Name what is not as the filter's functions say: the innovations follow from it."""
        for difference in self.functions.differences():
            finding = AuditFinding(
                "derivatives",
                difference.fault,
                difference.what,
                difference.event,
                sensor=difference.sensor,
                blocks=difference.blocks,
            )
            self.algebra.add(finding, difference.what)
            self.as_functions &= not difference.fault

    def _judge_use(self, event: Event, fused: Fused | None) -> None:
        """Name what an update contradicts. fused: what the recursion made of it."""
        algebra = self.algebra
        sound = algebra.sound and algebra.known and algebra.optimal
        for contradiction in self.uses.take(event, fused, algebra.replay.layout, sound=sound):
            update = contradiction.update
            text = f"{name_of(update)} {contradiction.what}"
            finding = AuditFinding("use", True, text, update.number, sensor=update.sensor)
            algebra.add(finding, contradiction.kind)

    def _snapshot(self, snapshot: Snapshot) -> None:
        """Compare a snapshot with both solutions."""
        self.snapshots += 1
        self.compared += self.acted
        algebra = self.algebra
        algebra.take(snapshot)
        if snapshot.error is not None:
            layout = algebra.replay.layout
            self.errors.add(snapshot, snapshot.error, layout, is_first=not self.acted)
            if self.snapshots % self.each_gap == 0:
                self.error_curves.add(snapshot, layout)
        if self.unsolved is not None:
            return
        marginal = self.smoother.marginal()
        self._gap(snapshot, marginal, algebra.replay.layout.columns(snapshot.blocks))
        if algebra.sound and algebra.optimal:
            scaled = entry_differences(algebra.replay.covariance, marginal.covariance)
            self.agreement = max(self.agreement, float(np.abs(scaled).max()))
        if self.snapshots % self.every == 0:
            self.smoother.keep(snapshot.number, marginal)

    def _unsolved(self) -> list[str]:
        """What is not compared, after a noise that is no covariance."""
        if self.unsolved is None:
            return []
        return [
            f"from event {self.unsolved} on, whose noise is no covariance, nothing is compared "
            "with least squares; the recursion goes on from the next snapshot of the whole state"
        ]

    def _gap(self, snapshot: Snapshot, marginal: Marginal, at: slice | Index) -> None:
        """Compare with least squares over all events."""
        covariance = marginal.covariance[at][:, at]
        sigma = units(snapshot.covariance, covariance)
        # The error's mean is what the estimate is off by.
        off = float((np.abs(marginal.mean[at]) / sigma).max())
        spread = covariance_gap(snapshot.covariance, covariance, sigma, SINGULAR).largest
        gap = AlgebraGap(snapshot.number, snapshot.time_s, off, spread)
        if self.snapshots % self.each_gap == 0:
            self.gaps.append(gap)
        if self.largest is None or gap.worst > self.largest.worst:
            self.largest = gap
        if self.first_open is None and not gap.worst <= self.tolerance:
            self.first_open = gap
            self.algebra.note_precision(snapshot.number, snapshot.covariance)

    def _figures(self) -> EstimateFigures:
        """Return what errors of the estimate come to."""
        known = self.prior.number not in self.trace.unsound
        smoothed = self.smoother.smoothed() if known else Smoothed(None, None)
        nees, errors = self.errors.averages(), self.errors
        return EstimateFigures(self.prior, smoothed, errors, nees, known, self.algebra.sound)

    def _explain(
        self,
        departing: Iterable[Sequence[ConsistencyDeparture]],
        of_estimate: Mapping[EstimateKind, Sequence[ConsistencyDeparture]],
        level: float,
    ) -> tuple[ExplainedInnovations | None, set[EstimateKind]]:
        """Name noises and constants that residuals ask for, where the algebra is sound.

        They are a fault where they explain what is off: all of the innovations, or more.

        Args:
            departing: What is off in the innovations, by sensor.
            of_estimate: The same of the estimate, by kind.
            level: Of a sound filter.

        Returns:
            What explains the innovations, and the kinds of what is off that it explains as well.
        """
        algebra = self.algebra
        if not (algebra.sound and algebra.known and algebra.optimal and self.as_functions):
            return None, set()
        off = {kind for kind, those in of_estimate.items() if those}
        is_off = any(each.fault for those in departing for each in those)
        sensors = self.trace.sensors
        explained = explained_innovations(self.trace, sensors, level, is_off=is_off or bool(off))
        if explained is None:
            return None, set()
        consequences: set[EstimateKind] = set()
        if off and explained.fits:
            again = figures_of_steps(explained.taken_in(steps_of(self.trace)), self.every)
            consequences = off - {kind for kind, left in again.departures(level).items() if left}
        is_fault = explained.fits and (bool(consequences) or is_off)
        finding = AuditFinding(
            "innovations", is_fault, explained.what, None, sensor=explained.sensor
        )
        algebra.add(finding, explained.what, _FIRST if is_fault else 0.0)
        return explained, consequences

    def _judge_innovations(
        self, figures: SensorInnovations, found: Sequence[ConsistencyDeparture], cause: str
    ) -> None:
        """Name what departs of a sensor. cause: what explains all of it, if anything does."""
        name = figures.sensor
        if figures.unusable:
            text = f"sensor `{name}`: {figures.unusable:,} innovations have no valid covariance"
            self.algebra.add(AuditFinding("innovations", True, text, None, sensor=name), "unusable")
        # A sensor's go together.
        weight = max((departure.weight for departure in found), default=0.0)
        for departure in found:
            text = f"sensor `{name}`: {departure.what} (p = {departure.p_value:.1g})"
            if not self.algebra.optimal:
                text += "; its bands are those of Kalman's gain"
            text += f", explained by {cause}" if cause else ""
            fault = self.algebra.optimal and departure.fault and not cause
            finding = AuditFinding("innovations", fault, text, departure.event, sensor=name)
            self.algebra.add(finding, departure.what, weight)

    def _judge_estimate(
        self, kind: EstimateKind, those: Sequence[ConsistencyDeparture], cause: str
    ) -> None:
        """Name what departs of the estimate. cause: what explains all of it, if anything does."""
        for departure in those:
            text = departure.what + (f", explained by {cause}" if cause else "")
            fault = (kind == "nees" or self.algebra.optimal) and not cause
            check = "smoother" if kind == "smoother" else "nees"
            finding = AuditFinding(check, fault, text, departure.event)
            self.algebra.add(finding, departure.what, _CONSEQUENCE * departure.weight)

    def _name_spurious(self, information: Learnt | None) -> None:
        """Name what was learnt of directions that the sensors cannot tell; no error of algebra."""
        for one in () if information is None else information.directions:
            if one.largest is not None:
                text = (
                    f"the filter claims {one.name} to {one.sigma:.3g} {one.unit}".rstrip()
                    + ", which no measurement observes; the largest single gain is with "
                    f"{one.largest.sensor} at event {one.largest.event}"
                )
                finding = AuditFinding("spurious", False, text, one.largest.event)
                self.algebra.add(finding, one.name)
