"""From gaps to a verdict and its causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from comparisons.checks.agreement import Agreement, BlockAgreement, Gap
from comparisons.checks.algebra_differences import AlgebraDifference
from comparisons.checks.bookkeeping import Misuse
from comparisons.checks.dense_agreement import AGREE_M, DenseAgreement
from comparisons.checks.model_differences import ModelDifference
from comparisons.checks.own_association import OwnAssociationCheck
from comparisons.checks.three_way import ThreeWay
from comparisons.runs.ekf_run import EkfRun
from graphslam.optimum import DISTANCE_LIMIT, Proof

ROUNDING = 1e-6
"""Largest algebra and model gap, in sigma and in covariance, that rounding explains."""
SPARED_SIGMA = 0.05
"""Largest difference of the means that sparing part of the covariance may cause, in sigma."""
LARGEST_DISTANCE = 1.0
"""A block agrees when the filter deviates by no more than the optimum itself is uncertain."""
_NAMED = 3
"""So many differences of the models are named."""
LEAST_VARIANCE_RATIO = 0.25
"""A block agrees when no direction's variance is below this share of the smoother's (half its
sigma), nor above the inverse share."""

Outcome = Literal["agree", "disagree", "unproven"]


@dataclass(frozen=True)
class Cause:
    """One reason for the outcome: the gap it shows in, the numbers, and what to look at."""

    gap: str
    evidence: str
    hint: str


@dataclass(frozen=True)
class Verdict:
    """The outcome, its causes (worst kind first), and remarks that change nothing."""

    outcome: Outcome
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]


def block_agrees(block: BlockAgreement) -> bool:
    """Whether the pose, a landmark or the whole agrees in mean and covariance."""
    return (
        block.distance <= LARGEST_DISTANCE
        and block.least >= LEAST_VARIANCE_RATIO
        and block.largest <= 1.0 / LEAST_VARIANCE_RATIO
    )


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
    three_way: ThreeWay | None = None,
    dense: DenseAgreement | None = None,
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
    associations differ in what matters. three_way: the smoother on scans, when asked for; it is
    heard when its own optimum is proven. dense: the dense maps of both, when asked for.
    """
    causes = [Cause("data", misuse.evidence, misuse.hint) for misuse in misuses]
    algebra = agreement.algebra
    if not (_conservative(algebra) if conservative else algebra.within(ROUNDING)):
        causes.append(_algebra(algebra, operations()))
    if not agreement.model.within(ROUNDING):
        causes.append(_model(agreement.model, differences(), explanations()))
    if run.breakdown and not causes:
        causes.append(
            Cause(
                "breakdown",
                run.breakdown,
                "gaps are compared up to there; look at the sightings and sigmas of that instant",
            )
        )
    outcome: Outcome
    if causes:
        outcome = "disagree"
    elif not proof.proven:
        outcome = "unproven"
        causes.append(_unproven(proof))
    else:
        blocks = (agreement.pose, *agreement.landmarks, *agreement.oriented, agreement.whole)
        outcome = "agree" if all(map(block_agrees, blocks)) else "disagree"
        if outcome == "disagree":
            causes.append(_linearisation(agreement, run))
        if own is not None and own.proof.proven and not block_agrees(own.pose):
            outcome = "disagree"
            causes.append(_association(own))
        if three_way is not None and three_way.proof.proven and not three_way.ekf.agrees:
            outcome = "disagree"
            causes.append(_motion(three_way))
        if dense is not None and not dense.agrees:
            outcome = "disagree"
            causes.append(_dense(dense))
    remarks = _remarks(proof, run)
    if three_way is not None:
        remarks += _remarks_on_scans(three_way)
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


def _apart(gap: Gap) -> str:
    return (
        f"differ by {gap.sigma:.2g} sigma in the mean and by {gap.covariance:.2g} in the "
        f"covariance, where rounding allows {ROUNDING:g}"
    )


def _algebra(gap: Gap, operations: Sequence[AlgebraDifference]) -> Cause:
    named = "; ".join(map(str, operations[:_NAMED]))
    hint = (
        "look for a covariance block that is dropped, stale or not transposed: prediction, update, "
        "augmentation"
    )
    return Cause(
        "algebra",
        f"the filter and the solution of its own linear equations {_apart(gap)}"
        + (f"; {named}" if named else ""),
        f"look at {operations[0].operation}: {operations[0].block}" if operations else hint,
    )


def _model(gap: Gap, differences: Sequence[ModelDifference], explanations: Sequence[str]) -> Cause:
    named = "; ".join(map(str, differences[:_NAMED]))
    hint = (
        "look for a Jacobian's sign, an unwrapped innovation, a sigma squared twice, a steering or "
        "bearing convention"
    )
    if differences and differences[0].absent:
        hint = (
            f"complete {differences[0].quantity}: its columns are zero in the filter, and the "
            "observation does depend on it"
        )
    if explanations:
        hint = f"the records are as if: {'; '.join(explanations)}"
    return Cause(
        "model",
        "the filter's and the smoother's equations, linearised at the same points, "
        f"{_apart(gap)}" + (f"; {named}" if named else ""),
        hint,
    )


def _association(own: OwnAssociationCheck) -> Cause:
    p = own.partition
    return Cause(
        "association",
        f"with its own association the smoother's last pose is {own.pose.difference_m:.2f} m "
        f"({own.pose.distance:.1f} sigma) elsewhere; of the pairs of sightings put together "
        f"{100.0 * p.agreement:.0f} % are the same, {p.splits} of the filter's landmarks are split "
        f"and {p.merges} of the smoother's",
        "look at the sightings where the two differ: a wrong closure, or landmarks too near to "
        "tell apart",
    )


def _motion(three_way: ThreeWay) -> Cause:
    pair = three_way.ekf
    hint = {
        "wheels": "look at the odometry: its sigmas, the wheelbase, the scale of speed and turn",
        "scans": "look at the scan odometry: increments' factor, open directions, failures",
        "": "compare both with GPS or truth, or look at both motions' sigmas",
    }[three_way.culprit]
    return Cause(
        "motion",
        f"EKF on wheels and smoother on scans differ by {pair.rms_m:.3f} m RMS, {pair.outside} of "
        f"{len(pair.distance_sigma)} landmarks beyond their 99 % region; {three_way.evidence}",
        hint,
    )


def _dense(dense: DenseAgreement) -> Cause:
    evidence = f"the dense maps are {dense.median_m:.2f} m apart (median of the worst layer)"
    if dense.regions:
        worst = dense.regions[0]
        far = len({row.region for row in dense.regions if row.distance_m > AGREE_M})
        evidence += (
            f"; {far} regions are more than {AGREE_M:g} m off, region {worst.region} by "
            f"{worst.distance_m:.2f} m ({worst.layer})"
        )
    return Cause(
        "dense",
        evidence,
        "look at the corners of that region: landmarks that were not yet well known relative to "
        "each other, or to the vehicle, when the scans were taken",
    )


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


def _unproven(proof: Proof) -> Cause:
    if not proof.stationarity.holds:
        evidence = "the smoother's best result is not a strict local minimum"
    elif proof.distance_sigma > DISTANCE_LIMIT:
        evidence = (
            f"the estimate along the way is {proof.distance_sigma:.2g} sigma from the optimum, "
            f"expected at most {DISTANCE_LIMIT}"
        )
        return Cause("oracle", evidence, "use the batch, or a longer lag")
    else:
        test = proof.chi_square
        evidence = (
            f"only {proof.agreeing[0]} reached the lowest error, and chi-square {test.chi2:.0f} "
            f"lies above {test.upper:.0f} for {test.dof} degrees of freedom"
        )
    return Cause(
        "oracle",
        evidence,
        "the smoother may sit in a local minimum: check the noise figures and the association",
    )


def _linearisation(agreement: Agreement, run: EkfRun) -> Cause:
    names = [f"landmark {i}" for i in run.estimate.landmark_id]
    names += [f"scan landmark {i}" for i in run.estimate.oriented_id]
    blocks = (*agreement.landmarks, *agreement.oriented)
    off = [i for i, block in enumerate(blocks) if not block_agrees(block)]
    parts = []
    far = [i for i in off if blocks[i].distance > LARGEST_DISTANCE]
    if far:
        worst = max(far, key=lambda i: blocks[i].distance)
        block = blocks[worst]
        parts.append(
            f"{len(far)} of {len(names)} landmarks are too far off, {names[worst]} by "
            f"{block.difference_m:.2f} m ({block.distance:.1f} sigma)"
        )
    unsure = [i for i in off if i not in far]
    if unsure:
        worst, ratio = max(
            ((i, r) for i in unsure for r in _ratios(blocks[i])),
            key=lambda pair: max(pair[1], 1.0 / max(pair[1], 1e-300)),
        )
        parts.append(
            f"{len(unsure)} of {len(names)} landmarks have a wrong covariance, {names[worst]} "
            f"{ratio:.2g} times the justified variance"
        )
    if agreement.pose.distance > LARGEST_DISTANCE:
        parts.append(
            f"the last pose is off by {agreement.pose.difference_m:.2f} m "
            f"({agreement.pose.distance:.1f} sigma)"
        )
    if agreement.whole.distance > LARGEST_DISTANCE:
        parts.append(f"map and pose together are off by {agreement.whole.distance:.1f} sigma")
    if agreement.whole.least < LEAST_VARIANCE_RATIO:
        parts.append(
            f"the filter claims {100 * agreement.whole.least:.2g} % of the justified variance in "
            "its most optimistic direction"
        )
    if agreement.whole.largest > 1.0 / LEAST_VARIANCE_RATIO:
        parts.append(
            f"it claims {agreement.whole.largest:.1f} times the justified variance in its most "
            "pessimistic direction"
        )
    sigma = np.sqrt(run.estimate.pose_covariance[:, 2, 2])
    k = int(np.argmax(sigma))
    return Cause(
        "linearisation",
        "; ".join(parts),
        f"algebra and model are right, so the linearisation points are not: the heading's sigma "
        f"reached {np.degrees(sigma[k]):.1f} degrees at {run.estimate.time_s[k]:.1f} s; smaller "
        "heading uncertainty, local maps or relinearisation would help",
    )


def _ratios(block: BlockAgreement) -> tuple[float, float]:
    return block.least, block.largest


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
    return remarks
