"""From gaps to a verdict and its causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks import causes as cause
from comparisons.checks.agreement import ROUNDING, Agreement, Gap, block_agrees
from comparisons.checks.causes import Cause
from comparisons.checks.consistency.innovations import SensorInnovations
from comparisons.checks.diagnosis.algebra_differences import AlgebraDifference
from comparisons.checks.diagnosis.bookkeeping import Misuse
from comparisons.checks.diagnosis.dropouts import Dropouts
from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
from comparisons.checks.diagnosis.model_differences import ModelDifference
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.own_association.check import OwnAssociationCheck
from comparisons.extensions.own_matching.cause import matching as matching_cause
from comparisons.extensions.own_matching.check import OwnMatchingCheck
from comparisons.extensions.scan_motion.three_way import ThreeWay
from graphslam.optimum import Proof

SPARED_SIGMA = 0.05
"""Largest difference of the means that sparing part of the covariance may cause, in sigma."""

Outcome = Literal["agree", "disagree", "unproven"]


@dataclass(frozen=True)
class Verdict:
    """The outcome, its causes (worst kind first), and remarks that change nothing."""

    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]


def judge(
    agreement: Agreement,
    proof: Proof,
    run: EkfRun,
    differences: Callable[[], Sequence[ModelDifference]] = tuple,
    *,
    operations: Callable[[], Sequence[AlgebraDifference]] = tuple,
    explanations: Callable[[], Sequence[str]] = tuple,
    misuses: Sequence[Misuse] = (),
    conservative: bool = False,
    robust: str = "none",
    own: OwnAssociationCheck | None = None,
    matching: OwnMatchingCheck | None = None,
    three_way: ThreeWay | None = None,
    dense: DenseAgreement | None = None,
    growth: Callable[[], LinearisationGrowth | None] = lambda: None,
    dropouts: Callable[[], Dropouts | None] = lambda: None,
    sensors: Sequence[SensorInnovations] = (),
) -> Verdict:
    """The verdict on a run.

    differences: finds out where the models differ, when they do; explanations: known mistakes that
    lead there. operations: finds out which operation is wrong, when the algebra is. misuses: of the
    data; they come first, for the gaps follow from them. conservative: the filter is meant
    to leave some covariance too large, so its algebra is right when P_E - P_F1 is positive
    semidefinite, to rounding, and the mean hardly moves. A red algebra or model gap is a
    disagreement whatever the smoother found, for it compares the filter with linear algebra.
    Otherwise an unproven optimum gives no verdict at all. robust: how the smoother meets wild
    observations. own: the smoother with its own association; when its last pose is another, the
    associations differ in what matters. matching: the smoother with its own matcher, heard when
    its optimum is proven. three_way: the smoother on scans, when asked for; it is
    heard when its own optimum is proven. dense: the dense maps of both, when asked for. growth:
    finds out where linearising cost something, when it did. dropouts: finds stretches without
    observations; these and the sensors' innovations explain a disagreement, or a missing proof,
    and never make one.
    """
    causes = [Cause("data", misuse.evidence, misuse.hint) for misuse in misuses]
    algebra = agreement.algebra
    if not (_conservative(algebra) if conservative else algebra.within(ROUNDING)):
        causes.append(cause.algebra(algebra, operations()))
    if not agreement.model.within(ROUNDING):
        causes.append(cause.model(agreement.model, differences(), explanations()))
    if run.breakdown and not causes:
        causes.append(
            Cause(
                "breakdown",
                run.breakdown,
                "gaps are compared up to there; look at the sightings and sigmas of that instant",
            )
        )
    outcome: Outcome
    red = bool(causes)
    if red:
        outcome = "disagree"
    elif not proof.proven:
        outcome = "unproven"
        causes.append(cause.unproven(proof))
    else:
        blocks = (agreement.pose, *agreement.landmarks, *agreement.oriented, agreement.whole)
        outcome = "agree" if all(map(block_agrees, blocks)) else "disagree"
        if outcome == "disagree":
            causes.append(cause.linearisation(agreement, run, growth()))
        if own is not None and own.proof.proven and not block_agrees(own.pose):
            outcome = "disagree"
            causes.append(cause.association(own, run))
        if matching is not None and matching.proof.proven and not matching.agrees:
            outcome = "disagree"
            causes.append(matching_cause(matching, run))
        if three_way is not None and three_way.proof.proven and not three_way.ekf.agrees:
            outcome = "disagree"
            causes.append(cause.motion(three_way))
        if dense is not None and not dense.agrees:
            outcome = "disagree"
            causes.append(cause.dense(dense))
    if outcome != "agree" and not red:
        causes += cause.noise(proof.chi_square, sensors) + cause.dropout(dropouts())
    remarks = _remarks(proof, run)
    if three_way is not None:
        remarks += _remarks_on_scans(three_way)
    if matching is not None and not matching.proof.proven:
        remarks.append(
            "the smoother with its own matcher is unproven: it has no say in the verdict"
        )
    if robust in ("huber", "cauchy"):
        remarks.append(
            f"the smoother's {robust} kernel lowers the weight of what fits badly: its covariances "
            "are the weighted problem's, and chi-square is not tested"
        )
    elif robust == "gnc":
        remarks.append("the smoother left out what it found wild; the filter did not")
    if conservative and not algebra.within(ROUNDING):
        remarks.append(
            f"the filter is conservative as meant: its covariance exceeds the exact one by up to "
            f"{algebra.covariance:.2g}, its mean differs by {algebra.sigma:.2g} sigma"
        )
    if run.breakdown and causes[0].gap != "breakdown":
        remarks.insert(0, f"{run.breakdown}; everything is compared up to there")
    return Verdict(outcome, tuple(causes), tuple(remarks))


def _conservative(gap: Gap) -> bool:
    return gap.least >= 1.0 - ROUNDING and gap.asymmetry <= ROUNDING and gap.sigma <= SPARED_SIGMA


def _remarks_on_scans(three_way: ThreeWay) -> list[str]:
    remarks, test = [], three_way.chi_square
    if not three_way.proof.proven:
        remarks.append("the smoother on scans is unproven, so its map has no say in the verdict")
    if test.reading == "too high":
        remarks.append(
            f"on scans, chi-square {test.chi2:.0f} for {test.dof} degrees of freedom is too high: "
            "the increments are surer than they may be, or scans and sightings contradict"
        )
    return remarks


def _remarks(proof: Proof, run: EkfRun) -> list[str]:
    remarks = []
    test = proof.chi_square
    if test.reading != "plausible":
        meaning = {
            "too high": "noise is larger than stated, or the model or the association is wrong",
            "too low": "the stated noise is conservative",
        }[test.reading]
        remarks.append(
            f"chi-square {test.chi2:.0f} for {test.dof} degrees of freedom is {test.reading} "
            f"(band {test.lower:.0f} to {test.upper:.0f}): {meaning}"
        )
    unused = {reason: count for reason, count in run.unused.items() if count}
    if unused:
        remarks.append(
            f"{sum(unused.values())} of {len(run.slot)} sightings were not used: "
            + ", ".join(f"{count} {reason}" for reason, count in unused.items())
        )
    if len(run.retired):
        names = ", ".join(str(i) for i in run.estimate.landmark_id[run.retired].tolist())
        if len(run.retired) == len(run.estimate.landmark):
            remarks.append(
                "every landmark is in motion: in the end odometry alone moves the filter"
            )
        remarks.append(
            f"landmarks {names} stand where something moves: they stay as they were last seen, and "
            "nothing is matched with them any more"
        )
    return remarks
