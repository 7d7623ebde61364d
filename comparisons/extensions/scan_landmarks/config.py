"""Settings of scan landmarks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from comparisons.choices import TemplateExtraction
from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.scan_landmarks.extension import ScanLandmarksExtension

_MAPPED = "dense_maps"


class ScanLandmarksConfig(ExtensionConfig):
    """Landmarks that are templates of laser scans (Scan-SLAM, Nieto 2005, chapter 5)."""

    landmarks: Literal["scans", "both"] = Field(
        "scans", description="Use. scans: in place of the log's landmarks; both: beside them"
    )
    template_extraction: TemplateExtraction | None = Field(
        None,
        description="Template extraction. whole-scan: all segments of a scan make one landmark; "
        "per-segment: each segment makes its own. Default: whole-scan, but per-segment where a "
        "dense map is anchored to the landmarks",
    )
    merge_landmarks: bool = Field(
        False, description="Merge scan landmarks that turn out to be the same"
    )
    least_returns: int | None = Field(
        None,
        ge=3,
        le=10**6,
        description="Least number of returns of a template. Default: 50 (whole-scan), 15 "
        "(per-segment)",
    )
    residual: float = Field(
        0.15,
        gt=0.0,
        le=1.0,
        description="Greatest error of a trial alignment, as a share of its displacement",
    )
    open_directions: int = Field(
        2,
        ge=0,
        le=2,
        description="Number of directions (x, y, heading) that a template may leave undetermined",
    )
    trials: int = Field(
        2, ge=1, le=100, description="Number of trial alignments of a template candidate"
    )
    tried: int = Field(
        2,
        ge=0,
        le=10**4,
        description="Number of segments of a scan that are tried as templates (per-segment); 0: "
        "all",
    )
    every: int | None = Field(
        None,
        ge=1,
        le=10**6,
        description="Number of scans between two that may initialise landmarks. Default: 5 "
        "(whole-scan), 2 (per-segment)",
    )
    in_view: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="Share of a template that must be in view to be matched. Default: 0.5 "
        "(whole-scan), 0.9 (per-segment)",
    )
    aligned: int = Field(
        5,
        ge=0,
        le=10**6,
        description="Greatest number of templates that are matched in one scan; 0: all in view",
    )
    gate: float = Field(
        11.345,
        gt=0.0,
        le=1e6,
        description="Gate of a template measurement: chi-square of 3 degrees of freedom",
    )
    shared_noise: bool = Field(
        True,
        description="Count the noise of returns that several alignments share once. Off: take all "
        "alignments for independent",
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

    def build(self, config: Configured) -> ScanLandmarksExtension:
        """Return the extension."""
        from comparisons.extensions.scan_landmarks.extension import ScanLandmarksExtension

        return ScanLandmarksExtension(self, mapped=_MAPPED in config.extensions)
