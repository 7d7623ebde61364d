"""Settings of scan landmarks."""

from __future__ import annotations

from typing import Literal

from comparisons.config import Configured, ExtensionConfig, setting
from comparisons.options import ABSENT, SCANS, Option

_MAPPED = "dense_maps"
_WITHIN = "--landmarks scans or both"


class ScanLandmarksConfig(ExtensionConfig):
    """Landmarks that are templates of laser scans (Scan-SLAM, Nieto 2005, chapter 5)."""

    extension = "comparisons.extensions.scan_landmarks.extension:ScanLandmarksExtension"
    switch = Option(
        "--landmarks",
        SCANS,
        "Landmarks: points, scans (Scan-SLAM), or both. [points]",
        settings={"points": ABSENT, "scans": {"landmarks": "scans"}, "both": {"landmarks": "both"}},
    )
    landmarks: Literal["scans", "both"] = setting(
        "scans", "Use. scans: in place of the log's landmarks; both: beside them"
    )
    template_extraction: Literal["whole-scan", "per-segment"] | None = setting(
        None,
        "Template extraction. whole-scan: all segments of a scan make one landmark; "
        "per-segment: each segment makes its own. Default: whole-scan, but per-segment where a "
        "dense map is anchored to the landmarks",
        Option("--template-extraction", within=_WITHIN),
    )
    merge_landmarks: bool = setting(
        False,
        "Merge scan landmarks that turn out to be the same",
        Option("--merge-landmarks", jobs=("run",), within=_WITHIN, off=True),
    )
    least_returns: int | None = setting(
        None,
        "Least number of returns of a template. Default: 50 (whole-scan), 15 (per-segment)",
        ge=3,
        le=10**6,
    )
    residual: float = setting(
        0.15, "Greatest error of a trial alignment, as a share of its displacement", gt=0.0, le=1.0
    )
    open_directions: int = setting(
        2, "Number of directions (x, y, heading) that a template may leave undetermined", ge=0, le=2
    )
    trials: int = setting(2, "Number of trial alignments of a template candidate", ge=1, le=100)
    tried: int = setting(
        2,
        "Number of segments of a scan that are tried as templates (per-segment); 0: all",
        ge=0,
        le=10**4,
    )
    every: int | None = setting(
        None,
        "Number of scans between two that may initialise landmarks. Default: 5 "
        "(whole-scan), 2 (per-segment)",
        ge=1,
        le=10**6,
    )
    in_view: float | None = setting(
        None,
        "Share of a template that must be in view to be matched. Default: 0.5 "
        "(whole-scan), 0.9 (per-segment)",
        gt=0.0,
        le=1.0,
    )
    aligned: int = setting(
        5,
        "Greatest number of templates that are matched in one scan; 0: all in view",
        ge=0,
        le=10**6,
    )
    gate: float = setting(
        11.345, "Gate of a template measurement: chi-square of 3 degrees of freedom", gt=0.0, le=1e6
    )
    alignment_covariance: Literal["sandwich", "curvature"] = setting(
        "sandwich",
        "Covariance of an alignment. sandwich: of the error that the returns' noise causes; "
        "curvature: of the correlation's own shape (Nieto 2005, eqs. 5.16 and 5.17)",
    )
    shared_noise: bool = setting(
        True,
        "Count the noise of returns that several alignments share once, with alignment_covariance "
        "sandwich; curvature knows no returns. Off: take all alignments for independent",
    )

    def check_with(self, config: Configured) -> None:
        """Raise ValueError for what does not go together."""
        points = {"scan_motion": "--motion both", "own_association": "--smoother-association own"}
        for name, option in points.items():
            third = config.extensions.get(name)
            if third is None or getattr(third, "motion", "both") != "both":
                continue
            if self.landmarks == "scans":
                raise ValueError(f"{option} compares landmarks that are points; "
                                 "use --landmarks both")  # fmt: skip
        if self.landmarks == "scans" and config.ekf.attributes != "off":
            raise ValueError("--attributes on tells points apart; use --landmarks points or both")
        if "high_level" in config.extensions:
            raise ValueError("--high-level goes with --landmarks points only")
        if self.merge_landmarks and _MAPPED in config.extensions:
            # Regions anchored to a landmark that was merged would stay behind.
            raise ValueError(
                "--merge-landmarks goes without --dense and --dynamic: regions of a map are "
                "anchored to scan landmarks for good"
            )
