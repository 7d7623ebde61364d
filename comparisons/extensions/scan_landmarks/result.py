"""Scan landmarks in `result.json`, on the terminal, and their templates on the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comparisons.checks.agreement import BlockAgreement, block_agrees
from comparisons.estimates.estimate import Estimate
from comparisons.pipeline.compare import Comparison
from comparisons.report.finite import finite
from comparisons.report.models import ScanLandmarkResult, ScanSlamResult
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def block_fields(b: BlockAgreement) -> dict[str, float | bool | None]:
    """How a block of two estimates agrees, by the names of BlockResult."""
    return {
        "difference_m": b.difference_m,
        "distance_sigma": b.distance,
        "variance_ratio_least": finite(b.least),
        "variance_ratio_largest": finite(b.largest),
        "agrees": block_agrees(b),
    }


def scan_slam_result(c: Comparison) -> ScanSlamResult | None:
    """What the scans gave as landmarks; None when they were not asked."""
    if c.scan_slam is None:
        return None
    found = c.scan_slam.found
    ekf, smoothed = c.ekf.estimate, c.smoothed
    return ScanSlamResult(
        scans=found.scans,
        landmarks=[
            ScanLandmarkResult(
                id=(slot := int(ekf.oriented_id[i])),
                ekf_m=tuple(ekf.oriented[i, :2].tolist()),
                smoother_m=tuple(smoothed.oriented[i, :2].tolist()),
                ekf_heading_rad=float(ekf.oriented[i, 2]),
                smoother_heading_rad=float(smoothed.oriented[i, 2]),
                sightings=found.sightings[slot],
                points=len(found.template[slot].shape),
                **block_fields(b),  # type: ignore[arg-type]
            )
            for i, b in enumerate(c.agreement.oriented)
        ],
        rejected=found.rejected,
        dynamic=found.dynamic,
        fused=found.fused,
        enriched=found.enriched,
        pieces=c.scan_slam.pieces,
        sightings=dict(found.reasons),
    )


def scan_slam_rows(result: ScanSlamResult) -> list[tuple[str, str]]:
    """Rows of a run's summary."""
    agreeing = sum(row.agrees for row in result.landmarks)
    told = (f"{count:,} {reason}" for reason, count in result.sightings.items() if count)
    return [
        (
            "scan landmarks",
            f"{agreeing} of {len(result.landmarks)} agree; {result.scans:,} scans, "
            f"{result.pieces} segments, {result.rejected} rejected"
            + (f", {result.fused} landmarks fused with others" if result.fused else "")
            + (f", {result.dynamic:,} returns left out that move" if result.dynamic else "")
            + (f", {result.enriched:,} alignments enriched" if result.enriched else ""),
        ),
        ("their sightings", ", ".join(told) or "none"),
    ]


def template_points(found: ScanLandmarks, slot: Index, place: Array) -> Array:
    """(P, 2) the points of templates with their axes at places (Q, 3) [m]."""
    placed = [
        found.template[s].shape.transformed(pose).mean
        for s, pose in zip(slot.tolist(), place, strict=True)
    ]
    return np.vstack([np.zeros((0, 2)), *placed])


def axes_of(estimate: Estimate, length_m: float = 2.0) -> Array:
    """(Q, 3, 2) the ends of each landmark's two axes, left's, origin, ahead's."""
    place, heading = estimate.oriented[:, :2], estimate.oriented[:, 2]
    ahead = np.stack((np.cos(heading), np.sin(heading)), axis=1)
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=1)
    return np.stack((place + length_m * left, place, place + length_m * ahead), axis=1)


def place_covariances(estimate: Estimate) -> Array:
    """(Q, 2, 2) of the places of scan landmarks."""
    return estimate.oriented_covariances()[:, :2, :2]
