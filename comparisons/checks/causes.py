"""Reasons for an outcome, in words: the gap each shows in, the numbers, and what to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.checks.agreement import (
    EXACT,
    LARGEST_DISTANCE,
    LEAST_VARIANCE_RATIO,
    ROUNDING,
    Agreement,
    Allowed,
    BlockAgreement,
    Gap,
    block_agrees,
)
from comparisons.checks.consistency.consistency import Consistency
from graphslam.optimum import DISTANCE_LIMIT, ChiSquareTest, Optimality

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.algebra_differences import AlgebraDifference
    from comparisons.checks.diagnosis.dropouts import Dropouts
    from comparisons.checks.diagnosis.linearisation_growth import LinearisationGrowth
    from comparisons.checks.diagnosis.model_differences import ModelDifference


GAPS = ("algebra", "model", "linearisation", "association", "matching", "truth")
"""Causes that are gaps between the estimates; other causes explain one, or stand beside."""
_NAMED = 3
"""So many differences of the models are named."""
_GREW = 3.0
"""A dropout over which the position's sigma grew so many times is named as a cause."""


@dataclass(frozen=True)
class Cause:
    """One reason for the outcome: the gap it shows in, the numbers, and what to look at.

    alone: it holds whether the smoother's optimum is verified or not.
    """

    gap: str
    evidence: str
    hint: str
    alone: bool = False


def _apart(gap: Gap, allowed: Allowed) -> str:
    limit = f"rounding allows {ROUNDING:g}"
    if allowed.stored:
        limit = (
            f"storing in single precision allows {allowed.sigma:.2g} and {allowed.covariance:.2g}"
        )
    return (
        f"differ by {gap.sigma:.2g} sigma in the mean and by {gap.covariance:.2g} in the "
        f"covariance, where {limit}"
    )


def algebra(
    gap: Gap,
    operations: Sequence[AlgebraDifference],
    allowed: Allowed = EXACT,
    single: str = "",
) -> Cause:
    """E against F1. operations: those found wrong, the first to break first.

    single: how the gap grows, if computing in single precision explains it.
    """
    named = "; ".join(map(str, operations[:_NAMED]))
    hint = (
        "look for a covariance block that is dropped, stale or not transposed: prediction, update, "
        "augmentation"
    )
    return Cause(
        "algebra",
        f"the filter and the solution of its own linear equations {_apart(gap, allowed)}"
        + (f"; {named}" if named else ""),
        f"look at {operations[0].operation}: {operations[0].block}"
        if operations
        else single or hint,
    )


def model(
    gap: Gap,
    differences: Sequence[ModelDifference],
    known_model_errors: Sequence[str],
    allowed: Allowed = EXACT,
) -> Cause:
    """F1 against F2. explanations: known mistakes that reproduce what was recorded."""
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
    if known_model_errors:
        hint = f"the records are as if: {'; '.join(known_model_errors)}"
    return Cause(
        "model",
        "the filter's and the smoother's equations, linearised at the same points, "
        f"{_apart(gap, allowed)}" + (f"; {named}" if named else ""),
        hint,
    )


def unverified(optimality: Optimality) -> Cause:
    """The optimum is not verified, and what the check lacks."""
    if optimality.distance_sigma > DISTANCE_LIMIT:
        hint = "use the batch, or a longer lag"
    elif optimality.chi_square.reading == "too high":
        hint = (
            "check the noise figures and the association; --accept-misfit takes the lowest minimum "
            "all the same"
        )
    else:
        hint = (
            "the smoother may sit in a local minimum: check the noise figures and the association"
        )
    return Cause("oracle", optimality.lacks, hint)


def linearisation(
    agreement: Agreement, run: EkfRun, growth: LinearisationGrowth | None = None
) -> Cause:
    """The gap between F2 and S. growth: where it arose, if that was looked for."""
    names = [f"landmark {i}" for i in run.estimate.landmark_id]
    names += [f"scan landmark {i}" for i in run.estimate.pose_landmark_id]
    blocks = (*agreement.landmarks, *agreement.pose_landmarks)
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
    sigma, reached = np.sqrt(run.estimate.pose_covariance[:, 2, 2]), ""
    if np.isfinite(sigma).any():
        k = int(np.nanargmax(sigma))
        reached = (
            f"the heading's sigma reached {_degrees(sigma[k])} at {run.estimate.time_s[k]:.1f} s; "
        )
    if growth is not None and growth.total > 0.0:
        parts.append(_grew(growth, run, sigma))
    return Cause(
        "linearisation",
        "; ".join(parts),
        f"algebra and model are right, so the linearisation points are not: {reached}smaller "
        "heading uncertainty, local maps or relinearisation would help",
    )


def _degrees(angle_rad: float) -> str:
    """One decimal, below a degree two digits: never 0.0 of an angle that is there."""
    angle = float(np.degrees(angle_rad))
    return f"{angle:.1f} degrees" if abs(angle) >= 1.0 else f"{angle:.2g} degrees"


def _grew(growth: LinearisationGrowth, run: EkfRun, sigma: Array) -> str:
    """When, by which relation, at which uncertainty of the heading (K,)."""
    time_s, at = run.estimate.time_s, growth.epoch
    seen = ""
    if growth.landmark_index >= 0:
        template = "template" in growth.kind  # whose landmark's id is its landmark index
        index = growth.landmark_index
        seen = f" of landmark {index if template else run.estimate.landmark_id[index]}"
    around = _degrees(sigma[max(at - 1, 0) : at + 1].max())
    return (
        f"its equations miss the optimum's the most by {growth.kind}{seen} at {time_s[at]:.1f} s "
        f"({growth.sigma:.1f} sigma of its noise; the heading's sigma was {around}), "
        f"and half of all they miss had come together by {time_s[growth.reached(0.5)]:.1f} s"
    )


def noise(test: ChiSquareTest, consistency: Consistency | None) -> list[Cause]:
    """The sensors whose innovations are too large, where the smoother's residuals are, too."""
    if test.reading != "too high" or consistency is None:
        return []
    off = [
        (nis, sensor.sensor)
        for sensor in consistency.sensors
        for nis in sensor.nis[1:]
        if nis.worded(consistency.outside)[0] == "too high"
    ]
    if not off:
        return []
    worst, of = max(off, key=lambda pair: pair[0].mean)
    return [
        Cause(
            "noise",
            f"chi-square {test.chi2:.0f} for {test.dof} degrees of freedom is too high, and so is "
            + ", ".join(
                f"the NIS of {name}' {nis.name}, {nis.mean:.3g} of {nis.dof}" for nis, name in off
            ),
            f"look at the sigmas of {of}' {worst.name}, about {worst.mean**0.5:.2g} times too "
            "small if they alone are wrong, or at what is taken for which landmark",
        )
    ]


def dropout(dropouts: Dropouts | None) -> list[Cause]:
    """The stretch without observations that made the vehicle uncertain, if one did."""
    worst = None if dropouts is None else dropouts.worst
    if dropouts is None or worst is None or worst.growth < _GREW:
        return []
    refused = f", {worst.refused} measurements refused" if worst.refused else ""
    before, after = worst.sigma_heading_rad
    return [
        Cause(
            "dropout",
            f"no observation was used from {worst.begin_s:.1f} to {worst.end_s:.1f} s "
            f"({worst.way_m:.1f} m driven{refused}): the position's sigma grew from "
            f"{worst.sigma_m[0]:.2g} to {worst.sigma_m[1]:.2g} m, the heading's from "
            f"{_degrees(before)} to {_degrees(after)}, and the filter arrived "
            f"{worst.error_m:.2f} m from the smoother ({dropouts.error_outside_m:.2f} m RMS "
            "outside such stretches, which are "
            f"{100.0 * (1.0 - dropouts.coverage):.0f} % of the time)",
            "look for a blind or silent sensor, lost messages, or a gate that refuses everything",
        )
    ]


def coverage(evidence: str, least: float, hint: str = "") -> Cause:
    """Too little of the log's time in an external estimate. least: share that is asked for."""
    return Cause(
        "coverage",
        f"{evidence}; asked for are {100.0 * least:.4g} %",
        hint
        or "look whether the filter stopped or lost poses; hand in the whole path, or give "
        "--min-coverage",
    )


def _ratios(block: BlockAgreement) -> tuple[float, float]:
    return block.least, block.largest
