"""The check job: someone else's estimate of a log against the smoother's, proven, estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from comparisons.adapters.ekf_factory import EkfChoices, fused_positions
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.motion import poses_at
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import Accuracy, assess_trajectory
from comparisons.checks.causes import Cause
from comparisons.checks.given_agreement import GivenAgreement, compare_given
from comparisons.checks.given_trace import TraceCheck, check_trace
from comparisons.estimates.estimate import Array
from comparisons.estimates.external import GivenEstimate
from comparisons.logs.log import Log
from comparisons.pipeline.solve import Solution, solve_log
from graphslam.smoother import SmootherOptions

_OWN = ("data", "algebra", "model")
"""Causes that the filter's trace shows whatever the smoother found."""


@dataclass(frozen=True)
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
    outcome: Literal["agree", "disagree", "unproven"]
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]


def check_given(
    log: Log,
    given: GivenEstimate,
    association: str | None = None,
    gps: str = "off",
    options: SmootherOptions | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> GivenCheck:
    """Solve the log, compare, judge. Raises InputError, and as solve_log does."""
    solution = solve_log(log, association, gps, options, progress)
    progress("check", 0, 0)
    reference = poses_at(solution.log, solution.estimate, given.time_s)
    found = compare_given(
        given,
        solution.estimate,
        reference,
        labelled=solution.association_by == "known",
        peer=(lambda: _peer(given, solution)) if given.information == "filtered" else None,
    )
    proven = solution.result.proof.proven
    traced, causes = None, found.causes
    if given.trace is not None:
        progress("trace", 0, 0)
        known = solution.association_by == "known"
        choices = EkfChoices(association="known" if known else "nn", gps=gps).settle(log)
        traced = check_trace(
            solution.log,
            given,
            fused_positions(solution.log, choices),
            options or SmootherOptions(),
            labelled=known,
        )
        causes = _with_trace(causes, traced.verdict.causes)
    outcome: Literal["agree", "disagree", "unproven"]
    if any(cause.gap in _OWN for cause in causes):
        outcome = "disagree"
    else:
        outcome = "unproven" if not proven else "disagree" if causes else "agree"
    return GivenCheck(
        given,
        solution,
        found,
        assess_trajectory(given.time_s, given.pose, solution.log),
        traced,
        outcome,
        causes,
        tuple(_remarks(given, found)),
    )


def _with_trace(found: tuple[Cause, ...], traced: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """The trace's causes first; linearisation stands for what it explains."""
    kept = tuple(cause for cause in traced if cause.gap in (*_OWN, "linearisation"))
    explained = ("estimate", "covariance") if kept else ()
    return kept + tuple(cause for cause in found if cause.gap not in explained)


def _peer(given: GivenEstimate, solution: Solution) -> Array:
    """The reference EKF's poses (K, 3) at the given times."""
    log, known = solution.log, solution.association_by == "known"
    choices = EkfChoices(association="known" if known else "nn", gps=solution.gps).settle(log)
    positions = fused_positions(log, choices)
    run = run_ekf(log, build_timeline(log, positions), choices, positions)
    return poses_at(log, run.estimate, given.time_s)


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
