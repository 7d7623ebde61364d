"""The gaps of someone else's filter, from the trace that it left: as for the reference EKF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.motion import CLOCK_S
from comparisons.adapters.smoother_input import recorded_system_of
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.audit.consistency import event_innovations
from comparisons.audit.own_filter import residuals_at_points, run_events
from comparisons.checks.agreement import Agreement, Gap, GapFigures, Gaussian, gap_figures
from comparisons.checks.algebra import HINT
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.check import Answers
from comparisons.checks.diagnosis.data_usage import DataFault, untimely
from comparisons.checks.diagnosis.departure import Departure, departure_from, model_departure
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.checks.diagnosis.model_differences import (
    ModelDifference,
    model_differences,
    sensor_differences,
)
from comparisons.checks.diagnosis.sensor_records import recorded_sensors
from comparisons.checks.diagnosis.single_precision import (
    allowed_gap,
    allowed_of_estimate,
    computed_in_single,
    restored_traces,
)
from comparisons.checks.diagnosis.trace_recursion import LinearReplay, replay, turned_as_corrected
from comparisons.checks.registry import OF_FILTER
from comparisons.checks.verdict import Verdict, judge
from comparisons.config import SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.planar_trace import TraceFile
from comparisons.estimates.reference import Reference
from comparisons.figures import Aside, Same
from comparisons.innovations import InnovationFigures, SensorInnovations
from comparisons.logs.log import Log, Positions
from comparisons.logs.stamps import at_instants, resolved
from comparisons.pipeline.clock import Clock, no_progress
from comparisons.pipeline.gaps import Gaps, Optimum, compute_gaps, optimum_of
from comparisons.pipeline.known import Known
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.records import FilterRecords
from comparisons.rounding import FACTOR, OPERATIONS, Allowed, stored_rounding
from comparisons.trace.events import Snapshot
from comparisons.trace.reader import TraceReader
from ekf_reference.core.ekf import PoseReading
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.measurements import REJECTED
from ekf_reference.core.trace import TraceArrays
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherOptions

_ROUNDED = 1e-9
"""Difference of a pose, relative to it or to one, that is rounding."""
_RECORD = f"{HINT}; record a snapshot after each event and the faulty one is named"


_SURE_TURN_RAD = 1.5
"""Corrections that turn a heading by more may be of more than half a turn, as a wrong residual's
are: how many turns a recorded heading is off then follows from the corrections."""


@dataclass(frozen=True, kw_only=True)
class TraceCheck(GapFigures):
    """The recorded equations of an external filter; gaps as in `result.json`.

    Attributes:
        steps: predictions.
        updates: updates.
        initialised: initialised landmarks.
        positions: absolute positions.
        innovations: by sensor, whitened by the recorded equations.
        known: of the filter that left it; no part of a result file, as what follows.
        algebra: None where the estimate lacks the joint covariance.
        verdict: with causes.
        own: what the trace's own equations lead to, at the log's epochs; None where a cause speaks
            against them.
        departure: where the trace first leaves the log's models, or the estimate the trace's
            equations; None where neither does.
        sensors: its innovations.
    """

    steps: int
    updates: int
    initialised: int
    positions: int
    innovations: Same[list[InnovationFigures]] = field(default_factory=list)
    known: Aside[Known]
    algebra: Aside[Gap | None]
    verdict: Aside[Verdict]
    own: Aside[Reference | None]
    departure: Aside[Departure | None]
    sensors: Aside[tuple[SensorInnovations, ...]]

    @property
    def agreement(self) -> Agreement:
        """The gaps between the filter and the smoother."""
        return self.known.gaps.agreement


def trace_run(given: ExternalEstimate, prepared: Prepared[SolveConfig]) -> tuple[EkfRun, Timeline]:
    """Return an estimate's trace as a run of its filter, and the log's steps beside it.

    Raises InputError for a trace that does not fit the log.
    """
    file, log = _file(given), prepared.log
    if log.known_landmarks is not None:
        raise InputError(f"{log.name}: traces are not checked on logs with known landmarks")
    timeline, theirs = _timelines(file, float(given.time_s[-1]), prepared.timeline)
    run = _as_run(given, file, theirs, prepared.positions)
    return _with_removed(run, file.removed_id), timeline


def _file(given: ExternalEstimate) -> TraceFile:
    if given.trace is None:
        raise ValueError("an estimate without a trace")
    return given.trace


def check_trace(
    given: ExternalEstimate,
    followed: tuple[EkfRun, Timeline],
    prepared: Prepared[SolveConfig],
    options: SmootherOptions,
    solved: Optimum | None = None,
) -> TraceCheck:
    """Compute the gaps as for the reference EKF, and judge them.

    followed: of `trace_run`. solved: S of the whole log, which is that of the trace where its
    filter used the same measurements of the same landmarks. Raises InputError where an equation is
    singular.
    """
    recorded, timeline = followed
    run = _at_points(recorded)
    file, log, positions = _file(given), prepared.log, prepared.positions
    known = given.joint_covariance is not None
    clock = Clock()
    again = optimum_of(run, options, clock, no_progress)

    def optimum(problem: SlamProblem, time_s: Array) -> Optimum:
        if solved is None or not solved[0].problem.same_as(problem):
            return again(problem, time_s)
        ids, names = run.estimate.landmark_id, run.estimate.labels
        return solved[0], replace(solved[1], landmark_id=ids, labels=names)

    try:
        gaps = compute_gaps(
            log, run, optimum, clock, no_progress, timeline=timeline, covariance_known=known
        )
        kind = SingleRecords if file.rounding else TraceRecords
        records = kind(gaps, file, positions, run.timeline is timeline)
        limits = records.algebra.sigma, records.model.sigma
    except np.linalg.LinAlgError:
        raise InputError(
            f"{file.path}: a covariance that its equations need is singular to rounding"
        ) from None
    before = Known(
        prepared=prepared,
        solved=(gaps.result, gaps.smoothed),
        landmark_index=run.landmark_index,
        timeline=run.timeline,
        positions=positions,
        run=run,
        kept=records,
    )
    found = Answers(before, OF_FILTER).known
    verdict, agreement, trace = judge(found), gaps.agreement, run.trace
    algebra = agreement.algebra if known else None
    causes, held = {cause.gap for cause in verdict.causes}, len(_last(given).landmark)
    sensors = event_innovations(run_events(recorded), run.sensors)
    return TraceCheck(
        known=found,
        sensors=sensors,
        own=_own_equations(run, held) if known and causes.isdisjoint(FILTER_FAULTS) else None,
        departure=_departure(given, found, causes),
        algebra=algebra,
        verdict=verdict,
        **gap_figures(algebra, agreement.model, agreement.linearisation),
        algebra_limit_sigma=limits[0],
        model_limit_sigma=limits[1],
        steps=len(trace.departed),
        updates=len(trace.measurements[POINT].step),
        initialised=len(trace.initialisations[POINT].step),
        positions=len(trace.positions.step),
        innovations=list(sensors),
    )


def _departure(given: ExternalEstimate, known: Known, causes: set[str]) -> Departure | None:
    """Where first the trace leaves the models, or the estimate what the trace leads to."""
    log, run, departures = known.prepared.log, known.ekf, list[Departure | None]()
    if "model" in causes:
        departures.append(model_departure(given, known.records.differences, log))
    if "algebra" in causes:
        with np.errstate(all="ignore"):  # a wrong filter may have broken down
            reference = _own_equations(run, len(run.estimate.landmark))
        departures.append(departure_from(given, [reference], log, run.timeline))
    left = (departure for departure in departures if departure is not None)
    return min(left, key=lambda one: one.time_s, default=None)


def _own_equations(run: EkfRun, landmarks: int) -> Reference:
    """The filter of a trace's equations, as a reference at the epochs.

    landmarks: how many of the map the estimate holds; the filter has removed the others.
    """
    epochs_s, size = run.timeline.epoch_time_s, 3 + POINT.width * landmarks
    again = _replayed(run)
    return Reference(
        name="a filter of its trace's equations",
        time_s=epochs_s,
        known=np.ones(len(epochs_s), dtype=bool),
        pose=again.pose,
        pose_covariance=again.covariance,
        landmark_id=run.estimate.landmark_id[:landmarks],
        landmark=again.last.mean[3:size].reshape(-1, 2),
        joint_covariance=again.last.covariance[:size, :size],
        joint_s=float(epochs_s[-1]),
        span_s=(float(epochs_s[0]), float(epochs_s[-1])),
        labels=run.estimate.labels,
    )


def _replayed(run: EkfRun) -> LinearReplay:
    """The recorded equations, filtered again."""
    landmarks = len(run.estimate.landmark)
    return replay(run.trace, run.timeline.steps_until(), landmarks, np.float64)


@dataclass(frozen=True, repr=False)
class TraceRecords(FilterRecords):
    """Those of somebody else's filter, in double precision. file: the trace. positions: S's.

    same_steps: its steps are the log's.
    """

    unnamed = _RECORD
    file: TraceFile
    positions: Positions | None
    same_steps: bool

    @cached_property
    def algebra(self) -> Allowed:
        """The algebra gap that rounding, and storing, explains."""
        last, allowed = self.gaps.run.estimate, self.gaps.algebra_rounding
        covariance = stored_rounding(last.joint_covariance) > 0.0
        if not (self.file.rounding or covariance):
            return allowed
        stored = allowed_of_estimate(Gaussian.of(last), self._sigma, covariance=covariance)
        return allowed.plus(stored)

    @property
    def _sigma(self) -> Array:
        return np.sqrt(np.diag(self.gaps.smoothed.joint_covariance))

    def known_model_errors(self) -> Sequence[str]:
        """Return known mistakes that reproduce the records."""
        gaps = self.gaps
        return explain(gaps.log, gaps.run, self.file.rounding, same_steps=self.same_steps)

    def operations(self) -> Sequence[str]:
        """Return what the trace's own snapshots, gains and corrections show.

        A snapshot of the end alone shows no more than the gap does.
        """
        file = self.file
        if not file.path.is_file():
            return ()
        from comparisons.audit.algebra import faults_of

        trace = TraceReader(file.path)
        several = trace.counts.snapshots > 1
        events = (one for one in trace if several or not isinstance(one, Snapshot))
        return faults_of(events, self.algebra.largest)

    def untimely(self) -> list[DataFault]:
        """Return observations that are used at another instant than their own."""
        return _untimely(self.gaps.log, self.gaps.run, self.positions)


@dataclass(frozen=True, repr=False)
class SingleRecords(TraceRecords):
    """Those that were stored in single precision; no event is named."""

    unnamed = ""

    @cached_property
    def _from_trace(self) -> Allowed:
        return allowed_gap(self.gaps.solved, self.gaps.run.trace, self._sigma)

    @cached_property
    def algebra(self) -> Allowed:
        """The algebra gap that rounding, and storing, explains."""
        return super().algebra.plus(self._from_trace)

    @cached_property
    def model(self) -> Allowed:
        """The model gap that rounding, and storing, explains."""
        gaps = self.gaps
        tolerance = allowed_gap(gaps.model_solved, gaps.run.trace, self._sigma)
        model = gaps.model_rounding.plus(self._from_trace).plus(tolerance)
        return model.times(OPERATIONS) if self.single else model

    @cached_property
    def single(self) -> str:
        """How the algebra gap grows, if computing in single precision explains it."""
        gap = self.gaps.agreement.algebra
        if gap.explained_by(self.algebra):
            return ""
        return computed_in_single(self.gaps.run, gap, self._sigma)

    @cached_property
    def differences(self) -> Sequence[ModelDifference]:
        """Where the models differ."""
        return self.gaps.model_differences(_stored_differences(self.gaps.run, self.gaps))

    def operations(self) -> Sequence[str]:
        """Return none: rounding of each event may explain it."""
        return ()


def _stored_differences(run: EkfRun, gaps: Gaps) -> dict[tuple[str, str], float]:
    """What storing explains of single relations, by relation and quantity."""
    found: dict[tuple[str, str], float] = {}

    def at_least(relation: str, quantity: str, difference: float) -> None:
        key = relation, quantity
        found[key] = max(found.get(key, 0.0), FACTOR * difference)

    right = gaps.by_steps(gaps.recorded, run.trace)
    kept = recorded_sensors(run.trace)
    for trace in restored_traces(run.trace):
        other = gaps.by_steps(recorded_system_of(replace(run, trace=trace)), trace)
        for one in model_differences(other, right, 0.0, gaps.initialised):
            at_least(one.relation, one.quantity, one.largest)
        for kind, records in recorded_sensors(trace).items():
            for quantity, _, difference, _ in sensor_differences(kind, records, kept[kind]):
                at_least(kind, quantity, float(difference.max(initial=0.0)))
    return found


def _last(given: ExternalEstimate) -> Estimate:
    """What was handed in of the end; a covariance that was not is NaN, and used nowhere."""
    if given.landmark is None or given.landmark_id is None:
        raise ValueError("an estimate without landmarks")
    size, joint = Layout.packed(3, len(given.landmark)).size, given.joint_covariance
    return Estimate(
        time_s=given.time_s[-1:],
        pose=given.pose[-1:],
        pose_covariance=_covariances(given, given.time_s[-1:]),
        landmark_id=given.landmark_id,
        landmark=given.landmark,
        joint_covariance=np.full((size, size), np.nan) if joint is None else joint,
        information="filtered",
        labels=given.labels,
    )


def _timelines(file: TraceFile, last_s: float, timeline: Timeline) -> tuple[Timeline, Timeline]:
    """The log's, with the epochs that the filter stopped at, and the same with its own steps."""
    step_s, epoch_s = _step_times(file, timeline), timeline.epoch_time_s
    if step_s[0] < epoch_s[0]:
        raise InputError(
            f"{file.path}: the first step ends at {step_s[0]:.4f} s, expected no step before the "
            f"start of the log at {epoch_s[0]:.4f} s"
        )
    reached = np.searchsorted(step_s, epoch_s, side="right")
    stops = np.concatenate(([epoch_s[0]], step_s))[reached] == epoch_s
    kept = np.flatnonzero(stops)
    end_s = epoch_s[kept[-1]]
    if reached[kept[-1]] != len(step_s) or len(kept) < 2:
        raise InputError(
            f"{file.path}: the last step ends at {step_s[-1]:.4f} s, expected the time "
            f"of a measurement, or the log's end at {epoch_s[-1]:.4f} s"
        )
    if last_s != end_s:
        raise InputError(
            f"{file.path}: the last step ends at {end_s:.4f} s, the trajectory at "
            f"{last_s:.4f} s; expected the same"
        )
    cut = timeline.prefix(int(kept[-1]) + 1)
    own = replace(
        cut,
        epoch_time_s=epoch_s[kept],
        step_epoch=np.searchsorted(kept, cut.step_epoch),
        measurement_epoch=np.searchsorted(kept, cut.measurement_epoch),
        position_epoch=np.searchsorted(kept, cut.position_epoch),
    )
    if np.array_equal(own.step_end_s, step_s):
        return own, own
    begin_s = np.concatenate((own.epoch_time_s[:1], step_s[:-1]))
    theirs = replace(
        own,
        step_epoch=np.searchsorted(own.epoch_time_s, step_s),
        step_begin_s=begin_s,
        step_duration_s=step_s - begin_s,
        control=np.zeros((len(step_s), 0)),
        control_covariance=np.zeros((len(step_s), 0, 0)),
    )
    return own, theirs


def _step_times(file: TraceFile, timeline: Timeline) -> Array:
    """When each step of a trace ends, as the log's steps do that they are.

    A trace with as many steps as the log has theirs, in their order, if no time contradicts.
    """
    own = timeline.step_end_s[: len(file.step_time_s)]
    found = at_instants(file.step_time_s, timeline.instants_s())
    if len(own) == len(found) and np.abs(own - file.step_time_s).max() <= CLOCK_S:
        return own
    return found


def _as_run(
    given: ExternalEstimate, file: TraceFile, timeline: Timeline, positions: Positions | None
) -> EkfRun:
    """What was handed in, as a run of the reference EKF would be."""
    last = _last(given)
    trace = file.trace
    for what, numbers, count in (
        ("measurement", trace.measurements[POINT].number, len(timeline.measurement_epoch)),
        ("measurement", trace.initialisations[POINT].number, len(timeline.measurement_epoch)),
        ("position", trace.positions.number, len(timeline.position_epoch)),
    ):
        if int(numbers.max(initial=-1)) >= count:
            raise InputError(
                f"{file.path}: uses {what} {numbers.max()}, expected a number below {count}, the "
                "count of them in the log up to the end of the trace"
                + (" (--gps)" if what == "position" else "")
            )
    until = timeline.steps_until()
    pose, final = last.pose[-1].copy(), trace.arrived[-1]
    if _largest_turn(trace) > _SURE_TURN_RAD:
        with np.errstate(all="ignore"):  # a wrong filter may have broken down
            trace, final = turned_as_corrected(trace, len(last.landmark))
    pose[2] += 2.0 * np.pi * np.round((final[2] - pose[2]) / (2.0 * np.pi))
    departed = np.vstack((trace.departed, pose))[until]
    arrived = np.vstack((trace.prior_pose, trace.arrived))[until]
    landmark_index = np.full(len(timeline.measurement_epoch), REJECTED, dtype=np.intp)
    for records in (trace.initialisations[POINT], trace.measurements[POINT]):
        landmark_index[records.number] = records.landmark_index
    return EkfRun(
        estimate=replace(
            last,
            time_s=timeline.epoch_time_s,
            pose=departed,
            pose_covariance=_covariances(given, timeline.epoch_time_s),
        ),
        timeline=timeline,
        trace=trace,
        landmark_index=landmark_index,
        departed=departed,
        arrived=arrived,
        final=PoseReading(pose, pose, np.eye(3)),
        own_axes=False,
        positions=positions,
        fix_number=np.unique(trace.positions.number),
        rejected_fixes=0,
    )


def _with_removed(run: EkfRun, removed_id: tuple[int, ...]) -> EkfRun:
    """Return a run whose estimate has the landmarks, too, that its filter has removed.

    They are what the recorded equations tell of them, given what was handed in of the others.
    """
    if not len(removed_id):
        return run
    e, more = run.estimate, len(removed_id)
    ids = np.append(e.landmark_id, np.array(removed_id, dtype=np.int64))
    unknown = np.concatenate((e.landmark, np.full((more, 2), np.nan)))
    whole = replace(run, estimate=replace(e, landmark_id=ids, landmark=unknown))
    last, size = _replayed(whole).last, 3 + e.landmark.size
    mean = np.concatenate((run.departed[-1], e.landmark.ravel()))
    p, across = last.covariance, last.covariance[size:, :size]
    by = np.linalg.lstsq(p[:size, :size], across.T, rcond=None)[0].T
    place = last.mean[size:] + by @ (mean - last.mean[:size])
    held = e.joint_covariance
    rest = p[size:, size:] - by @ across.T + by @ held @ by.T
    joint = np.block([[held, held @ by.T], [by @ held, 0.5 * (rest + rest.T)]])
    landmark = np.concatenate((e.landmark, place.reshape(-1, 2)))
    estimate = replace(e, landmark_id=ids, landmark=landmark, joint_covariance=joint)
    return replace(run, estimate=estimate)


def _at_points(run: EkfRun) -> EkfRun:
    """Return a run whose residuals are z - h(point), as least squares take them.

    Those of iterated updates are not, which are linearised at another pose than that of arrival.
    """
    trace, used = run.trace, run.trace.measurements[POINT]
    steps, first = np.unique(used.step, return_index=True)
    arrived = np.vstack((trace.prior_pose, trace.arrived))[steps]
    off = np.abs(used.pose[first] - arrived)
    if not (off > _ROUNDED * np.maximum(1.0, np.abs(arrived))).any():
        return run
    records = replace(used, innovation=residuals_at_points(run))
    return replace(run, trace=replace(trace, measurements={**trace.measurements, POINT: records}))


def _largest_turn(trace: TraceArrays) -> float:
    """By how much [rad] corrections at one instant turn a heading, if by less than half a turn."""
    reached = np.concatenate((trace.prior_pose[2:], trace.arrived[:, 2]))
    every = trace.measurements[POINT], trace.initialisations[POINT], trace.positions
    used = (records.pose[:, 2] - reached[records.step] for records in every)
    turns = np.concatenate((trace.departed[:, 2] - reached[:-1], *used))
    return float(np.abs(turns).max())


def _covariances(given: ExternalEstimate, time_s: Array) -> Array:
    """(K, 3, 3) the covariances handed in of poses at times (K,), NaN where there is none."""
    found = np.full((len(time_s), 3, 3), np.nan)
    if given.pose_covariance is not None:
        near = np.minimum(np.searchsorted(given.time_s, time_s), len(given.time_s) - 1)
        there = given.time_s[near] == time_s
        found[there] = given.pose_covariance[near[there]]
    return found


def _untimely(log: Log, run: EkfRun, positions: Positions | None) -> list[DataFault]:
    """Observations fused at another instant than their own, where no step ends there."""
    stands_s = np.concatenate((run.timeline.step_begin_s, run.timeline.epoch_time_s[-1:]))
    trace = run.trace
    points = trace.measurements[POINT], trace.initialisations[POINT]
    step, number = (
        np.concatenate([getattr(r, name) for r in points]) for name in ("step", "number")
    )
    kinds = [("measurements", step, resolved(log.measurements.time_s)[number])]
    if positions is not None:
        fixes = trace.positions
        kinds.append(("positions", fixes.step, resolved(positions.time_s)[fixes.number]))
    return [
        fault
        for kind, step, due_s in kinds
        for fault in untimely(kind, stands_s[step] - due_s, 1e-6, "{:.4g} s")
    ]
