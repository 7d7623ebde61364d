"""The ways in which a given estimate may be read, each of which is graded again.

In: the check of an estimate that does not agree; out: readings of it, by kind, the simplest first.
A reading may be another log (labels from the estimate's map, measurements left out, another
integration of steps), another estimate (a motion of the whole undone), another filter beside it
(its sigma points, a fault, the spread of sound filters), or other edges of a graph that it is the
optimum of. `comparisons.jobs.check` decides which is taken. `stated` and `integrated` give the
grade as clock, trace and steps say, before any of these.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from comparisons.adapters.motion import CLOCK_S
from comparisons.checks.algebra import HINT as ALGEBRA_HINT
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.diagnosis.diagnosis import MOTIONS
from comparisons.checks.diagnosis.estimate_facts import UndoneMotion, paths_beside, undone_motions
from comparisons.checks.diagnosis.model_differences import PREDICTIONS
from comparisons.checks.external_agreement import within_log
from comparisons.checks.grade import (
    LIKE_SIGMA,
    LIKE_VARIANCE,
    EstimatePart,
    Likeness,
    likeness,
    nearer,
    outcome_of,
)
from comparisons.checks.model import HINT as MODEL_HINT
from comparisons.checks.spread import within_spread
from comparisons.estimates.external import ExternalEstimate, with_poses
from comparisons.estimates.reference import Reference
from comparisons.explain.disagreement import MOST_EDGES
from comparisons.explain.other_optima import other_optimum
from comparisons.faults.catalogue import is_setting
from comparisons.fingerprints.clock import on_log_clock
from comparisons.fingerprints.data_use import (
    LeftOut,
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
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.external_trace import TraceCheck, trace_run
from comparisons.jobs.grading import Grader, asks_for_variants
from comparisons.logs.log import Log
from comparisons.logs.odometry import Integration
from comparisons.logs.stamps import at_instants
from comparisons.pipeline.references import APART, FILTERS, ORDERS
from comparisons.rounding import ROUNDING
from comparisons.words import Cause

_EXACT_SHARE = 0.2
"""Share of one measurement's sigmas below which a start is exact."""


class Reading(ABC):
    """One way in which a given estimate may be read.

    stands: it names a filter that reproduces the estimate, so that it is taken whatever is asked
    of the estimate; else it is taken if the estimate agrees by it.
    """

    stands: ClassVar[bool] = False

    @abstractmethod
    def apply(self, grader: Grader) -> ExternalCheck:
        """Return the estimate's grade by this reading."""

    @abstractmethod
    def reported(self, check: ExternalCheck) -> ExternalCheck | None:
        """Return the check by which this reading is taken, with what to say of it.

        None where it explains nothing after all.
        """


@dataclass(frozen=True)
class LogReading(Reading):
    """References and smoother of another log.

    words: a remark. given: what is graded beside them. near: of a filter on that log, run already,
    that it is like.
    """

    words: str
    log: Log
    given: ExternalEstimate
    near: Likeness | None = None

    def apply(self, grader: Grader) -> ExternalCheck:
        """Return the grade by the other log, or by the filter that was run on it."""
        check, near = grader.graded(self.given, self.log), self.near
        if near is None or check.outcome == "agree" or check.coverage.short:
            return check
        return _as_near(_beside(check, near), near)

    def reported(self, check: ExternalCheck) -> ExternalCheck:
        """Return the check with a remark."""
        return remarked(check, self.words)


@dataclass(frozen=True)
class FilterReading(Reading):
    """Another filter beside the estimate, which reproduces it.

    words: a remark, empty where the causes say it. check: by this filter.
    """

    words: str
    check: ExternalCheck
    stands: ClassVar[bool] = True

    def apply(self, grader: Grader) -> ExternalCheck:
        """Return the check by this filter."""
        return self.check

    def reported(self, check: ExternalCheck) -> ExternalCheck:
        """Return the check with a remark."""
        return remarked(check, self.words)


@dataclass(frozen=True)
class MotionReading(Reading):
    """The estimate without a motion of all of it.

    first: the check of the estimate as it is.
    """

    first: ExternalCheck
    undone: UndoneMotion

    def apply(self, grader: Grader) -> ExternalCheck:
        """Return the grade of what is left, by steps of its own."""
        grader, check = stated(grader, self.undone.given)
        return check if check.exact else integrated(grader, check, ORDERS)

    def reported(self, check: ExternalCheck) -> ExternalCheck | None:
        """Return the first check with the motion as its first cause, if a filter or S is near."""
        near, motion = check.grade.by, self.undone.motion
        if near is None:
            return None
        then = "the rest of the difference has the next cause"
        if near.grade == "equal" or (check.outcome == "agree" and near.grade == "like"):
            equal = "equals" if near.grade == "equal" else "is like"
            then = f"the estimate {equal} {near.reference.name} ({near.farthest:.2g} sigma)"
        elif check.outcome == "agree":
            then = "the estimate is plausible beside the smoother"
        said = Cause(motion.gap, f"{motion.said}; with this corrected, {then}", motion.hint)
        left = [motion.gap, *(cause.gap for cause in check.causes)]
        return replace(
            self.first,
            causes=(said, *check.causes),
            consequences=tuple(cause.gap for cause in self.first.causes if cause.gap not in left),
            remarks=check.remarks,
            reproduced=check.reproduced,
        )


class ReadingKind(NamedTuple):
    """One kind of readings.

    readings: of an estimate by its check, the likeliest first; none where the kind does not apply.
    beside: kinds that are tried beside a reading of this one.
    """

    readings: Callable[[Grader, ExternalCheck], Iterable[Reading]]
    beside: tuple[ReadingKind, ...] = ()


def remarked(check: ExternalCheck, *remarks: str) -> ExternalCheck:
    """Return a check with remarks before all others; empty ones are none."""
    return replace(check, remarks=(*filter(None, remarks), *check.remarks))


def stated(grader: Grader, given: ExternalEstimate) -> tuple[Grader, ExternalCheck]:
    """Return the grade as an estimate's clock, its trace and its steps say that it is to be read.

    The grader that is returned has the log without what the trace's filter left out by a rule.
    """
    instants_s, words = grader.prepared.timeline.instants_s(), ""
    given = on_log_clock(given, grader.log, instants_s)
    placed = replace(given, time_s=at_instants(given.time_s, instants_s))
    left_out = _left_out_by_trace(grader, placed)
    if left_out is not None:
        words = left_out.said(grader.log)
        grader = replace(grader, log=without(grader.log, left_out.rows))
    solution = grader.solved(grader.log)
    inside = with_poses(placed, within_log(placed, solution.estimate))
    steps = integrations_by_steps(inside, solution.prepared)
    if steps:
        return grader, remarked(_moving(grader, given, steps), words)
    return grader, remarked(grader.graded(given, grader.log), words)


def _left_out_by_trace(grader: Grader, placed: ExternalEstimate) -> LeftOut | None:
    """What the filter of a trace left out by a rule, if it is one of the log's labels.

    placed: the estimate at the log's instants.
    """
    file, count = placed.trace, len(grader.log.measurements.landmark)
    if file is None or file.unsound or not grader.prepared.labelled:
        return None
    if grader.log.known_landmarks is not None or file.measurements_used == count:
        return None
    return left_out_of(grader.log, trace_run(placed, grader.prepared)[0])


def moved_back(grader: Grader, first: ExternalCheck, motion: UndoneMotion) -> ExternalCheck | None:
    """Return the check with a motion of all of an estimate as its first cause."""
    reading = MotionReading(first, motion)
    return reading.reported(reading.apply(grader))


def integrated(grader: Grader, first: ExternalCheck, filters: Iterable[str]) -> ExternalCheck:
    """Return the check with the estimate's own integration of steps, where that is not the log's.

    filters: names of those that it may be of.
    """
    others = integrations_of(first.inside, first.solution.prepared, first.grade.by, filters)
    return _moving(grader, first.given, others) if others else first


def _moving(
    grader: Grader, given: ExternalEstimate, integrations: tuple[Integration, ...]
) -> ExternalCheck:
    """The grade beside references of the first of integrations that explain an estimate's steps."""
    reading = _of_integrations(grader, given, integrations)
    return reading.reported(reading.apply(grader))


def _of_integrations(
    grader: Grader, given: ExternalEstimate, integrations: tuple[Integration, ...]
) -> LogReading:
    """References that move by the first of integrations that explain an estimate's steps."""
    steps = " or ".join(in_words(integration) for integration in integrations)
    words = f"the estimate integrates steps {steps}; references and smoother do so, too"
    return LogReading(words, grader.integrated(integrations[0]), given)


def _by_other_filters(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """Another integration of steps, in any filter that the references have."""
    if not asks_for_variants(first.by_peer):
        return
    prepared, near = first.solution.prepared, first.grade.by
    if others := integrations_of(first.inside, prepared, near, FILTERS):
        yield _of_integrations(grader, first.given, others)


def _by_map(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """Labels that the estimate's map implies, where the log has none that are used."""
    solution = first.solution
    if solution.prepared.labelled:
        return
    implied = map_labels(first.inside, solution.log.measurements, solution.landmark_index)
    if implied is None:
        return
    log = labelled_as(solution.log, implied.label)
    other = grader.solved(log)
    if plausible(other.result.optimality, other.estimate):
        yield LogReading(implied.said(), log, with_removed(first.given, log))


def _without_some(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """Measurements left out that the estimate's filter seems to leave out.

    None where a trace says what it used, or labels do not say of what measurements are.
    """
    prepared = first.solution.prepared
    known = prepared.labelled and prepared.log.known_landmarks is None
    if first.trace is not None or not known or not first.peers or first.peers[0].smoothed:
        return
    found = find_left_out(first.inside, prepared, first.by_peer[0])
    if found is not None:
        left_out, near = found
        log = without(prepared.log, left_out.rows)
        yield LogReading(left_out.said(grader.log), log, first.given, near)


def _of_sigma_points(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """The unscented filter of the estimate's own sigma points, if it is like one."""
    prepared, inside = first.solution.prepared, first.inside
    if _filter_like(first) is None:
        return
    best = None
    for reference in unscented_filters(inside, prepared, first.by_peer[0]):
        best = nearer(best, likeness(inside, reference, labelled=prepared.labelled))
        if best.grade == "equal":
            break
    if best is not None and best.grade is not None:
        yield FilterReading("", _as_near(_beside(first, best), best))


def _with_fault(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """The reference filter with the fault by which it reproduces the estimate, if there is one."""
    prepared, sound, inside = first.solution.prepared, first.grade.by, first.inside
    filters = [near for near in first.by_peer if not near.reference.smoothed]
    if not filters:
        return
    if sound is None or sound.reference.smoothed:
        sound = filters[0]
    # A motion of the whole, or a factor on covariances beside right means, is simpler than several.
    simple = sound.sigma <= ROUNDING or (first.causes and first.causes[0].gap in MOTIONS)
    # Beside an association in doubt, which jumps, nothing is linear that several could be fit by.
    several = not simple and (prepared.labelled or first.solution.verified)
    known = fingerprints(inside, prepared, sound, grader.progress, several=several)
    if not known:
        return
    if words := _without_effect(known[0], sound, first):
        yield FilterReading(words, _as_near(first, replace(sound, grade="like")))
        return
    nearest, follow = known[0], tuple[str, ...]()
    others = tuple(cause for cause in first.causes if cause.gap in FILTER_FAULTS)
    if nearest.whole:  # the same poses, landmarks and covariances, so all that differs from sound
        others = tuple(_following(cause) for cause in others)
        follow = tuple(
            cause.gap for cause in first.causes if cause.gap in ("estimate", "covariance")
        )
    causes = (fault_cause(nearest, sound), *others)
    check = replace(first, causes=causes, consequences=follow, reproduced=nearest.whole)
    yield FilterReading("", check)


def _by_other_edges(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """The graph with other edges, of which the estimate is the optimum, if there are any."""
    solution, given = first.solution, first.inside
    problem, time_s = solution.result.problem, solution.estimate.time_s
    known = bool(first.causes) and first.causes[0].gap == "data"  # the odometry alone
    if known or solution.log.loop_closures is None or len(given.time_s) != len(time_s):
        return
    edges = len(problem.steps) + len(problem.loop_closures.first)
    if edges > MOST_EDGES or np.abs(given.time_s - time_s).max() > CLOCK_S:
        return
    grader.progress("other edges", 0, 0)
    optimum = other_optimum(problem, given.pose)
    if optimum is None:
        return
    cause = Cause("fault", str(optimum), "correct this in the optimiser")
    follow = tuple(dict.fromkeys(one.gap for one in first.causes))
    check = replace(first, causes=(cause,), consequences=follow, reproduced=True)
    yield FilterReading("", check)


def _of_spread(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """The sound filters, if the estimate is as near to one as they are to each other."""
    near, labelled = _filter_like(first), first.solution.prepared.labelled
    if near is None:
        return
    sound = [filter_ for filter_ in sound_filters(grader, first) if filter_.name not in APART]
    for reference in sound:
        near = nearer(near, likeness(first.inside, reference, labelled=labelled))
    if not within_spread(near, sound, labelled=labelled):
        return
    words = (
        f"the estimate is up to {near.sigma:.2g} sigma from {near.reference.name}, its nearest, "
        f"and no part of it is farther than one of {len(sound) - 1} other sound filters is"
    )
    yield FilterReading(words, _as_near(first, replace(near, grade="like")))


def sound_filters(grader: Grader, check: ExternalCheck) -> list[Reference]:
    """Return the sound filters beside an estimate, whole: peers, variants, all others."""
    others = grader.filters(check.solution).variants(check.inside.time_s)
    filters = {reference.name: reference for reference in (*check.peers, *check.variants, *others)}
    return [reference for reference in filters.values() if not reference.smoothed]


def _by_motion(grader: Grader, first: ExternalCheck) -> Iterator[Reading]:
    """The estimate without the simplest motion of all of it, and without another frame alone.

    None where there is a trace, which says how its filter moved.
    """
    if first.trace is not None or not first.peers or not first.peers[0].known.any():
        return
    if first.causes and first.causes[0].gap in MOTIONS:
        return
    paths = paths_beside(first.inside, first.peers[0], first.optimum.pose)
    instants_s = first.solution.prepared.timeline.instants_s()
    for undone in undone_motions(first.given, paths, instants_s):
        yield MotionReading(first, undone)


def _beside(check: ExternalCheck, near: Likeness) -> ExternalCheck:
    """The check with one more sound filter beside it."""
    return replace(check, variants=(*check.variants, near.reference))


def _as_near(check: ExternalCheck, near: Likeness) -> ExternalCheck:
    """The check of an estimate that has the grade that it has beside a filter."""
    grade = replace(check.grade, value=near.grade, by=near)
    outcome = outcome_of(grade, verified=check.solution.verified)
    causes = () if outcome == "agree" else check.causes
    return replace(check, grade=grade, outcome=outcome, causes=causes)


def _filter_like(check: ExternalCheck) -> Likeness | None:
    """What an estimate is most like, if that is a filter, and nothing else speaks against it.

    None where its trace has a fault, or too little is covered.
    """
    near, traced = check.grade.by, check.trace
    faulty = traced is not None and any(
        cause.gap in FILTER_FAULTS for cause in traced.verdict.causes
    )
    if faulty or near is None or near.reference.smoothed or not asks_for_variants(check.by_peer):
        return None
    return None if check.coverage.short else near


def _following(caused: Cause) -> Cause:
    """A trace's cause beside the fault that explains it: what the trace itself shows stays."""
    general = caused.hint.startswith((ALGEBRA_HINT, MODEL_HINT))
    return caused if not general else replace(caused, hint="a consequence of the fault above")


def _without_effect(known: Fingerprint, sound: Likeness, check: ExternalCheck) -> str:
    """Say that an estimate differs from a sound one by a setting that changes nothing in the end.

    "" for what is no setting of the filter's start and noise, and where it changes the last pose or
    the map, or the trace differs from the models in more. Where both starts are exact beside what
    one measurement tells, covariances may differ, which they make those of another frame.
    """
    alone = known.whole and not known.several and is_setting(known.fault)
    if not alone or sound.missing or sound.unmapped:
        return ""
    if check.trace is not None and not _of_settings(check.trace):
        return ""
    poses, *others = sound.parts
    last = EstimatePart(poses.name, poses.sigma[-1:], poses.least[-1:], poses.largest[-1:])
    variance = np.inf if _both_exact(check) else LIKE_VARIANCE
    if not all(part.within(LIKE_SIGMA, variance) for part in (last, *others)):
        return ""
    ends = replace(sound, parts=(last, *others))
    low, high = ends.variances or (1.0, 1.0)
    return (
        f"{known.fault}: with this {sound.reference.name} equals the estimate "
        f"({known.sigma:.1g} sigma); without it the last pose and the map differ by at most "
        f"{ends.sigma:.2g} sigma, and by variances of {low:.3g} to {high:.3g} times"
    )


def _both_exact(check: ExternalCheck) -> bool:
    """Whether the log's start and the estimate's are exact beside what one measurement tells."""
    log, given = check.solution.log, check.inside
    start = None if check.given.trace is None else check.given.trace.trace.prior_covariance
    if start is None and given.pose_covariance is not None:
        start = given.pose_covariance[0] if given.time_s[0] <= log.prior.time_s + CLOCK_S else None
    measurements = log.measurements
    if start is None or not len(measurements.time_s):
        return False
    place, turn = measurements.sigma_range_m.min(), measurements.sigma_bearing_rad.min()
    limit = (_EXACT_SHARE * np.array((place, place, turn))) ** 2
    return bool((np.diag(start) <= limit).all() and (np.diag(log.prior.covariance) <= limit).all())


def _of_settings(traced: TraceCheck) -> bool:
    """Whether a trace differs from the models in the prior and the noise of predictions alone."""
    causes = {cause.gap for cause in traced.verdict.causes} & set(FILTER_FAULTS)
    differences = traced.known.records.differences
    return causes <= {"model"} and all(
        difference.relation == "priors"
        or (difference.relation == PREDICTIONS and difference.quantity == "the noise covariance")
        for difference in differences
    )


_WITHOUT_SOME = ReadingKind(_without_some)
_SPREAD = ReadingKind(_of_spread)
FAULT = ReadingKind(_with_fault)
_OF_ALL_AS_IT_IS = (
    ReadingKind(_by_other_edges),
    ReadingKind(_by_map, beside=(_WITHOUT_SOME,)),
    _WITHOUT_SOME,
    ReadingKind(_of_sigma_points),
    FAULT,
    _SPREAD,
    ReadingKind(_by_other_filters, beside=(_SPREAD,)),
)
MOTION = ReadingKind(_by_motion, beside=_OF_ALL_AS_IT_IS)
READINGS = (*_OF_ALL_AS_IT_IS, MOTION)
"""The simplest first: the estimate as it is, then the same once it is moved."""
