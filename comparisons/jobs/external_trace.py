"""The gaps of someone else's filter, from the trace that it left: as for the reference EKF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.motion import CLOCK_S
from comparisons.adapters.smoother_input import (
    recorded_system_of,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.audit.consistency import event_innovations
from comparisons.audit.own_filter import run_events
from comparisons.audit.spurious import Learnt, learnt
from comparisons.checks.agreement import (
    Agreement,
    Allowed,
    Gap,
    GapFigures,
    Gaussian,
    gap_figures,
)
from comparisons.checks.causes import ALGEBRA_HINT
from comparisons.checks.diagnosis.data_usage import DataFault, data_faults
from comparisons.checks.diagnosis.departure import Departure, departure_from, model_departure
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.checks.diagnosis.model_differences import model_differences
from comparisons.checks.diagnosis.single_precision import (
    FACTOR,
    OPERATIONS,
    allowed_gap,
    allowed_of_estimate,
    computed_in_single,
    replay,
    restored_traces,
)
from comparisons.checks.verdict import Diagnosis, Verdict, judge
from comparisons.config import SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.estimates.stored_precision import stored_rounding
from comparisons.estimates.trace_file import TraceFile
from comparisons.figures import Same
from comparisons.innovations import InnovationFigures, SensorInnovations
from comparisons.logs.log import Log, Positions
from comparisons.logs.stamps import at_instants, resolved
from comparisons.pipeline.clock import Clock, no_progress
from comparisons.pipeline.gaps import Gaps, Optimum, compute_gaps, optimum_of
from comparisons.pipeline.prepared import Prepared
from comparisons.trace.events import Snapshot
from comparisons.trace.reader import Trace
from ekf_reference.core.ekf import PoseReading
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.measurements import REJECTED
from graphslam.problem import SlamProblem
from graphslam.smoother import SmootherOptions

_RECORD = (
    f"{ALGEBRA_HINT}; a snapshot of the covariance, recorded after each event, has the event named"
)
OWN = ("invalid", "data", "algebra", "model")
"""Causes that a filter's trace shows whatever the smoother found."""


@dataclass(frozen=True, kw_only=True)
class TraceFigures(GapFigures):
    """The recorded equations of an external filter; gaps as in `result.json`.

    Attributes:
        steps: predictions.
        updates: updates.
        initialised: initialised landmarks.
        positions: absolute positions.
        innovations: by sensor, whitened by the recorded equations; none of a trace of 0.2, which
            has no events.
    """

    steps: int
    updates: int
    initialised: int
    positions: int
    innovations: Same[list[InnovationFigures]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class TraceCheck(TraceFigures):
    """With causes. algebra: None where the estimate lacks the joint covariance.

    own: what the trace's own equations lead to, at the log's epochs; None where a cause speaks
    against them. departure: where the trace first leaves the log's models, or the estimate the
    trace's equations; None where neither does. run, gaps: of the filter that left it. sensors: its
    innovations.
    """

    run: EkfRun
    gaps: Gaps
    sensors: tuple[SensorInnovations, ...]
    agreement: Agreement
    algebra: Gap | None
    verdict: Verdict
    own: Reference | None
    departure: Departure | None


def trace_run(given: ExternalEstimate, prepared: Prepared[SolveConfig]) -> tuple[EkfRun, Timeline]:
    """Return an estimate's trace as a run of its filter, and the log's steps beside it.

    Raises InputError for a trace that does not fit the log.
    """
    file, log = given.trace, prepared.log
    if file is None:
        raise ValueError("an estimate without a trace")
    if log.known_landmarks is not None:
        raise InputError(f"{log.name}: traces are not checked on logs with known landmarks")
    own, theirs = _timelines(file, float(given.time_s[-1]), prepared.timeline)
    return _as_run(given, file, theirs, prepared.positions), own


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
    run, own = followed
    file, log, positions = given.trace, prepared.log, prepared.positions
    if file is None:
        raise ValueError("an estimate without a trace")
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
            log, run, optimum, clock, no_progress, timeline=own, covariance_known=known
        )
        diagnosis = _diagnosis(log, run, gaps, file, same_steps=run.timeline is own)
    except np.linalg.LinAlgError:
        raise InputError(
            f"{file.path}: a covariance that its equations need is singular to rounding"
        ) from None
    labelled = prepared.labelled
    untimely = _untimely(log, run, positions)
    data_faulty = (
        *untimely,
        *data_faults(log, run, gaps.smoothed, labelled=labelled, timed=not untimely),
    )
    verdict = judge(
        gaps.agreement,
        gaps.result,
        run,
        diagnosis,
        data_faults=data_faulty,
    )
    trace, found = run.trace, gaps.agreement
    algebra = found.algebra if known else None
    right = known and not any(one.gap in OWN for one in verdict.causes)
    left = _departures(given, run, gaps, diagnosis, {one.gap for one in verdict.causes})
    sensors = event_innovations(run_events(run), run.sensors)
    return TraceCheck(
        run=run,
        gaps=gaps,
        sensors=sensors,
        own=_own_equations(run) if right else None,
        departure=min(left, key=lambda one: one.time_s, default=None),
        agreement=found,
        algebra=algebra,
        verdict=verdict,
        **gap_figures(algebra, found.model, found.linearisation),
        algebra_limit_sigma=diagnosis.algebra.sigma,
        model_limit_sigma=diagnosis.model.sigma,
        steps=len(trace.departed),
        updates=len(trace.measurements[POINT].step),
        initialised=len(trace.initialisations[POINT].step),
        positions=len(trace.positions.step),
        innovations=list(sensors),
    )


def _departures(
    given: ExternalEstimate, run: EkfRun, gaps: Gaps, diagnosis: Diagnosis, causes: set[str]
) -> Iterator[Departure]:
    """Where the trace leaves the models, and the estimate what the trace leads to."""
    if "model" in causes:
        found = model_departure(given, diagnosis.differences(), gaps.log)
        if found is not None:
            yield found
    if "algebra" in causes:
        with np.errstate(all="ignore"):  # a wrong filter may have broken down
            own = _own_equations(run)
        found = departure_from(given, [own], gaps.log, run.timeline)
        if found is not None:
            yield found


def _own_equations(run: EkfRun) -> Reference:
    """The filter of a trace's equations, as a reference at the epochs."""
    landmarks, epochs_s = len(run.estimate.landmark), run.timeline.epoch_time_s
    again = replay(run.trace, run.timeline.steps_until(), landmarks, np.float64)
    return Reference(
        name="a filter of its trace's equations",
        time_s=epochs_s,
        known=np.ones(len(epochs_s), dtype=bool),
        pose=again.pose,
        pose_covariance=again.covariance,
        landmark_id=run.estimate.landmark_id,
        landmark=again.last.mean[3:].reshape(-1, 2),
        joint_covariance=again.last.covariance,
        joint_s=float(epochs_s[-1]),
        span_s=(float(epochs_s[0]), float(epochs_s[-1])),
        labels=run.estimate.labels,
    )


def _diagnosis(
    log: Log, run: EkfRun, gaps: Gaps, file: TraceFile, *, same_steps: bool
) -> Diagnosis:
    """What explains the gaps, and what storing in single precision does."""
    rounding = file.rounding

    def known_model_errors() -> tuple[str, ...]:
        return explain(log, run, rounding, same_steps=same_steps)

    def spurious() -> Learnt | None:
        return learnt(run_events(run))

    ekf, sigma = run.estimate, np.sqrt(np.diag(gaps.smoothed.joint_covariance))
    algebra, model = gaps.algebra_rounding, gaps.model_rounding
    covariance = stored_rounding(ekf.joint_covariance) > 0.0
    if rounding or covariance:
        algebra = algebra.plus(allowed_of_estimate(Gaussian.of(ekf), sigma, covariance=covariance))
    if not rounding:
        return Diagnosis(
            differences=gaps.model_differences,
            operations=lambda: _event_faults(file, algebra),
            unnamed=_RECORD,
            known_model_errors=known_model_errors,
            spurious=spurious,
            algebra=algebra,
            model=model,
        )

    from_trace = allowed_gap(gaps.solved, run.trace, sigma)
    algebra = algebra.plus(from_trace)
    single = ""
    if not gaps.agreement.algebra.explained_by(algebra):
        single = computed_in_single(run, gaps.agreement.algebra, sigma)
    model = model.plus(from_trace).plus(allowed_gap(gaps.model_solved, run.trace, sigma))
    return Diagnosis(
        differences=lambda: gaps.model_differences(_stored_differences(run, gaps)),
        known_model_errors=known_model_errors,
        spurious=spurious,
        single=single,
        algebra=algebra,
        model=model.times(OPERATIONS) if single else model,
    )


def _event_faults(file: TraceFile, allowed: Allowed) -> tuple[str, ...]:
    """Return what the trace's own snapshots, gains and corrections show.

    A snapshot of the end alone shows no more than the gap does.
    """
    if file.former or not file.path.is_file():
        return ()
    from comparisons.audit.algebra import faults_of

    trace = Trace(file.path)
    several = trace.counts.snapshots > 1
    events = (one for one in trace if several or not isinstance(one, Snapshot))
    return faults_of(events, max(allowed.sigma, allowed.covariance))


def _stored_differences(run: EkfRun, gaps: Gaps) -> dict[tuple[str, str], float]:
    """What storing explains of single relations, by relation and quantity."""
    found: dict[tuple[str, str], float] = {}
    for trace in restored_traces(run.trace):
        other = gaps.by_steps(recorded_system_of(replace(run, trace=trace)), trace)
        right = gaps.by_steps(gaps.recorded, run.trace)
        for one in model_differences(other, right, 0.0, gaps.initialised):
            key = one.relation, one.quantity
            found[key] = max(found.get(key, 0.0), FACTOR * one.largest)
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
    pose = last.pose[-1].copy()
    pose[2] += 2.0 * np.pi * np.round((trace.arrived[-1, 2] - pose[2]) / (2.0 * np.pi))
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
    trace, found = run.trace, []
    kinds = [
        (
            "measurements",
            np.concatenate((trace.measurements[POINT].step, trace.initialisations[POINT].step)),
            resolved(log.measurements.time_s)[
                np.concatenate(
                    (trace.measurements[POINT].number, trace.initialisations[POINT].number)
                )
            ],
        )
    ]
    if positions is not None:
        fixes = trace.positions
        kinds.append(("positions", fixes.step, resolved(positions.time_s)[fixes.number]))
    for kind, step, due_s in kinds:
        late_s = stands_s[step] - due_s
        off = np.abs(late_s) > 1e-6
        if off.any():
            middle = float(np.median(late_s[off]))
            found.append(
                DataFault(
                    f"{np.count_nonzero(off)} of {len(off)} {kind} are used too "
                    f"{'late' if middle > 0 else 'early'}, by {abs(middle):.4g} s (median)",
                    "check the order of events: predict up to the time of a measurement, then "
                    "update with it",
                )
            )
    return found
