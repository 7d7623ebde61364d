"""The check job: someone else's estimate of a log against the smoother's verified optimum."""

from __future__ import annotations

from dataclasses import dataclass

from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.motion import poses_at
from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, assess_trajectory
from comparisons.checks.causes import Cause
from comparisons.checks.given_agreement import GivenAgreement, compare_given
from comparisons.checks.verdict import Outcome
from comparisons.config import CheckConfig
from comparisons.estimates.external import GivenEstimate
from comparisons.logs.log import Log
from comparisons.pipeline.given_trace import TraceCheck, check_trace
from comparisons.pipeline.prepare import Progress, no_progress
from comparisons.pipeline.solve import Solution, solve

_OWN = ("data", "algebra", "model")
"""Causes that the filter's trace shows whatever the smoother found."""


@dataclass(frozen=True, kw_only=True)
class GivenCheck:
    """What the check found.

    solution: the smoother's. agreement: against it. accuracy: of the given trajectory where the
    log has truth or positions. trace: the filter's own gaps, where it left one. outcome, causes,
    remarks: the verdict.
    """

    given: GivenEstimate
    solution: Solution
    agreement: GivenAgreement
    accuracy: Accuracy | None
    trace: TraceCheck | None
    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]


def check(
    log: Log,
    given: GivenEstimate,
    config: CheckConfig | None = None,
    progress: Progress = no_progress,
) -> GivenCheck:
    """Solve the log, compare, judge. Raises InputError, and as `solve` does."""
    config = config or CheckConfig()
    solution = solve(log, config, progress)
    progress("check", 0, 0)
    reference = poses_at(solution.log, solution.estimate, given.time_s)
    found = compare_given(
        given,
        solution.estimate,
        reference,
        labelled=solution.prepared.labelled,
        peer=(lambda: _peer(given, solution)) if given.information == "filtered" else None,
    )
    verified = solution.verified
    traced, causes = None, found.causes
    if given.trace is not None:
        progress("trace", 0, 0)
        traced = check_trace(given, solution.prepared, solution.result.options)
        causes = _with_trace(causes, traced.verdict.causes)
    outcome: Outcome
    if any(cause.gap in _OWN for cause in causes):
        outcome = "disagree"
    else:
        outcome = "unverified" if not verified else "disagree" if causes else "agree"
    return GivenCheck(
        given=given,
        solution=solution,
        agreement=found,
        accuracy=assess_trajectory(given.time_s, given.pose, solution.log),
        trace=traced,
        outcome=outcome,
        causes=causes,
        remarks=(*_remarks(given, found), *_on_association(solution)),
    )


def _on_association(solution: Solution) -> list[str]:
    """What speaks against the smoother's own association."""
    checked = solution.association_check
    return [] if checked is None else checked.remarks


def _with_trace(found: tuple[Cause, ...], traced: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """The trace's causes first; linearisation stands for what it explains."""
    kept = tuple(cause for cause in traced if cause.gap in (*_OWN, "linearisation"))
    explained = ("estimate", "covariance") if kept else ()
    return kept + tuple(cause for cause in found if cause.gap not in explained)


def _peer(given: GivenEstimate, solution: Solution) -> Array:
    """The reference EKF's poses (K, 3) at the given times."""
    p = solution.prepared
    run = run_ekf(p.log, p.timeline, p.ekf, p.positions)
    return poses_at(p.log, run.estimate, given.time_s)


def _remarks(given: GivenEstimate, found: GivenAgreement) -> list[str]:
    """How the verdict is narrowed by what was not handed in."""
    remarks = []
    if given.absent:
        judged = ["the last pose"] if found.last is not None else []
        judged += ["landmarks"] if found.landmarks else []
        judged.append(
            "the path as a whole" if found.outside is None else "every pose by its own covariance"
        )
        remarks.append(f"not handed in: {', '.join(given.absent)}; judged: {', '.join(judged)}")
    if len(found.time_s) < len(given.time_s):
        remarks.append(
            f"{len(given.time_s) - len(found.time_s)} poses lie outside the log's time and were "
            "left out"
        )
    if found.last is None:
        remarks.append("the last pose given lies before the log's end, so it was not judged")
    if given.trace is not None and given.joint_covariance is None:
        remarks.append("no last_pose_and_landmarks beside the trace, so its algebra is not judged")
    if found.unmatched:
        remarks.append(f"{found.unmatched} landmarks given are not among the smoother's")
    return remarks
