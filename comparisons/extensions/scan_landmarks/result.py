"""Scan landmarks in `result.json`, on the terminal, and their templates on the map."""

from __future__ import annotations

from comparisons.estimates.estimate import Estimate
from comparisons.extensions.contract import Row
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.pipeline.gaps import Gaps
from comparisons.report.model import Model
from comparisons.report.models import LandmarkResult
from comparisons.report.sections import block_fields


def scan_slam_result(source: ScanSlamSource, ekf: Estimate, gaps: Gaps) -> ScanSlamResult:
    """Return what the scans gave as landmarks."""
    found, smoothed = source.found, gaps.smoothed
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
                **block_fields(b),
            )
            for i, b in enumerate(gaps.agreement.oriented)
        ],
        rejected=found.rejected,
        dynamic=found.dynamic,
        deactivated=len(found.moving),
        fused=source.merged,
        enriched=source.enriched,
        pieces=source.pieces,
        sightings=dict(found.reasons),
    )


def scan_slam_rows(result: ScanSlamResult) -> list[Row]:
    """Return how many agree, and what became of the sightings."""
    agreeing = sum(row.agrees for row in result.landmarks)
    told = (f"{count:,} {reason}" for reason, count in result.sightings.items() if count)
    return [
        Row(
            "scan landmarks",
            f"{agreeing} of {len(result.landmarks)} agree; {result.scans:,} scans, "
            f"{result.pieces} segments, {result.rejected} rejected"
            + (f", {result.fused} landmarks fused with others" if result.fused else "")
            + (f", {result.dynamic:,} returns left out that move" if result.dynamic else "")
            + (f", {result.deactivated} landmarks deactivated there" if result.deactivated else "")
            + (f", {result.enriched:,} alignments enriched" if result.enriched else ""),
        ),
        Row("their sightings", ", ".join(told) or "none"),
    ]


class ScanLandmarkResult(LandmarkResult):
    """The same of a scan landmark. sightings: used of it. points: of its template."""

    ekf_heading_rad: float
    smoother_heading_rad: float
    sightings: int
    points: int


class ScanSlamResult(Model):
    """Scan-SLAM. scans: looked at. rejected: segments that failed their trial.

    dynamic: returns left out since something moves there; deactivated: landmarks that are matched
    no more, since their template lies there.
    pieces: whether all segments of a scan are one landmark, or each its own. fused: landmarks
    found to be others. enriched: alignments that began where what stands around fits. sightings:
    how often a landmark near the scanner was used, or why not.
    """

    scans: int
    landmarks: list[ScanLandmarkResult]
    rejected: int
    dynamic: int = 0
    deactivated: int = 0
    fused: int = 0
    enriched: int = 0
    pieces: str = "single"
    sightings: dict[str, int]
