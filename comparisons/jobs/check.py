"""The check job: someone else's estimate of a log, graded by a filter like it and the optimum."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array
from comparisons.checks import causes as cause
from comparisons.checks.accuracy import Accuracy, AccuracyFinding
from comparisons.checks.agreement import Allowed, Gap
from comparisons.checks.algebra import HINT as ALGEBRA_HINT
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.check import Answers
from comparisons.checks.consistency.consistency import ExternalConsistency
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.diagnosis.alignment import laid_at_start
from comparisons.checks.diagnosis.departure import Departure, departure_from
from comparisons.checks.diagnosis.diagnosis import (
    FEWEST,
    MOTIONS,
    PathMotion,
    PathTransform,
    frame_at_start,
    simplest_motion,
)
from comparisons.checks.diagnosis.duplicate_landmarks import duplicate_cause, duplicates
from comparisons.checks.diagnosis.estimate_facts import Clues, facts, paths_beside, undone
from comparisons.checks.diagnosis.model_differences import PREDICTIONS
from comparisons.checks.external_agreement import (
    ExternalAgreement,
    TimeCoverage,
    clock_words,
    compare_external,
    coverage,
    within_log,
)
from comparisons.checks.grade import (
    GRADES,
    LIKE_SIGMA,
    LIKE_VARIANCE,
    EstimatePart,
    Grade,
    Likeness,
    likeness,
)
from comparisons.checks.model import HINT as MODEL_HINT
from comparisons.checks.optimum import doubted_association, unverified
from comparisons.checks.qualifiers import TruthGapFinding, qualified
from comparisons.checks.registry import CHECKS
from comparisons.checks.spread import within_spread
from comparisons.checks.unused_positions import UnusedPositionsFinding
from comparisons.checks.verdict import Outcome, Verdict
from comparisons.config import MIN_COVERAGE, CheckConfig, RequiredGrade, SolveConfig
from comparisons.estimates.external import ExternalEstimate, Information, with_poses
from comparisons.estimates.reference import Reference
from comparisons.faults.catalogue import is_setting
from comparisons.fingerprints.clock import (
    counts_as_file,
    on_file_clock,
    on_log_clock,
    works_with_floats,
    written_from_floats,
)
from comparisons.fingerprints.data_use import (
    LeftOut,
    SelectedMeasurements,
    find_left_out,
    labelled_as,
    left_out_of,
    with_removed,
    without,
)
from comparisons.fingerprints.estimate_motion import (
    in_words,
    integrations_by_steps,
    integrations_of,
)
from comparisons.fingerprints.map_labels import map_labels, plausible
from comparisons.fingerprints.search import fault_cause, fingerprints
from comparisons.fingerprints.trial import Fingerprint
from comparisons.fingerprints.unscented import unscented_filters
from comparisons.jobs.external_trace import TraceCheck, check_trace, trace_run
from comparisons.logs.log import Log
from comparisons.logs.odometry import Integration, RelativePoses
from comparisons.logs.stamps import at_instants, rounded
from comparisons.logs.transforms.clock import timed_by_floats
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.known import EstimateUnderCheck, Known
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import (
    APART,
    EKF,
    FILTERS,
    ORDERS,
    filter_named,
    reference_ekf,
    smoother,
    variants,
)
from comparisons.pipeline.size import announce_time
from comparisons.pipeline.solve import Solution, prepare_solve, solve
from comparisons.shown import Brief, Shown, render
from comparisons.statistics import ROUNDING
from comparisons.words import Cause

if TYPE_CHECKING:
    from pandas import DataFrame

_HOPELESS_SIGMA = 30.0
"""So far from the reference EKF no variant of it is tried, nor where the means are the EKF's."""

_EXACT_SHARE = 0.2
"""Share of one measurement's sigmas below which a start is exact."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Graded(Brief):
    """An estimate's grade. value: None where it is not like any, and the optimum is not verified.

    required: the least that is asked for. by: what it was compared with in the end, the nearest.
    """

    value: Grade | None
    required: RequiredGrade
    by: Likeness | None

    @property
    def enough(self) -> bool:
        """Whether it is what is asked for."""
        return self.value is not None and (GRADES.index(self.value) >= GRADES.index(self.required))


@dataclass(frozen=True, kw_only=True)
class ExternalCheck(Shown):
    """Hold what the check of an external estimate found.

    Attributes:
        given: The estimate that was checked.
        solution: The smoother's, of the same log.
        optimum: The smoother at the given times.
        peers: Correct estimates of the kinds that the given one may be.
        variants: Other sound filters that it was compared with; none where it equals a peer.
        agreement: The estimate against the smoother.
        coverage: Share of the log's time that it covers.
        trace: The filter's own gaps, where it handed in a trace.
        consequences: Kinds of causes that the first one explains, as was computed: the reference
            filter with this fault equals the estimate.
        departure: Where it first leaves the filter that it equals the longest, or its trace the
            models; None where it is equal, or no filter is of its kind.
        log: As it was read, where the solution's has other integration or times.
        reproduced: A filter with the fault that is the first cause equals all of it, so that its
            other figures follow from that.
        grade: `equal`, `like`, `plausible` or `wrong`, with what it was compared with.
        outcome: `agree`, `disagree` or `unverified`.
        causes: Why the grade is not higher, the most important first.
        remarks: What narrows the verdict.
        answers: Of the checks, when they are asked for.
        qualifiers: What a reader of the outcome must know as well.
        inconsistent: What of its consistency is outside its band, None where nothing shows it.
    """

    given: ExternalEstimate
    solution: Solution
    optimum: Reference
    peers: tuple[Reference, ...]
    variants: tuple[Reference, ...]
    agreement: ExternalAgreement
    coverage: TimeCoverage
    trace: TraceCheck | None
    grade: Graded
    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]
    answers: Answers
    qualifiers: tuple[str, ...] = ()
    inconsistent: tuple[str, ...] | None = None
    departure: Departure | None = None
    consequences: tuple[str, ...] = ()
    log: Log | None = None
    reproduced: bool = False

    def __repr__(self) -> str:
        """Return log, outcome, grade and the causes' names in one line."""
        gaps = ", ".join(one.gap for one in self.causes)
        name, grade = self.solution.log.name, self.grade.value or "none"
        return f"<ExternalCheck of {name}: {self.outcome}, grade {grade}{gaps and f' ({gaps})'}>"

    @property
    def known(self) -> Known:
        """What is known of log and estimate, with what the checks find."""
        return self.answers.known

    @property
    def consistency(self) -> ExternalConsistency:
        """Its errors, and whether its covariances match them."""
        return cast("ExternalConsistency", self.known.value(ConsistencyFinding))

    @property
    def accuracy(self) -> Accuracy | None:
        """Its errors, where the log has truth or positions that no estimator has used."""
        return (self.known.value(AccuracyFinding) or {}).get("estimate")

    @property
    def inside(self) -> ExternalEstimate:
        """What was given within the log's time."""
        return with_poses(self.given, within_log(self.given, self.solution.estimate))

    @property
    def exact(self) -> bool:
        """Whether it is equal to a reference, and its trace to the models."""
        return self.grade.value == "equal" and not (self.trace and self.trace.verdict.causes)

    def to_pandas(
        self, table: Literal["causes", "gaps", "poses", "landmarks", "nees", "settings"] = "causes"
    ) -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `causes` of the verdict; `gaps`: those of the filter's trace, where it was handed
                in; `poses` as they were handed in; `landmarks`: the estimate against the smoother,
                by landmark; `nees`: of the estimate and the smoother against truth, by instant,
                with the 95 % band of one value; `settings`: value and default of each.

        Returns:
            The table, one row for each of what it lists; no rows where there is none.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        found: DataFrame = render("frame", self, table)
        return found


@dataclass(frozen=True)
class _References:
    """optimum: the smoother. peers: estimates of the kinds that it may be. clues: what else."""

    optimum: Reference
    peers: tuple[Reference, ...]
    clues: Clues


def check(
    log: Log,
    given: ExternalEstimate,
    config: CheckConfig | None = None,
    progress: Progress = no_progress,
    solver: Callable[[Log, CheckConfig, Progress], Solution] = solve,
) -> ExternalCheck:
    """Solve the log, run the reference EKF, grade. Raises InputError, and as `solve` does.

    solver: in the place of `solve`, as one that keeps what it has solved.
    """
    job = _Job(log, config or CheckConfig(), progress, solver)
    announce_time(prepare_solve(log, job.config))
    given = with_removed(given.numbered_as(log.labels), log)
    given, aligned = job.aligned(given)
    job, found = job.clocked(given)
    job = replace(job, log=_selected(job.log, found))
    unsound = given.trace is not None and given.trace.unsound
    if not (found.exact or unsound or len(found.inside.time_s) < FEWEST):
        progress("motion models", 0, 0)
        found = job.integrated(found, ORDERS)
        found = _with_departure(job.explained(found) or job.moved_back(found) or found)
    instants_s = found.solution.prepared.timeline.instants_s()
    if said := rounded(given.time_s, on_file_clock(given.time_s, log, instants_s)):
        found = replace(found, remarks=(said, *found.remarks))
    if aligned:
        found = replace(found, remarks=(aligned, *found.remarks))
    return _qualified(replace(found, log=log))


def _qualified(found: ExternalCheck) -> ExternalCheck:
    """Say what a reader of the outcome must know as well, by what the checks find."""
    known = found.known
    verdict = Verdict(outcome=found.outcome, causes=found.causes, remarks=found.remarks)
    consistency, beside = known.value(ConsistencyFinding), known.remarks
    if found.reproduced and consistency is not None and consistency.remarks:
        beside = [one for one in beside if one not in consistency.remarks]
        found = replace(found, consequences=(*found.consequences, "consistency"))
    judged = qualified(
        replace(verdict, remarks=(*found.remarks, *beside)),
        known.value(TruthGapFinding),
        unchecked="",
        consistency=consistency,
        unused=known.value(UnusedPositionsFinding),
        fail_on=(),
    )
    return replace(
        found,
        causes=judged.causes,
        remarks=judged.remarks,
        qualifiers=judged.qualifiers,
        inconsistent=judged.inconsistent,
    )


@dataclass(frozen=True)
class _Job:
    """What `check` was asked for."""

    log: Log
    config: CheckConfig
    progress: Progress
    solver: Callable[[Log, CheckConfig, Progress], Solution]

    @cached_property
    def own(self) -> Solution:
        """The smoother's, by the log's own integration."""
        return self.solver(self.log, self.config, self.progress)

    def aligned(self, given: ExternalEstimate) -> tuple[ExternalEstimate, str]:
        """The estimate in the log's frame where that is asked for, and how it was moved."""
        if not self.config.log.align:
            return given, ""
        instants_s = prepare_solve(self.log, self.config).timeline.instants_s()
        return laid_at_start(given, on_log_clock(given, self.log, instants_s).time_s, self.log)

    def clocked(self, given: ExternalEstimate) -> tuple[_Job, ExternalCheck]:
        """The grade, and the job with the times of the log that the estimate's filter had.

        One that counts as the log's file does, since 1970, may have read these stamps as floats;
        both are tried to the end only where the poses of a smoother do not tell.
        """
        stamped = [given.time_s] + ([given.trace.step_time_s] if given.trace is not None else [])
        by_files = any(counts_as_file(one, self.log) for one in stamped)
        if isinstance(self.log.odometry, RelativePoses) or not by_files:
            return self, self.started(given)
        by_floats = replace(self, log=timed_by_floats(self.log))
        prepared = [prepare_solve(job.log, job.config) for job in (self, by_floats)]
        floats = works_with_floats(given, *prepared)
        jobs = [self, by_floats]
        if floats or (floats is None and written_from_floats(given)):
            jobs.reverse()
        first = jobs[0].started(given)
        if floats is None and given.may_be("smoothed") and first.grade.value != "equal":
            second = jobs[1].started(given)
            if second.grade.value == "equal":
                return jobs[1], second
        return jobs[0], first

    def started(self, given: ExternalEstimate) -> ExternalCheck:
        """The grade beside references that move as the estimate's own steps do."""
        prepared = prepare_solve(self.log, self.config)
        instants_s = prepared.timeline.instants_s()
        given = on_log_clock(given, self.log, instants_s)
        placed = replace(given, time_s=at_instants(given.time_s, instants_s))
        left_out = self._left_out(placed, prepared)
        if left_out is not None:
            other = replace(self, log=without(self.log, left_out.rows))
            return _saying(left_out.said(self.log), other._started(given, placed))
        return self._started(given, placed)

    def _started(self, given: ExternalEstimate, placed: ExternalEstimate) -> ExternalCheck:
        """The same once what is left out is. placed: at the log's instants."""
        inside = with_poses(placed, within_log(placed, self.own.estimate))
        found = integrations_by_steps(inside, self.own.prepared)
        return self._moving(given, found) if found else self._graded(given, self.own)

    def _left_out(
        self, placed: ExternalEstimate, prepared: Prepared[SolveConfig]
    ) -> LeftOut | None:
        """What the filter of a trace left out by a rule, if it is one of the log's labels."""
        file, count = placed.trace, len(self.log.measurements.landmark)
        if file is None or file.unsound or not prepared.labelled:
            return None
        if self.log.known_landmarks is not None or file.measurements_used == count:
            return None
        return left_out_of(self.log, trace_run(placed, prepared)[0])

    def _graded(self, given: ExternalEstimate, solution: Solution) -> ExternalCheck:
        require, least = self.config.require, self.config.min_coverage
        return check_external(given, solution, require, self.progress, min_coverage=least)

    def integrated(self, first: ExternalCheck, filters: Iterable[str]) -> ExternalCheck:
        """The same with the estimate's own integration, where that is not the log's."""
        prepared = first.solution.prepared
        others = integrations_of(first.inside, prepared, first.grade.by, filters)
        if not others:
            return first
        return self._moving(first.given, others)

    def _moving(
        self, given: ExternalEstimate, integrations: tuple[Integration, ...]
    ) -> ExternalCheck:
        """The grade beside references of the first of integrations that explain its steps."""
        log = replace(self.log, integration=integrations[0])
        again = self._graded(given, self.solver(log, self.config, self.progress))
        steps = " or ".join(in_words(one) for one in integrations)
        said = f"the estimate integrates steps {steps}; references and smoother do so, too"
        return _saying(said, again)

    def explained(self, first: ExternalCheck) -> ExternalCheck | None:
        """The same once a fault reproduces the estimate, or it is sound; None where neither is."""
        if first.outcome == "agree":
            return first
        found = self.by_map(first) or self.selected(first)
        found = (
            found
            or _of_sigma_points(first)
            or _named(first, self.progress)
            or _within_spread(first)
        )
        if found is None and first.variants:
            other = self.integrated(first, FILTERS)
            found = other if other.outcome == "agree" else _within_spread(other)
        return found

    def by_map(self, first: ExternalCheck) -> ExternalCheck | None:
        """The same beside references that associate as the estimate's map says, if it is like one.

        None where the log's labels do.
        """
        solution = first.solution
        if solution.prepared.labelled:
            return None
        implied = map_labels(first.inside, solution.log.measurements, solution.landmark_index)
        if implied is None:
            return None
        log = labelled_as(solution.log, implied.label)
        other = self.solver(log, self.config, self.progress)
        if not plausible(other.result.optimality, other.estimate):
            return None
        again = self._graded(with_removed(first.given, log), other)
        found = again if again.outcome == "agree" else self.selected(again)
        return found and _saying(implied.said(), found)

    def selected(self, first: ExternalCheck) -> ExternalCheck | None:
        """The same beside references that leave out what its filter seems to, if it is like one.

        None where a trace says what its filter used, or labels do not say of what they are.
        """
        prepared = first.solution.prepared
        known = prepared.labelled and prepared.log.known_landmarks is None
        if first.trace is not None or not known or not first.peers or first.peers[0].smoothed:
            return None
        sound = likeness(first.inside, first.peers[0], labelled=True)
        found = find_left_out(first.inside, prepared, sound)
        if found is None:
            return None
        left_out, near = found
        log = without(prepared.log, left_out.rows)
        again = self._graded(first.given, self.solver(log, self.config, self.progress))
        if again.outcome != "agree" and near.grade is not None and not again.coverage.short:
            again = replace(again, variants=(*again.variants, near.reference))
            again = _sound(again, near, near.grade)
        return _saying(left_out.said(self.log), again) if again.outcome == "agree" else None

    def moved_back(self, first: ExternalCheck) -> ExternalCheck | None:
        """The same where the estimate is explained once a motion of all of it is undone.

        None where there is a trace, which says how its filter moved.
        """
        if first.trace is not None or not first.peers or not first.peers[0].known.any():
            return None
        if first.causes and first.causes[0].gap in MOTIONS:
            return None
        beside = paths_beside(first.inside, first.peers[0], first.optimum.pose)
        path, motion = simplest_motion(beside)
        if motion.moved == PathTransform():
            return None
        found = self.undone(first, motion)
        framed = motion.gap == "frame" or motion.moved.yaw_rad
        return found or (self.undone(first, frame_at_start(path, motion)) if framed else None)

    def undone(self, first: ExternalCheck, motion: PathMotion) -> ExternalCheck | None:
        """The check of what is left without a motion; None if nothing explains that."""
        instants_s = first.solution.prepared.timeline.instants_s()
        other = undone(first.given, motion.moved, instants_s)
        delay_s = float(np.median(first.given.time_s - other.time_s))
        motion = replace(motion, moved=motion.moved._replace(delay_s=delay_s))
        found = self.explained(self.integrated(self.started(other), ORDERS))
        if found is None or found.grade.by is None:
            return None
        near, then = found.grade.by, "the rest of the difference has the next cause"
        if found.outcome == "agree" and found.grade.value == "plausible":
            then = "the estimate is plausible beside the smoother"
        elif found.outcome == "agree":
            equal = "equals" if found.grade.value == "equal" else "is like"
            then = f"the estimate {equal} {near.reference.name} ({near.farthest:.2g} sigma)"
        said = Cause(motion.gap, f"{motion.said}; with this corrected, {then}", motion.hint)
        causes = (said, *found.causes)
        return replace(first, causes=causes, remarks=found.remarks, reproduced=found.reproduced)


def _selected(log: Log, found: ExternalCheck) -> Log:
    """Return the log that a check was made by, without what the estimate's filter left out."""
    seen = found.solution.log.measurements
    return replace(log, measurements=seen) if isinstance(seen, SelectedMeasurements) else log


def _saying(remark: str, found: ExternalCheck) -> ExternalCheck:
    """Return a check with a remark before all others."""
    return replace(found, remarks=(remark, *found.remarks))


def _with_departure(found: ExternalCheck) -> ExternalCheck:
    """Say where it first leaves what a sound filter of its kind does."""
    prepared, inside = found.solution.prepared, found.inside
    left = None if found.trace is None else found.trace.departure
    if left is None:
        sound = [one for one in (*found.peers, *found.variants) if not one.smoothed]
        if sound and not found.variants:
            others = (filter_named(name, prepared, inside.time_s) for name in ORDERS if name != EKF)
            sound += [one for one in others if one is not None]
        left = departure_from(inside, sound, prepared.log, prepared.timeline)
    if left is None:
        return found
    said = [] if found.outcome == "agree" else [left.briefly if found.reproduced else str(left)]
    return replace(found, departure=left, remarks=(*said, *found.remarks))


def _named(found: ExternalCheck, progress: Progress) -> ExternalCheck | None:
    """Name the fault that makes the reference filter reproduce an estimate, if one does."""
    prepared, sound, inside = found.solution.prepared, found.grade.by, found.inside
    filters = [peer for peer in found.peers if not peer.smoothed]
    if not filters:
        return None
    if sound is None or sound.reference.smoothed:
        sound = likeness(inside, filters[0], labelled=prepared.labelled)
    # A motion of the whole, or a factor on covariances beside right means, is simpler than several.
    simple = sound.sigma <= ROUNDING or (found.causes and found.causes[0].gap in MOTIONS)
    # Beside an association in doubt, which jumps, nothing is linear that several could be fit by.
    several = not simple and (prepared.labelled or found.solution.verified)
    known = fingerprints(inside, prepared, sound, progress, several=several)
    if not known:
        return None
    if said := _without_effect(known[0], sound, found):
        return _sound(_saying(said, found), sound, "like")
    first, others, follow = known[0], found.causes, tuple[str, ...]()
    if first.exact:
        others = tuple(one for one in others if one.gap in FILTER_FAULTS)
    if first.whole:  # the same poses, landmarks and covariances, so all that differs from sound
        others = tuple(_following(one) for one in others)
        follow = tuple(one.gap for one in found.causes if one.gap in ("estimate", "covariance"))
    causes = (fault_cause(known, sound), *others)
    return replace(found, causes=causes, consequences=follow, reproduced=first.whole)


def _following(found: Cause) -> Cause:
    """A trace's cause beside the fault that explains it: what the trace itself shows stays."""
    general = found.hint.startswith((ALGEBRA_HINT, MODEL_HINT))
    return found if not general else replace(found, hint="a consequence of the fault above")


def _without_effect(known: Fingerprint, sound: Likeness, found: ExternalCheck) -> str:
    """Say that an estimate differs from a sound one by a setting that changes nothing in the end.

    "" for what is no setting of the filter's start and noise, and where it changes the last pose or
    the map, or the trace differs from the models in more. Where both starts are exact beside what
    one measurement tells, covariances may differ, which they make those of another frame.
    """
    alone = known.whole and not known.several and is_setting(known.fault)
    if not alone or sound.missing or sound.unmapped:
        return ""
    if found.trace is not None and not _of_settings(found.trace):
        return ""
    poses, *others = sound.parts
    last = EstimatePart(poses.name, poses.sigma[-1:], poses.least[-1:], poses.largest[-1:])
    variance = np.inf if _both_exact(found) else LIKE_VARIANCE
    if not all(part.within(LIKE_SIGMA, variance) for part in (last, *others)):
        return ""
    ends = replace(sound, parts=(last, *others))
    low, high = ends.variances or (1.0, 1.0)
    return (
        f"{known.fault}: with this {sound.reference.name} equals the estimate "
        f"({known.sigma:.1g} sigma); without it the last pose and the map differ by at most "
        f"{ends.sigma:.2g} sigma, and by variances of {low:.3g} to {high:.3g} times"
    )


def _both_exact(found: ExternalCheck) -> bool:
    """Whether the log's start and the estimate's are exact beside what one measurement tells."""
    log, given = found.solution.log, found.inside
    start = None if found.given.trace is None else found.given.trace.trace.prior_covariance
    if start is None and given.pose_covariance is not None:
        start = given.pose_covariance[0] if given.time_s[0] <= log.prior.time_s + CLOCK_S else None
    seen = log.measurements
    if start is None or not len(seen.time_s):
        return False
    place, turn = seen.sigma_range_m.min(), seen.sigma_bearing_rad.min()
    limit = (_EXACT_SHARE * np.array((place, place, turn))) ** 2
    return bool((np.diag(start) <= limit).all() and (np.diag(log.prior.covariance) <= limit).all())


def _of_settings(traced: TraceCheck) -> bool:
    """Whether a trace differs from the models in the prior and the noise of predictions alone."""
    causes = {one.gap for one in traced.verdict.causes} & set(FILTER_FAULTS)
    differences = traced.known.records.differences
    return causes <= {"model"} and all(
        one.relation == "priors"
        or (one.relation == PREDICTIONS and one.quantity == "the noise covariance")
        for one in differences
    )


def _filter_like(found: ExternalCheck) -> Likeness | None:
    """What an estimate is most like, if that is a filter, and nothing else speaks against it.

    None where its trace has a fault, or too little is covered.
    """
    near, traced = found.grade.by, found.trace
    faulty = traced is not None and any(one.gap in FILTER_FAULTS for one in traced.verdict.causes)
    if faulty or near is None or near.reference.smoothed or not found.variants:
        return None
    return None if found.coverage.short else near


def _of_sigma_points(found: ExternalCheck) -> ExternalCheck | None:
    """The check beside the unscented filter of the estimate's own sigma points, if it is one."""
    prepared, inside = found.solution.prepared, found.inside
    if _filter_like(found) is None:
        return None
    ekf = likeness(inside, found.peers[0], labelled=prepared.labelled)
    best = None
    for reference in unscented_filters(inside, prepared, ekf):
        best = _better(best, likeness(inside, reference, labelled=prepared.labelled))
        if best.grade == "equal":
            break
    if best is None or best.grade is None:
        return None
    return _sound(replace(found, variants=(*found.variants, best.reference)), best, best.grade)


def _sound(found: ExternalCheck, near: Likeness, grade: Literal["equal", "like"]) -> ExternalCheck:
    """The check of an estimate that is as near to a filter as a grade says."""
    graded = replace(found.grade, value=grade, by=replace(near, grade=grade))
    outcome = outcome_of(graded, verified=found.solution.verified)
    causes = () if outcome == "agree" else found.causes
    return replace(found, grade=graded, outcome=outcome, causes=causes)


def _within_spread(found: ExternalCheck) -> ExternalCheck | None:
    """The check of an estimate that is as near to a filter as other sound filters are, if it is."""
    near = _filter_like(found)
    if near is None:
        return None
    filters = (*found.peers, *found.variants)
    sound = [one for one in filters if not one.smoothed and one.name not in APART]
    if not within_spread(near, sound, labelled=found.solution.prepared.labelled):
        return None
    said = (
        f"the estimate is up to {near.sigma:.2g} sigma from {near.reference.name}, its nearest, "
        f"and no part of it is farther than one of {len(sound) - 1} other sound filters is"
    )
    return _sound(replace(found, remarks=(said, *found.remarks)), near, "like")


def check_external(
    given: ExternalEstimate,
    solution: Solution,
    require: RequiredGrade | None = None,
    progress: Progress = no_progress,
    *,
    min_coverage: float = MIN_COVERAGE,
) -> ExternalCheck:
    """Grade an estimate of a log that is solved. Raises InputError for one of another time.

    min_coverage: share of the log's time below which no estimate agrees.
    """
    clock, labelled = solution.prepared.clock, solution.prepared.labelled
    instants_s = solution.prepared.timeline.instants_s()
    given = given.numbered_as(solution.prepared.log.labels)
    given = replace(given, time_s=at_instants(given.time_s, instants_s))
    inside = with_poses(given, within_log(given, solution.estimate))
    unsound = "" if given.trace is None else given.trace.unsound
    followed = None
    if given.trace is not None and not unsound:
        # A trace of another log is refused before the long work.
        followed = trace_run(given, solution.prepared)
    with clock.stage("references"):
        progress("references", 0, 0)
        references = _references(inside, solution)
        others = _variants(inside, references, solution)
        near = None
        for one in (*references.peers, *others):
            near = _better(near, likeness(inside, one, labelled=labelled))
    progress("check", 0, 0)
    found = compare_external(inside, references.optimum, references.peers, labelled=labelled)
    verified = solution.verified
    expected: RequiredGrade = "like" if given.estimator == "ekf" else "plausible"
    grade = _grade(require or expected, near, found, verified=verified)
    first = near and likeness(inside, references.peers[0], labelled=labelled)
    known = _facts(inside, first, references, solution, followed and followed[0])
    smoothed = solution.estimate
    covered = coverage(
        (inside.time_s, inside.pose),
        (smoothed.time_s, smoothed.pose),
        solution.prepared.timeline.observed_s(),
        min_coverage,
    )
    if covered.short:
        known = [one for one in known if one.gap != "coverage"]
    traced, causes = None, _causes(grade, known, found)
    if given.trace is not None and unsound:
        grade = replace(grade, value="wrong")
        causes = (cause.invalid(f"{given.trace.path.name}: {unsound}"), *causes)
    elif followed is not None:
        progress("trace", 0, 0)
        solved = solution.result, solution.estimate
        traced = check_trace(given, followed, solution.prepared, solved[0].options, solved)
        grade, causes = _traced(grade, causes, traced, first, solution, inside)
    if covered.short:
        grade = replace(grade, value=None)
    outcome = outcome_of(grade, verified=verified, association_known=_associated(solution))
    if covered.short:
        outcome = "disagree"
    if outcome == "unverified":
        causes = _left_open(solution, causes)
    small = []
    if outcome == "agree":
        small = [
            f"warning (grade reached): {one.gap}: {one.evidence}"
            for one in causes
            if one.gap in FILTER_FAULTS
        ]
        causes = ()
    remarks = (
        *small,
        *_remarks(given, found),
        *_beside(grade, known, found, outcome),
        *solution.doubts,
        *solution.notes,
    )
    if covered.short:
        # A wrong filter may have broken down.
        own = tuple(one for one in causes if one.gap in FILTER_FAULTS)
        rest = tuple(one for one in causes if one.gap not in FILTER_FAULTS)
        causes = (*own, _short(given, inside, covered), *rest)
    judged = EstimateUnderCheck(
        estimate=given,
        inside=inside,
        optimum=references.optimum,
        information=_information(given, near),
        sensors=traced.sensors if traced else (),
    )
    return ExternalCheck(
        given=given,
        solution=solution,
        optimum=references.optimum,
        peers=references.peers,
        variants=others,
        agreement=found,
        coverage=covered,
        trace=traced,
        grade=grade,
        outcome=outcome,
        causes=causes,
        remarks=remarks,
        answers=Answers(_known(solution, traced, judged), CHECKS),
    )


def _associated(solution: Solution) -> bool:
    """Whether the references' association is known: by labels, or beyond doubt."""
    checked = solution.association_check
    return checked is None or checked.verified


def _facts(
    given: ExternalEstimate,
    near: Likeness | None,
    references: _References,
    solution: Solution,
    run: EkfRun | None,
) -> list[Cause]:
    """Why the estimate is not like the first reference of its kind. run: of its trace."""
    if near is None:
        return []
    known = facts(given, near, references.clues)
    twice = duplicates(given, near, solution.log, run)
    if not twice:
        return known
    return [duplicate_cause(twice), *(one for one in known if one.gap != "map")]


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
        return by_trace(grade, traced), (*of_map, *_with_trace((), traced.verdict.causes))
    return by_trace(own, traced), _with_trace(causes, traced.verdict.causes)


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


def _left_open(solution: Solution, causes: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """What is lacking for a verdict first.

    No difference from a reference is a cause whose own association may be wrong.
    """
    optimality, checked = solution.result.optimality, solution.association_check
    lacking = (unverified(optimality),) if optimality.lacks else ()
    if checked is None or checked.verified:
        return (*lacking, *causes)
    doubt = doubted_association(len(checked.against), len(checked.variants))
    return (doubt, *lacking, *(one for one in causes if one.gap in FILTER_FAULTS))


def _short(given: ExternalEstimate, inside: ExternalEstimate, covered: TimeCoverage) -> Cause:
    """Too little is covered, which may be the clock's fault."""
    outside, (first, last) = len(given.time_s) - len(inside.time_s), covered.span_s
    if outside <= (1.0 - covered.least) * len(given.time_s):
        return cause.coverage(covered.evidence, covered.least)
    evidence = (
        f"{outside} of {len(given.time_s)} poses lie outside the log's time: the estimate's times "
        f"are {given.time_s[0]:.1f} to {given.time_s[-1]:.1f} s, the log's {first:.1f} to "
        f"{last:.1f} s{clock_words(given.time_s, covered.span_s)}; so {covered.evidence}"
    )
    hint = "check the clock of the estimate before any other cause"
    return cause.coverage(evidence, covered.least, hint)


def _information(given: ExternalEstimate, near: Likeness | None) -> Information | None:
    """What its poses know of the log: as it says, or else as a reference does that it is like."""
    filtered, smoothed = (given.may_be(kind) for kind in ("filtered", "smoothed"))
    if filtered != smoothed or given.information is not None:
        return given.information or ("filtered" if filtered else "smoothed")
    if near is None or near.grade is None:
        return None
    return "smoothed" if near.reference.smoothed else "filtered"


def _references(given: ExternalEstimate, solution: Solution) -> _References:
    """Of a log with loop closures no filter is a peer, for none of ours uses these."""
    optimum = smoother(solution, given.time_s)
    smoothed = optimum.pose, optimum.pose_covariance
    closed, ekf = solution.log.loop_closures is not None, None
    if given.may_be("filtered") and not closed:
        ekf = reference_ekf(solution.prepared, given.time_s)
    peers: tuple[Reference, ...] = () if ekf is None else (ekf[0],)
    if given.may_be("smoothed"):
        peers += (optimum,)

    def filtered() -> tuple[Array, Array] | None:
        run = ekf or reference_ekf(solution.prepared, given.time_s)
        return run and (run[0].pose, run[0].pose_covariance)

    clues = Clues(before=ekf and ekf[1], smoothed=smoothed, filtered=filtered, closed=closed)
    return _References(optimum, peers, clues)


def _variants(
    given: ExternalEstimate, references: _References, solution: Solution
) -> tuple[Reference, ...]:
    """Other filters than the reference EKF, where the estimate is neither equal nor hopeless."""
    if references.clues.before is None:
        return ()
    found = [likeness(given, one, labelled=solution.prepared.labelled) for one in references.peers]
    equal = any(one.grade == "equal" for one in found)
    if equal or not ROUNDING < found[0].sigma < _HOPELESS_SIGMA:
        return ()
    return tuple(variants(solution.prepared, given.time_s))


def _better(first: Likeness | None, second: Likeness) -> Likeness:
    """The second where it is nearer by more than rounding, by grade, then by largest difference."""
    if first is None:
        return second
    ranks = [GRADES.index(one.grade or "wrong") for one in (first, second)]
    if ranks[0] != ranks[1]:
        return second if ranks[1] > ranks[0] else first
    return second if second.farthest < first.farthest * (1.0 - ROUNDING) else first


def _grade(
    required: RequiredGrade, near: Likeness | None, found: ExternalAgreement, *, verified: bool
) -> Graded:
    value: Grade | None = near.grade if near else None
    if value is None and verified:
        value = "wrong" if found.against else "plausible"
    return Graded(value=value, required=required, by=near)


def _causes(grade: Graded, known: list[Cause], found: ExternalAgreement) -> tuple[Cause, ...]:
    """Why the grade is not higher."""
    causes = list(known)
    if found.against and grade.value in ("wrong", None):
        hint = (
            "probably a consequence of the causes above"
            if known
            else "check associations, signs and noise"
        )
        causes.append(Cause("optimum", "; ".join(found.against), hint))
    if not causes and not grade.enough and grade.by is not None:
        name, sigma = grade.by.reference.name, grade.by.sigma
        evidence = f"the estimate differs from {name} by up to {sigma:.2g} sigma"
        causes.append(Cause("grade", evidence, "check the rounding of the numbers in the files"))
    return tuple(causes)


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
    own = traced.own.at(inside.time_s)
    if not len(own.time_s):
        return grade
    near = likeness(with_poses(inside, np.isin(inside.time_s, own.time_s)), own, labelled=labelled)
    return grade if near.grade is None else replace(grade, value="like", by=near)


def by_trace(grade: Graded, traced: TraceCheck) -> Graded:
    """An estimate that is like no filter is wrong if its trace has a fault that matters.

    However near it came. What matters is a gap beyond those of `like`, or misused data.
    """
    if grade.value in ("like", "equal"):
        return grade
    gaps: dict[str, Gap] = {"algebra": traced.agreement.algebra, "model": traced.agreement.model}
    like = Allowed(LIKE_SIGMA, LIKE_VARIANCE)
    small = {name for name, gap in gaps.items() if gap.explained_by(like)}
    faults = {one.gap for one in traced.verdict.causes} & FILTER_FAULTS
    return replace(grade, value="wrong") if faults - small else grade


def outcome_of(grade: Graded, *, verified: bool, association_known: bool = True) -> Outcome:
    """An optimum that is not verified leaves open only what is measured by it.

    association_known: by labels, or beyond doubt; if not, the references may be wrong themselves.
    """
    if grade.value == "wrong":
        return "disagree"
    if grade.value is None and not association_known:
        return "unverified"
    by_optimum = grade.by is None or grade.by.grade is None or grade.by.reference.smoothed
    if by_optimum and not verified and not (grade.value is None and grade.required != "plausible"):
        return "unverified"
    return "agree" if grade.enough else "disagree"


def _with_trace(found: tuple[Cause, ...], traced: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """The trace's causes first; linearisation stands for what it explains.

    Before them what explains all of the poses' difference, a fault of what was written.
    """
    kept = tuple(one for one in traced if one.gap in (*FILTER_FAULTS, "linearisation"))
    explained = ("estimate", "covariance", "optimum") if kept else ()
    first = tuple(one for one in found[:1] if one.gap in MOTIONS)
    rest = tuple(one for one in found[len(first) :] if one.gap not in explained)
    return first + kept + rest


def _beside(
    grade: Graded, known: list[Cause], found: ExternalAgreement, outcome: Outcome
) -> list[str]:
    """What the grade does not say."""
    remarks = []
    if grade.value == "plausible" and outcome == "agree":
        remarks += [
            f"the estimate is plausible, but not like a reference: {one.evidence}" for one in known
        ]
    if grade.value in ("like", "equal") and found.against:
        remarks.append(
            "the filter is like the reference, but far from the optimum because of "
            f"linearisation: {'; '.join(found.against)}"
        )
    if grade.by is not None and grade.by.single and grade.value in ("like", "equal"):
        remarks.append(
            "the estimate is stored in single precision; the comparison allows for its rounding"
        )
    return remarks


def _remarks(given: ExternalEstimate, found: ExternalAgreement) -> list[str]:
    """How the verdict is narrowed by what was not handed in."""
    remarks = []
    if absent := given.absent:
        if "landmarks" in absent:
            absent = [one for one in absent if one in ("landmarks", "pose covariances")]
        compared = ["poses"] if given.pose_covariance is None else ["poses", "pose covariances"]
        compared += ["landmarks"] if found.landmarks else []
        remarks.append(
            f"the estimate has no {', no '.join(absent)}; compared {' and '.join(compared)} only"
        )
    if given.left_out:
        remarks.append(given.left_out)
    if len(found.time_s) < len(given.time_s):
        remarks.append(
            f"{len(given.time_s) - len(found.time_s)} poses lie outside the log's time and "
            "were left out"
        )
    if found.last is None:
        remarks.append("the estimate ends before the log, so its last pose was not compared")
    if given.trace is not None:
        remarks += given.trace.remarks
        if given.joint_covariance is None:
            remarks.append(
                "the trace has no last_pose_and_landmarks beside it, so the algebra is not checked"
            )
    if given.removed is not None:
        remarks.append(f"landmarks of the log that the map lacks: {given.removed.words}")
    if found.unmatched:
        remarks.append(f"{found.unmatched} landmarks of the estimate are not in the smoother's map")
    return remarks
