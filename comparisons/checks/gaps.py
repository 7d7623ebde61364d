"""How far a filter is from the smoother: gap by gap, in the last pose, and in every landmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from comparisons.checks.agreement import (
    LARGEST_DISTANCE,
    LEAST_VARIANCE_RATIO,
    Agreement,
    BlockAgreement,
)
from comparisons.checks.check import About
from comparisons.checks.finding import Of
from comparisons.figures import band, in_sigma, shown
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

AGREEING_RATIOS = f"{LEAST_VARIANCE_RATIO:g} to {1.0 / LEAST_VARIANCE_RATIO:g}"
"""Variances of the EKF over the smoother's within which a block of a run agrees."""
_DISTANCE = f"<= {LARGEST_DISTANCE:g} sigma"
"""Largest difference of the means within which a block agrees."""


class GapsFinding(Of[Agreement]):
    """The gaps between filter and smoother."""

    def __init__(self, agreement: Agreement) -> None:
        """agreement: with what rounding explains of the gaps."""
        super().__init__(agreement, entries={"agreement": agreement})
        landmarks = [*agreement.landmarks, *agreement.pose_landmarks]
        agree = sum(row.agrees for row in landmarks)
        words = (
            f"{agree} of {len(landmarks)} landmarks "
            f"({agreement.landmark_difference_rms_m:.3f} m rms); {pose_words(agreement.pose)}"
        )
        self.lines = [("agreement", words)]

    def rows(self) -> Sequence[Row]:
        """Return rows of the table, those of the gaps apart, for which the verdict counts."""
        gaps = self.value
        return [
            *agreeing(gaps.landmarks, "EKF"),
            Row(
                "Map, EKF and smoother",
                "difference of the landmarks (rms)",
                f"{gaps.landmark_difference_rms_m:.3f} m",
            ),
            *block_rows("Last pose", "EKF", gaps.pose, AGREEING_RATIOS),
            *block_rows("Last pose and map jointly", "EKF", gaps.map, AGREEING_RATIOS),
        ]


class AboutGaps(About):
    """How far apart are the filter, its linear problems and the smoother?"""

    name = "agreement"
    needs = "a filter with the events that it went through, and the smoother"
    figures = (("agreement", Agreement),)

    def find(self, known: Known) -> GapsFinding:
        """Return the gaps, with what rounding explains of the first two."""
        records = known.records
        found = replace(
            records.gaps.agreement,
            algebra_limit_sigma=records.algebra.sigma,
            model_limit_sigma=records.model.sigma,
        )
        return GapsFinding(found)


def block_rows(part: str, whose: str, block: BlockAgreement, limits: str = "") -> list[Row]:
    """Return how an estimate agrees with the smoother's.

    part: of the state. whose: as `EKF`. limits: of the variance ratios, empty where they depend on
    the estimate.
    """
    group, agrees = f"{part}, {whose} and smoother", "yes" if block.agrees else "no"
    rows = [
        Row(group, "agrees", agrees, "yes", block.agrees),
        Row(group, "difference of the positions", f"{block.difference_m:.3f} m"),
        Row(group, "difference of the means", in_sigma(block.distance_sigma), _DISTANCE),
    ]
    if block.variance_ratio_least is not None:
        ends = (block.variance_ratio_least, block.variance_ratio_largest)
        ratios = band(*(shown(end, ".3g") for end in ends))
        rows.append(Row(group, f"variances, {whose} over smoother", ratios, limits))
    return rows


def agreeing(blocks: Sequence[BlockAgreement], whose: str) -> list[Row]:
    """Return how many landmarks agree, if there are any. whose: as `EKF`."""
    if not blocks:
        return []
    count = sum(block.agrees for block in blocks)
    value = f"{count} of {len(blocks)}"
    group, name = f"Map, {whose} and smoother", "landmarks that agree"
    return [Row(group, name, value, "all", count == len(blocks))]


def pose_words(pose: BlockAgreement) -> str:
    """Return in words how two estimates agree in the last pose."""
    return f"last pose {'agrees' if pose.agrees else 'disagrees'} ({in_sigma(pose.distance_sigma)})"
