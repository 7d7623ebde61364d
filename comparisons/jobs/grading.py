"""An estimate of a solved log graded: beside sound filters and the optimum, and by its trace.

In: an estimate and the smoother's solution of its log; out: an `ExternalCheck`. The check job has a
`Grader` for all the ways in which an estimate may be read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from comparisons.arrays import Array
from comparisons.checks import causes as cause
from comparisons.checks.agreement import Gap
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.diagnosis.diagnosis import FEWEST
from comparisons.checks.diagnosis.estimate_facts import (
    Clues,
    UndoneMotion,
    paths_beside,
    undone_motions,
)
from comparisons.checks.estimate_verdict import (
    beside_trace,
    causes_of,
    differences,
    given_remarks,
    grade_remarks,
    left_open,
    too_short,
)
from comparisons.checks.external_agreement import compare_external, coverage, within_log
from comparisons.checks.grade import (
    LIKE_SIGMA,
    LIKE_VARIANCE,
    Graded,
    Likeness,
    graded,
    likeness,
    nearer,
    outcome_of,
)
from comparisons.checks.verdict import Outcome
from comparisons.config import MIN_COVERAGE, CheckConfig, RequiredGrade, SolveConfig
from comparisons.estimates.external import ExternalEstimate, Information, with_poses
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.sound_variants import variants_near
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.external_trace import TraceCheck, check_trace, trace_run
from comparisons.logs.log import Log
from comparisons.logs.odometry import Integration
from comparisons.logs.stamps import at_instants
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.known import EstimateUnderCheck, Known
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import SoundFilters, smoother
from comparisons.pipeline.solve import Solution, prepare_solve
from comparisons.rounding import ROUNDING, Allowed
from comparisons.words import Cause

_HOPELESS_SIGMA = 30.0
"""So far from the reference EKF no variant of it is tried, nor where the means are the EKF's."""


@dataclass(frozen=True, kw_only=True)
class Grader:
    """Grades estimates of a log, and of what readings make of it.

    Each log is solved once, and each sound filter runs on it once.

    log: as the estimate's filter had it. solver: as of `comparisons.jobs.check.check`.
    """

    log: Log
    config: CheckConfig
    progress: Progress
    solver: Callable[[Log, CheckConfig, Progress], Solution]
    _integrated: dict[str, Log] = field(init=False, repr=False, default_factory=dict)
    _solved: dict[int, tuple[Log, Solution]] = field(init=False, repr=False, default_factory=dict)
    _filters: dict[int, tuple[Solution, SoundFilters]] = field(
        init=False, repr=False, default_factory=dict
    )

    @cached_property
    def prepared(self) -> Prepared[SolveConfig]:
        """The log as the estimators read it."""
        return prepare_solve(self.log, self.config)

    def integrated(self, integration: Integration) -> Log:
        """Return the log with another integration of steps, the same one each time."""
        return self._integrated.setdefault(
            repr(integration), replace(self.log, integration=integration)
        )

    def solved(self, log: Log) -> Solution:
        """Return the smoother's solution of a log, known by being the same object."""
        if id(log) not in self._solved:
            self._solved[id(log)] = log, self.solver(log, self.config, self.progress)
        return self._solved[id(log)][1]

    def filters(self, solution: Solution) -> SoundFilters:
        """Return the sound filters on the log of a solution, known by being the same object."""
        if id(solution) not in self._filters:
            self._filters[id(solution)] = solution, SoundFilters(solution.prepared)
        return self._filters[id(solution)][1]

    def graded(self, given: ExternalEstimate, log: Log) -> ExternalCheck:
        """Return the grade of an estimate of a log."""
        solution, config = self.solved(log), self.config
        return check_external(
            given,
            solution,
            config.require,
            self.progress,
            min_coverage=config.min_coverage,
            filters=self.filters(solution),
        )


@dataclass(frozen=True, kw_only=True)
class _References:
    """What an estimate is compared with, and how near it is to each.

    optimum: the smoother. peers: estimates of the kinds that it may be. by_peer: it beside each.
    motion: without which it equals a peer; None where there is none. variants: other sound filters.
    nearest: of all. clues: what else its poses may be.
    """

    optimum: Reference
    peers: tuple[Reference, ...]
    by_peer: tuple[Likeness, ...]
    motion: UndoneMotion | None
    variants: tuple[Reference, ...]
    nearest: Likeness | None
    clues: Clues


def check_external(
    given: ExternalEstimate,
    solution: Solution,
    require: RequiredGrade | None = None,
    progress: Progress = no_progress,
    *,
    min_coverage: float = MIN_COVERAGE,
    filters: SoundFilters | None = None,
) -> ExternalCheck:
    """Grade an estimate of a log that is solved. Raises InputError for one of another time.

    min_coverage: share of the log's time below which no estimate agrees. filters: of the log, where
    other estimates are compared with them, too.
    """
    prepared, smoothed = solution.prepared, solution.estimate
    given = given.numbered_as(prepared.log.labels)
    given = replace(given, time_s=at_instants(given.time_s, prepared.timeline.instants_s()))
    inside = with_poses(given, within_log(given, smoothed))
    sound_trace = given.trace is not None and not given.trace.unsound
    # A trace of another log is refused before the long work.
    followed = trace_run(given, prepared) if sound_trace else None
    with prepared.clock.stage("references"):
        progress("references", 0, 0)
        beside = _references(given, inside, solution, filters or SoundFilters(prepared))
    progress("check", 0, 0)
    agreement = compare_external(inside, beside.optimum, beside.peers, labelled=prepared.labelled)
    expected: RequiredGrade = "like" if given.estimator == "ekf" else "plausible"
    grade = graded(
        require or expected, beside.nearest, agreement.against, verified=solution.verified
    )
    first = beside.by_peer[0] if beside.by_peer else None
    run = None if followed is None else followed[0]
    unlike = differences(inside, first, beside.clues, prepared.log, run)
    covered = coverage(
        (inside.time_s, inside.pose),
        (smoothed.time_s, smoothed.pose),
        prepared.timeline.observed_s(),
        min_coverage,
    )
    if covered.short:
        unlike = [one for one in unlike if one.gap != "coverage"]
    traced, causes = None, causes_of(grade, unlike, agreement.against)
    if followed is not None:
        progress("trace", 0, 0)
        solved = solution.result, smoothed
        traced = check_trace(given, followed, prepared, solved[0].options, solved)
        grade, causes = _traced(grade, causes, traced, first, solution, inside)
    elif given.trace is not None:
        grade = replace(grade, value="wrong")
        causes = (cause.invalid(f"{given.trace.path.name}: {given.trace.unsound}"), *causes)
    judged = EstimateUnderCheck(
        estimate=given,
        inside=inside,
        optimum=beside.optimum,
        information=_information(given, beside.nearest),
        sensors=traced.sensors if traced else (),
    )
    check = ExternalCheck(
        given=given,
        solution=solution,
        optimum=beside.optimum,
        peers=beside.peers,
        by_peer=beside.by_peer,
        motion=beside.motion,
        variants=beside.variants,
        agreement=agreement,
        coverage=covered,
        trace=traced,
        grade=grade,
        outcome="disagree",
        causes=causes,
        remarks=(),
        before=_known(solution, traced, judged),
    )
    return _with_outcome(check, unlike)


def _with_outcome(check: ExternalCheck, unlike: list[Cause]) -> ExternalCheck:
    """The check with outcome and remarks, and its causes as these ask for.

    unlike: why it is not like the first reference.
    """
    solution, grade, causes = check.solution, check.grade, check.causes
    optimality, association = solution.result.optimality, solution.association_check
    outcome: Outcome = "disagree"
    if check.coverage.short:
        grade = replace(grade, value=None)
    else:
        known = _associated(solution)
        outcome = outcome_of(grade, verified=solution.verified, association_known=known)
    if outcome == "unverified":
        causes = left_open(optimality, association, causes)
    faults = tuple(one for one in causes if one.gap in FILTER_FAULTS)
    small = []
    if outcome == "agree":
        small = [f"warning (grade reached): {fault.gap}: {fault.evidence}" for fault in faults]
        causes = ()
    if check.coverage.short:
        # A wrong filter may have broken down.
        rest = tuple(one for one in causes if one.gap not in FILTER_FAULTS)
        causes = (*faults, too_short(check.given, check.inside, check.coverage), *rest)
    remarks = (
        *small,
        *given_remarks(check.given, check.agreement),
        *grade_remarks(grade, unlike, check.agreement.against, outcome),
        *solution.doubts,
        *solution.notes,
    )
    return replace(check, grade=grade, outcome=outcome, causes=causes, remarks=remarks)


def _references(
    given: ExternalEstimate, inside: ExternalEstimate, solution: Solution, filters: SoundFilters
) -> _References:
    """Sound estimates at an estimate's times. inside: its poses in the log's time.

    Of a log with loop closures no filter is a peer, for none of ours uses these.
    """
    time_s, labelled = inside.time_s, solution.prepared.labelled
    peers = _peers(inside, solution, filters)
    optimum = peers[-1] if peers and peers[-1].smoothed else smoother(solution, time_s)
    by_peer = tuple(likeness(inside, peer, labelled=labelled) for peer in peers)
    ekf = None if not peers or peers[0].smoothed else filters.ekf(time_s)
    motion = _motion(given, inside, by_peer, optimum, solution, filters)
    nearest: Likeness | None = None
    for near in by_peer:
        nearest = nearer(nearest, near)
    others = list[Reference]()
    if ekf is not None and motion is None and asks_for_variants(by_peer):
        for other in variants_near(inside, by_peer[0], filters):
            others.append(other)
            nearest = nearer(nearest, likeness(inside, other, labelled=labelled))
            if nearest.grade == "equal":
                break

    def filtered() -> tuple[Array, Array] | None:
        run = ekf or filters.ekf(time_s)
        return run and (run[0].pose, run[0].pose_covariance)

    closed = solution.log.loop_closures is not None
    smoothed = optimum.pose, optimum.pose_covariance
    return _References(
        optimum=optimum,
        peers=peers,
        by_peer=by_peer,
        motion=motion,
        variants=tuple(others),
        nearest=nearest,
        clues=Clues(before=ekf and ekf[1], smoothed=smoothed, filtered=filtered, closed=closed),
    )


def _peers(
    inside: ExternalEstimate, solution: Solution, filters: SoundFilters
) -> tuple[Reference, ...]:
    """Sound estimates of the kinds that one in the log's time may be, at its times."""
    time_s, peers = inside.time_s, list[Reference]()
    if inside.may_be("filtered") and solution.log.loop_closures is None:
        ekf = filters.ekf(time_s)
        peers += [] if ekf is None else [ekf[0]]
    if inside.may_be("smoothed"):
        peers.append(smoother(solution, time_s))
    return tuple(peers)


def _motion(
    given: ExternalEstimate,
    inside: ExternalEstimate,
    by_peer: tuple[Likeness, ...],
    optimum: Reference,
    solution: Solution,
    filters: SoundFilters,
) -> UndoneMotion | None:
    """The motion of all of an estimate without which it equals a peer; None where there is none.

    inside, by_peer, optimum: as of `_references`. None where there is a trace, which says how its
    filter moved.
    """
    if given.trace is not None or any(near.grade is not None for near in by_peer):
        return None
    if not by_peer or np.count_nonzero(by_peer[0].reference.known) < FEWEST:
        return None
    begin_s, end_s = solution.estimate.time_s[[0, -1]]
    paths = paths_beside(inside, by_peer[0].reference, optimum.pose)
    for motion in undone_motions(given, paths, solution.prepared.timeline.instants_s()):
        time_s = motion.given.time_s
        moved = with_poses(motion.given, (time_s >= begin_s) & (time_s <= end_s))
        peers = _peers(moved, solution, filters) if len(moved.time_s) >= FEWEST else ()
        for peer in peers:
            near = likeness(moved, peer, labelled=solution.prepared.labelled)
            if near.grade == "equal" and np.count_nonzero(peer.known) >= FEWEST:
                return motion
    return None


def asks_for_variants(by_peer: tuple[Likeness, ...]) -> bool:
    """Return whether an estimate is neither equal to a peer, the first a filter, nor hopeless."""
    if not by_peer or by_peer[0].reference.smoothed:
        return False
    equal = any(near.grade == "equal" for near in by_peer)
    return not equal and ROUNDING < by_peer[0].sigma < _HOPELESS_SIGMA


def _traced(
    grade: Graded,
    causes: tuple[Cause, ...],
    traced: TraceCheck,
    first: Likeness | None,
    solution: Solution,
    inside: ExternalEstimate,
) -> tuple[Graded, tuple[Cause, ...]]:
    """The grade and the causes with what a trace shows; first: beside the first reference.

    Right equations of another map than the log's are not like a reference: what is then left to
    explain is the map.
    """
    own = _by_equations(grade, traced, inside, labelled=solution.prepared.labelled)
    if own is not grade and first is not None and first.unmapped and _associated(solution):
        of_map = [one for one in causes if one.gap in ("association", "map", "coverage")]
        return by_trace(grade, traced), (*of_map, *beside_trace((), traced.verdict.causes))
    return by_trace(own, traced), beside_trace(causes, traced.verdict.causes)


def _by_equations(
    grade: Graded, traced: TraceCheck, inside: ExternalEstimate, *, labelled: bool
) -> Graded:
    """An estimate is like an EKF where its trace's equations are right and lead to it.

    It may linearise elsewhere, or take measurements in another order, than any reference. Where
    double precision cannot tell whether they are right, the trace says nothing.
    """
    untold = traced.verdict.outcome == "unverified"
    if traced.own is None or untold or grade.value in ("like", "equal"):
        return grade
    reference = traced.own.at(inside.time_s)
    if not len(reference.time_s):
        return grade
    near = likeness(
        with_poses(inside, np.isin(inside.time_s, reference.time_s)), reference, labelled=labelled
    )
    return grade if near.grade is None else replace(grade, value="like", by=near)


def by_trace(grade: Graded, traced: TraceCheck) -> Graded:
    """Return the grade of an estimate like no filter: wrong if its trace has a fault that matters.

    However near it came. What matters is a gap beyond those of `like`, or misused data.
    """
    if grade.value in ("like", "equal"):
        return grade
    gaps: dict[str, Gap] = {"algebra": traced.agreement.algebra, "model": traced.agreement.model}
    like = Allowed(LIKE_SIGMA, LIKE_VARIANCE)
    small = {name for name, gap in gaps.items() if gap.explained_by(like)}
    faults = {one.gap for one in traced.verdict.causes} & FILTER_FAULTS
    return replace(grade, value="wrong") if faults - small else grade


def _known(solution: Solution, traced: TraceCheck | None, given: EstimateUnderCheck) -> Known:
    """What the checks may read: the smoother, the estimate, and the events of a sound trace."""
    known = replace(
        solution.answers.before,
        without="the estimate has no trace that shows its filter's events",
        given=given,
    )
    if traced is None:
        return known
    events = traced.known
    findings, absent = events.findings, events.absent
    return replace(known, run=events.run, kept=events.kept, findings=findings, absent=absent)


def _associated(solution: Solution) -> bool:
    """Whether the references' association is known: by labels, or beyond doubt."""
    checked = solution.association_check
    return checked is None or checked.verified


def _information(given: ExternalEstimate, near: Likeness | None) -> Information | None:
    """What its poses know of the log: as it says, or else as a reference does that it is like."""
    filtered, smoothed = (given.may_be(kind) for kind in ("filtered", "smoothed"))
    if filtered != smoothed or given.information is not None:
        return given.information or ("filtered" if filtered else "smoothed")
    if near is None or near.grade is None:
        return None
    return "smoothed" if near.reference.smoothed else "filtered"
