"""Causes and remarks of the verdict on an external estimate, from how near it came to what."""

from __future__ import annotations

from collections.abc import Sequence

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks import causes as cause
from comparisons.checks.association_variants import AssociationCheck
from comparisons.checks.causes import FILTER_FAULTS
from comparisons.checks.diagnosis.diagnosis import MOTIONS
from comparisons.checks.diagnosis.duplicate_landmarks import duplicate_cause, duplicates
from comparisons.checks.diagnosis.estimate_facts import Clues, facts
from comparisons.checks.external_agreement import ExternalAgreement, TimeCoverage, clock_words
from comparisons.checks.grade import Graded, Likeness
from comparisons.checks.optimum import doubted_association, unverified
from comparisons.checks.verdict import Outcome
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.log import Log
from comparisons.words import Cause
from graphslam.optimum import Optimality


def differences(
    given: ExternalEstimate, near: Likeness | None, clues: Clues, log: Log, run: EkfRun | None
) -> list[Cause]:
    """Return why an estimate is not like the first reference of its kind. run: of its trace.

    given: its poses at the reference's times. near: beside that reference, None without any.
    """
    if near is None:
        return []
    known = facts(given, near, clues)
    twice = duplicates(given, near, log, run)
    if not twice:
        return known
    return [duplicate_cause(twice), *(one for one in known if one.gap != "map")]


def causes_of(grade: Graded, unlike: Sequence[Cause], against: Sequence[str]) -> tuple[Cause, ...]:
    """Return why a grade is not higher.

    unlike: why the estimate is not like a reference. against: what is not plausible beside the
    optimum.
    """
    causes = list(unlike)
    if against and grade.value in ("wrong", None):
        hint = (
            "probably a consequence of the causes above"
            if unlike
            else "check associations, signs and noise"
        )
        causes.append(Cause("optimum", "; ".join(against), hint))
    if not causes and not grade.enough and grade.by is not None:
        name, sigma = grade.by.reference.name, grade.by.sigma
        evidence = f"the estimate differs from {name} by up to {sigma:.2g} sigma"
        causes.append(Cause("grade", evidence, "check the rounding of the numbers in the files"))
    return tuple(causes)


def beside_trace(causes: tuple[Cause, ...], traced: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """Return causes with a trace's first; linearisation stands for what it explains.

    Before them what explains all of the poses' difference, a fault of what was written.
    """
    kept = tuple(one for one in traced if one.gap in (*FILTER_FAULTS, "linearisation"))
    explained = ("estimate", "covariance", "optimum") if kept else ()
    first = tuple(one for one in causes[:1] if one.gap in MOTIONS)
    rest = tuple(one for one in causes[len(first) :] if one.gap not in explained)
    return first + kept + rest


def left_open(
    optimality: Optimality, association: AssociationCheck | None, causes: tuple[Cause, ...]
) -> tuple[Cause, ...]:
    """Return causes with what is lacking for a verdict first.

    No difference from a reference is a cause whose own association may be wrong.
    """
    lacking = (unverified(optimality),) if optimality.lacks else ()
    if association is None or association.verified:
        return (*lacking, *causes)
    doubt = doubted_association(len(association.against), len(association.variants))
    return (doubt, *lacking, *(one for one in causes if one.gap in FILTER_FAULTS))


def too_short(given: ExternalEstimate, inside: ExternalEstimate, covered: TimeCoverage) -> Cause:
    """Return the cause that too little of the log is covered, which may be the clock's fault."""
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


def grade_remarks(
    grade: Graded, unlike: Sequence[Cause], against: Sequence[str], outcome: Outcome
) -> list[str]:
    """Return what a grade does not say. unlike, against: as of `causes_of`."""
    remarks = []
    if grade.value == "plausible" and outcome == "agree":
        remarks += [
            f"the estimate is plausible, but not like a reference: {one.evidence}" for one in unlike
        ]
    if grade.value in ("like", "equal") and against:
        remarks.append(
            "the filter is like the reference, but far from the optimum because of "
            f"linearisation: {'; '.join(against)}"
        )
    if grade.by is not None and grade.by.single and grade.value in ("like", "equal"):
        remarks.append(
            "the estimate is stored in single precision; the comparison allows for its rounding"
        )
    return remarks


def given_remarks(given: ExternalEstimate, agreement: ExternalAgreement) -> list[str]:
    """Return how the verdict is narrowed by what was not handed in."""
    remarks = []
    if absent := given.absent:
        if "landmarks" in absent:
            absent = [one for one in absent if one in ("landmarks", "pose covariances")]
        compared = ["poses"] if given.pose_covariance is None else ["poses", "pose covariances"]
        compared += ["landmarks"] if agreement.landmarks else []
        remarks.append(
            f"the estimate has no {', no '.join(absent)}; compared {' and '.join(compared)} only"
        )
    if given.left_out:
        remarks.append(given.left_out)
    if len(agreement.time_s) < len(given.time_s):
        remarks.append(
            f"{len(given.time_s) - len(agreement.time_s)} poses lie outside the log's time and "
            "were left out"
        )
    if agreement.last is None:
        remarks.append("the estimate ends before the log, so its last pose was not compared")
    if given.trace is not None:
        remarks += given.trace.remarks
        if given.joint_covariance is None:
            remarks.append(
                "the trace has no last_pose_and_landmarks beside it, so the algebra is not checked"
            )
    if given.removed is not None:
        remarks.append(f"landmarks of the log that the map lacks: {given.removed.words}")
    if agreement.unmatched:
        remarks.append(
            f"{agreement.unmatched} landmarks of the estimate are not in the smoother's map"
        )
    return remarks
