"""The check job: someone else's estimate of a log, graded by a filter like it and the optimum.

Where it does not agree as its clock, its trace and its steps say that it is to be read, it is read
in other ways, the simplest first, and the first that explains it is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.diagnosis.alignment import laid_at_start
from comparisons.checks.diagnosis.departure import departure_from
from comparisons.checks.diagnosis.diagnosis import FEWEST
from comparisons.checks.qualifiers import TruthGapFinding, qualified
from comparisons.checks.unused_positions import UnusedPositionsFinding
from comparisons.config import CheckConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.clock import (
    counts_as_file,
    on_file_clock,
    on_log_clock,
    works_with_floats,
    written_from_floats,
)
from comparisons.fingerprints.data_use import with_removed
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import Grader, asks_for_variants
from comparisons.jobs.readings import (
    READINGS,
    ReadingKind,
    integrated,
    moved_back,
    remarked,
    sound_filters,
    stated,
)
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.stamps import rounded
from comparisons.logs.transforms.clock import timed_by_floats
from comparisons.pipeline.clock import Progress, no_progress
from comparisons.pipeline.references import EKF, ORDERS
from comparisons.pipeline.size import announce_time
from comparisons.pipeline.solve import Solution, solve


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
    grader = Grader(log=log, config=config or CheckConfig(), progress=progress, solver=solver)
    announce_time(grader.prepared)
    given = with_removed(given.numbered_as(log.labels), log)
    given, aligned = _aligned(grader, given)
    grader, result = _clocked(grader, given)
    unsound = given.trace is not None and given.trace.unsound
    if result.motion is not None and result.outcome != "agree":
        result = moved_back(grader, result, result.motion) or result
    elif not (result.exact or unsound or len(result.inside.time_s) < FEWEST):
        progress("motion models", 0, 0)
        result = integrated(grader, result, ORDERS)
        result = _with_departure(grader, explained(grader, result, READINGS) or result)
    instants_s = result.solution.prepared.timeline.instants_s()
    digits = rounded(given.time_s, on_file_clock(given.time_s, log, instants_s))
    before = replace(result.before, source=log)
    return _qualified(replace(remarked(result, aligned, digits), before=before))


def _aligned(grader: Grader, given: ExternalEstimate) -> tuple[ExternalEstimate, str]:
    """The estimate in the log's frame where that is asked for, and how it was moved."""
    if not grader.config.log.align:
        return given, ""
    instants_s = grader.prepared.timeline.instants_s()
    return laid_at_start(given, on_log_clock(given, grader.log, instants_s).time_s, grader.log)


def _clocked(grader: Grader, given: ExternalEstimate) -> tuple[Grader, ExternalCheck]:
    """The grade by the times of the log that the estimate's filter had, and what grades by these.

    One that counts as the log's file does, since 1970, may have read these stamps as floats; both
    are tried to the end only where the poses of a smoother do not tell.
    """
    stamped = [given.time_s] + ([given.trace.step_time_s] if given.trace is not None else [])
    by_files = any(counts_as_file(time_s, grader.log) for time_s in stamped)
    if isinstance(grader.log.odometry, RelativePoses) or not by_files:
        return stated(grader, given)
    by_floats = replace(grader, log=timed_by_floats(grader.log))
    floats = works_with_floats(given, grader.prepared, by_floats.prepared)
    graders = [grader, by_floats]
    if floats or (floats is None and written_from_floats(given)):
        graders.reverse()
    first = stated(graders[0], given)
    if floats is None and given.may_be("smoothed") and first[1].grade.value != "equal":
        second = stated(graders[1], given)
        if second[1].grade.value == "equal":
            return second
    return first


def explained(
    grader: Grader, check: ExternalCheck, kinds: Iterable[ReadingKind]
) -> ExternalCheck | None:
    """Return the check by the first reading that explains an estimate; itself where that agrees.

    A reading explains an estimate that agrees by it, alone or together with one of those that are
    tried beside it, and one that is reproduced by a filter that the reading names.

    Args:
        grader: Of the log as the estimate's filter had it.
        check: Of the estimate as it is.
        kinds: Of readings, the simplest first.

    Returns:
        The check with what the reading says; None where none explains the estimate.
    """
    if check.outcome == "agree":
        return check
    for kind in kinds:
        for reading in kind.readings(grader, check):
            again = reading.apply(grader)
            by_it = again if reading.stands else explained(grader, again, kind.beside)
            taken = None if by_it is None else reading.reported(by_it)
            if taken is not None:
                return taken
    return None


def _with_departure(grader: Grader, external_check: ExternalCheck) -> ExternalCheck:
    """Say where it first leaves what a sound filter of its kind does."""
    prepared, inside = external_check.solution.prepared, external_check.inside
    left = None if external_check.trace is None else external_check.trace.departure
    if left is None:
        sound = _to_leave(grader, external_check)
        left = departure_from(inside, sound, prepared.log, prepared.timeline)
    if left is None:
        return external_check
    said = (
        ""
        if external_check.outcome == "agree"
        else left.briefly
        if external_check.reproduced
        else str(left)
    )
    return replace(remarked(external_check, said), departure=left)


def _to_leave(grader: Grader, external_check: ExternalCheck) -> list[Reference]:
    """Sound filters that an estimate may leave: all where nothing else explains it.

    Else those that it may be like, or those that differ by their order alone.
    """
    explained_as_is = external_check.outcome == "agree" or external_check.reproduced
    if asks_for_variants(external_check.by_peer) and not explained_as_is:
        return sound_filters(grader, external_check)
    sound = [
        reference
        for reference in (*external_check.peers, *external_check.variants)
        if not reference.smoothed
    ]
    if not sound or external_check.variants:
        return sound
    filters, time_s = grader.filters(external_check.solution), external_check.inside.time_s
    others = (filters.named(name, time_s) for name in ORDERS if name != EKF)
    return [*sound, *(reference for reference in others if reference is not None)]


def _qualified(external_check: ExternalCheck) -> ExternalCheck:
    """Say what a reader of the outcome must know as well, by what the checks find."""
    known = external_check.known
    consistency, beside = known.value(ConsistencyFinding), known.remarks
    if external_check.reproduced and consistency is not None and consistency.remarks:
        beside = [one for one in beside if one not in consistency.remarks]
        external_check = replace(
            external_check, consequences=(*external_check.consequences, "consistency")
        )
    return qualified(
        replace(external_check, before=known, remarks=(*external_check.remarks, *beside)),
        known.value(TruthGapFinding),
        unchecked="",
        consistency=consistency,
        unused=known.value(UnusedPositionsFinding),
        fail_on=(),
    )
