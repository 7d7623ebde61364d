"""Whether a filter ends at the smoother's optimum: E against S, by way of F2."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.audit.spurious import HEADING, Learnt
from comparisons.checks.agreement import LEAST_VARIANCE_RATIO, Agreement, LinearisationFigures
from comparisons.checks.check import EVENTS, Check
from comparisons.checks.finding import OfFilter
from comparisons.checks.spurious import CheckSpurious, SpuriousFinding
from comparisons.checks.verdict import faulty
from comparisons.figures import degrees
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
    from comparisons.pipeline.known import Known

_MATTERS = 10.0
"""Times the heading's largest sigma: what is learnt less surely than that changes nothing."""


class CheckLinearisation(Check):
    """Do the filter's pose, landmarks and map agree with the smoother's optimum?"""

    name = "linearisation"
    needs = EVENTS
    errs = "none of 400 sound drives of 30 s disagrees (95 % limit 1.8 % of each 200)"
    figures = (("agreement", LinearisationFigures),)

    def find(self, known: Known) -> OfFilter[Agreement]:
        """Return E against S, explained where algebra and models are right."""
        gaps, agreement = known.gaps, known.gaps.agreement
        causes = []
        if not agreement.agrees and known.result.optimality.verified and not faulty(known):
            CheckSpurious().ask(known)
            growth, spurious = gaps.linearisation_growth(), known.value(SpuriousFinding)
            causes.append(linearisation_cause(agreement, gaps.run, growth, spurious))
        return OfFilter(agreement, causes)


def linearisation_cause(
    agreement: Agreement,
    run: EkfRun,
    growth: LinearisationGrowth | None = None,
    spurious: Learnt | None = None,
) -> Cause:
    """The gap between F2 and S. growth: where it arose, if that was looked for."""
    names = [f"landmark {i}" for i in run.estimate.names]
    names += [f"scan landmark {i}" for i in run.estimate.pose_landmark_id]
    blocks = (*agreement.landmarks, *agreement.pose_landmarks)
    off = [i for i, block in enumerate(blocks) if not block.agrees]
    parts = []
    far = [i for i in off if not blocks[i].near]
    if far:
        worst = max(far, key=lambda i: blocks[i].distance_sigma)
        block = blocks[worst]
        parts.append(
            f"{len(far)} of {len(names)} landmarks are more than {block.limit_sigma:.2g} sigma "
            f"from the optimum; {names[worst]} differs most, by {block.difference_m:.2f} m "
            f"({block.distance_sigma:.1f} sigma)"
        )
    unsure = [i for i in off if i not in far]
    if unsure:
        worst, ratio = max(
            ((i, r) for i in unsure for r in blocks[i].ratios),
            key=lambda pair: max(pair[1], 1.0 / max(pair[1], 1e-300)),
        )
        parts.append(
            f"{len(unsure)} of {len(names)} landmarks have a wrong covariance; the variance of "
            f"{names[worst]} is {ratio:.2g} times the smoother's"
        )
    if not agreement.pose.near:
        metres, sigmas = agreement.pose.difference_m, agreement.pose.distance_sigma
        parts.append(f"the last pose differs by {metres:.2f} m ({sigmas:.1f} sigma)")
    if not agreement.map.near:
        together = agreement.map.distance_sigma
        parts.append(f"map and last pose together differ by {together:.1f} sigma")
    if agreement.optimism < LEAST_VARIANCE_RATIO:
        parts.append(
            f"in the most optimistic direction the filter's variance is "
            f"{100 * agreement.optimism:.2g} % of the smoother's"
        )
    if agreement.pessimism > 1.0 / LEAST_VARIANCE_RATIO:
        parts.append(
            f"in the most pessimistic direction the filter's variance is "
            f"{agreement.pessimism:.1f} times the smoother's"
        )
    sigma, reached = np.sqrt(run.estimate.pose_covariance[:, 2, 2]), ""
    if np.isfinite(sigma).any():
        k = int(np.nanargmax(sigma))
        reached = f" (its sigma reached {degrees(sigma[k])} at {run.estimate.time_s[k]:.1f} s)"
    if growth is not None and growth.total > 0.0:
        parts.append(_grew(growth, run, sigma))
    if spurious is not None:
        parts += _learnt(spurious, sigma)
    return Cause(
        "linearisation",
        "; ".join(parts),
        "algebra and models are right, so the linearisation points are the reason: reduce the "
        f"heading uncertainty{reached}, or use local maps or relinearisation",
    )


def _learnt(spurious: Learnt, sigma: Array) -> list[str]:
    """How well the filter seems to know what nothing measured, and when it learnt that.

    sigma: (K,) the filter's own of the heading [rad]; what is learnt far less surely than the
    largest of them changes nothing.
    """
    learnt = spurious.of(HEADING)
    known = sigma[np.isfinite(sigma)]
    if learnt.largest is None or learnt.sigma > _MATTERS * np.degrees(known.max(initial=0.0)):
        return []
    begin_s, end_s, _ = spurious.fastest(HEADING)
    return [
        f"the filter claims its absolute heading to {degrees(np.radians(learnt.sigma))}, which no "
        f"measurement observes (gained fastest from {begin_s:.1f} to {end_s:.1f} s; the largest "
        f"single gain is with {learnt.largest.seen} at {learnt.largest.time_s:.1f} s)"
    ]


def _grew(growth: LinearisationGrowth, run: EkfRun, sigma: Array) -> str:
    """When, by which relation, at which uncertainty of the heading (K,)."""
    time_s, at = run.estimate.time_s, growth.epoch
    seen = ""
    if growth.landmark_index >= 0:
        template = "template" in growth.kind  # whose landmark's id is its landmark index
        index = growth.landmark_index
        seen = f" of landmark {index if template else run.estimate.names[index]}"
    around = degrees(sigma[max(at - 1, 0) : at + 1].max())
    return (
        f"the largest linearisation error is that of {growth.kind}{seen} at {time_s[at]:.1f} s "
        f"({growth.sigma:.1f} sigma of its noise; the heading's sigma was {around}), and half of "
        f"the total linearisation error arose before {time_s[growth.reached(0.5)]:.1f} s"
    )
