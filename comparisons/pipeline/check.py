"""The check job: someone else's estimate of a log, graded by a filter like it and the optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.checks import causes as cause
from comparisons.checks.accuracy import Accuracy, assess
from comparisons.checks.agreement import ROUNDING
from comparisons.checks.causes import Cause
from comparisons.checks.consistency.consistency import ExternalConsistency, external_consistency
from comparisons.checks.diagnosis.estimate_facts import Clues, facts
from comparisons.checks.external_agreement import (
    Coverage,
    ExternalAgreement,
    clock_words,
    compare_external,
    coverage,
    within_log,
)
from comparisons.checks.grade import GRADES, Grade, Likeness, Reference, likeness
from comparisons.checks.verdict import Outcome
from comparisons.choices import RequiredGrade
from comparisons.config import MIN_COVERAGE, CheckConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log
from comparisons.pipeline.external_trace import TraceCheck, check_trace
from comparisons.pipeline.prepare import Progress, no_progress
from comparisons.pipeline.references import reference_ekf, smoother, variants
from comparisons.pipeline.solve import Solution, solve

if TYPE_CHECKING:
    from pandas import DataFrame

_OWN = ("data", "algebra", "model")
"""Causes that the filter's trace shows whatever the smoother found."""
_HOPELESS_SIGMA = 10.0
"""So far from the reference EKF no variant of it is tried, nor where the means are the EKF's."""


@dataclass(frozen=True, kw_only=True)
class Graded:
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
class ExternalCheck:
    """Hold what the check of an external estimate found.

    Attributes:
        given: The estimate that was checked.
        solution: The smoother's, of the same log.
        optimum: The smoother at the given times.
        peers: Correct estimates of the kinds that the given one may be.
        agreement: The estimate against the smoother.
        coverage: Share of the log's time that it covers.
        consistency: Its errors, and whether its covariances match them.
        accuracy: Its errors, where the log has truth or positions.
        trace: The filter's own gaps, where it handed in a trace.
        grade: `equal`, `like`, `plausible` or `wrong`, with what it was compared with.
        outcome: `agree`, `disagree` or `unverified`.
        causes: Why the grade is not higher, the most important first.
        remarks: What narrows the verdict.
    """

    given: ExternalEstimate
    solution: Solution
    optimum: Reference
    peers: tuple[Reference, ...]
    agreement: ExternalAgreement
    coverage: Coverage
    consistency: ExternalConsistency
    accuracy: Accuracy | None
    trace: TraceCheck | None
    grade: Graded
    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]

    def __repr__(self) -> str:
        """Return log, outcome, grade and the causes' names in one line."""
        gaps = ", ".join(one.gap for one in self.causes)
        name, grade = self.solution.log.name, self.grade.value or "none"
        return f"<ExternalCheck of {name}: {self.outcome}, grade {grade}{gaps and f' ({gaps})'}>"

    def _repr_html_(self) -> str:
        from comparisons.report.notebook import check_html

        return check_html(self)

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
        from comparisons.report.tables import check_tables, data_frame

        return data_frame(check_tables(self), table)


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
    config = config or CheckConfig()
    solution = solver(log, config, progress)
    return check_external(
        given, solution, config.require, progress, min_coverage=config.min_coverage
    )


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
    inside = _chosen(given, within_log(given, solution.estimate))
    with clock.stage("references"):
        progress("references", 0, 0)
        references = _references(inside, solution)
        near = _nearest(inside, references, solution)
    progress("check", 0, 0)
    found = compare_external(inside, references.optimum, references.peers, labelled=labelled)
    verified = solution.verified
    grade = _grade(require or _expected(given), near, found, verified=verified)
    first = near and likeness(inside, references.peers[0], labelled=labelled)
    known = facts(inside, first, references.clues) if first else []
    smoothed = solution.estimate
    covered = coverage(inside.time_s, smoothed.time_s, inside.pose, smoothed.pose)
    short = covered.share < min_coverage
    if short:
        known = [one for one in known if one.gap != "coverage"]
    traced, causes = None, _causes(grade, known, found)
    if given.trace is not None:
        progress("trace", 0, 0)
        traced = check_trace(given, solution.prepared, solution.result.options)
        causes = _with_trace(causes, traced.verdict.causes)
    outcome = _outcome(grade, causes, verified=verified)
    if outcome == "unverified":
        optimality = solution.result.optimality
        if optimality.lacks:
            causes = (cause.unverified(optimality), *causes)
    elif outcome == "agree":
        causes = ()
    remarks = (
        *_remarks(given, found),
        *_beside(grade, known, found, outcome),
        *_on_association(solution),
    )
    if short:
        own = tuple(one for one in causes if one.gap in _OWN)  # a wrong filter may have broken down
        rest = tuple(one for one in causes if one.gap not in _OWN)
        outcome = "disagree"
        causes = (*own, _short(given, inside, covered, min_coverage), *rest)
    return ExternalCheck(
        given=given,
        solution=solution,
        optimum=references.optimum,
        peers=references.peers,
        agreement=found,
        coverage=covered,
        consistency=external_consistency(
            inside,
            references.optimum,
            solution.estimate,
            solution.log,
            _information(given, near),
            labelled=labelled,
            robust=solution.result.options.robust,
        ),
        accuracy=assess(given.padded(), solution.log, labelled=labelled),
        trace=traced,
        grade=grade,
        outcome=outcome,
        causes=causes,
        remarks=remarks,
    )


def _short(
    given: ExternalEstimate, inside: ExternalEstimate, covered: Coverage, least: float
) -> Cause:
    """Too little is covered, which may be the clock's fault."""
    outside, (first, last) = len(given.time_s) - len(inside.time_s), covered.span_s
    if outside <= (1.0 - least) * len(given.time_s):
        return cause.coverage(covered.evidence, least)
    evidence = (
        f"{outside} of {len(given.time_s)} poses lie outside the log's time: the estimate's times "
        f"are {given.time_s[0]:.1f} to {given.time_s[-1]:.1f} s, the log's {first:.1f} to "
        f"{last:.1f} s"
        f"{clock_words(given.time_s, covered.span_s)}; so {covered.evidence}"
    )
    return cause.coverage(evidence, least, "check the clock of the estimate before any other cause")


def _on_association(solution: Solution) -> list[str]:
    """What speaks against the smoother's own association."""
    checked = solution.association_check
    return [] if checked is None else checked.remarks


def _information(given: ExternalEstimate, near: Likeness | None) -> str | None:
    """What its poses know of the log: as it says, or else as a reference does that it is like."""
    filtered, smoothed = (given.may_be(kind) for kind in ("filtered", "smoothed"))
    if filtered != smoothed or given.information is not None:
        return given.information or ("filtered" if filtered else "smoothed")
    if near is None or near.grade is None:
        return None
    return "smoothed" if near.reference.smoothed else "filtered"


def _expected(given: ExternalEstimate) -> RequiredGrade:
    """What is asked of an estimate by what it calls itself."""
    return "like" if given.estimator == "ekf" else "plausible"


def _chosen(given: ExternalEstimate, rows: NDArray[np.bool_]) -> ExternalEstimate:
    cover = None if given.pose_covariance is None else given.pose_covariance[rows]
    return replace(given, time_s=given.time_s[rows], pose=given.pose[rows], pose_covariance=cover)


def _references(given: ExternalEstimate, solution: Solution) -> _References:
    optimum = smoother(solution, given.time_s)
    smoothed = optimum.pose, optimum.pose_covariance
    ekf = reference_ekf(solution.prepared, given.time_s) if given.may_be("filtered") else None
    peers: tuple[Reference, ...] = () if ekf is None else (ekf[0],)
    if given.may_be("smoothed"):
        peers += (optimum,)

    def filtered() -> tuple[Array, Array] | None:
        run = ekf or reference_ekf(solution.prepared, given.time_s)
        return run and (run[0].pose, run[0].pose_covariance)

    clues = Clues(before=ekf and ekf[1], smoothed=smoothed, filtered=filtered)
    return _References(optimum, peers, clues)


def _nearest(
    given: ExternalEstimate, references: _References, solution: Solution
) -> Likeness | None:
    """The best of all likenesses; variants of the EKF are tried where it is not equal to it."""
    labelled, best = solution.prepared.labelled, None
    for peer in references.peers:
        best = _better(best, likeness(given, peer, labelled=labelled))
    if best is None or best.grade == "equal" or references.clues.before is None:
        return best
    if (
        not ROUNDING
        < likeness(given, references.peers[0], labelled=labelled).sigma
        < _HOPELESS_SIGMA
    ):
        return best
    for variant in variants(solution.prepared, given.time_s):
        best = _better(best, likeness(given, variant, labelled=labelled))
    return best


def _better(first: Likeness | None, second: Likeness) -> Likeness:
    """The second where it is nearer, by grade and then by the largest difference."""
    if first is None:
        return second
    ranks = [GRADES.index(one.grade or "wrong") for one in (first, second)]
    if ranks[0] != ranks[1]:
        return second if ranks[1] > ranks[0] else first
    return second if second.farthest < first.farthest else first


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
            "check the causes before this one" if known else "check associations, signs and noise"
        )
        causes.append(Cause("optimum", "; ".join(found.against), hint))
    if not causes and not grade.enough and grade.by is not None:
        name, sigma = grade.by.reference.name, grade.by.sigma
        evidence = f"the estimate differs from {name} by up to {sigma:.2g} sigma"
        causes.append(Cause("grade", evidence, "check the rounding of the numbers in the files"))
    return tuple(causes)


def _outcome(grade: Graded, causes: tuple[Cause, ...], *, verified: bool) -> Outcome:
    """An optimum that is not verified leaves open only what is measured by it."""
    if any(one.gap in _OWN for one in causes):
        return "disagree"
    by_optimum = grade.by is None or grade.by.grade is None or grade.by.reference.smoothed
    if by_optimum and not verified and not (grade.value is None and grade.required != "plausible"):
        return "unverified"
    return "agree" if grade.enough else "disagree"


def _with_trace(found: tuple[Cause, ...], traced: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """The trace's causes first; linearisation stands for what it explains."""
    kept = tuple(one for one in traced if one.gap in (*_OWN, "linearisation"))
    explained = ("estimate", "covariance", "optimum") if kept else ()
    return kept + tuple(one for one in found if one.gap not in explained)


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
    if given.absent:
        absent = given.absent
        if "landmarks" in absent:
            absent = [one for one in absent if one in ("landmarks", "pose covariances")]
        judged = ["the last pose"] if found.last is not None else []
        judged += ["landmarks"] if found.landmarks else []
        judged.append(
            "the position of every pose"
            if given.pose_covariance is None
            else "the covariance of every pose"
        )
        remarks.append(f"the estimate has no {', no '.join(absent)}; compared: {', '.join(judged)}")
    if len(found.time_s) < len(given.time_s):
        remarks.append(
            f"{len(given.time_s) - len(found.time_s)} poses lie outside the log's time and "
            "were left out"
        )
    if found.last is None:
        remarks.append("the estimate ends before the log, so its last pose was not compared")
    if given.trace is not None and given.joint_covariance is None:
        remarks.append(
            "the trace has no last_pose_and_landmarks beside it, so the algebra is not checked"
        )
    if found.unmatched:
        remarks.append(f"{found.unmatched} landmarks of the estimate are not in the smoother's map")
    return remarks
