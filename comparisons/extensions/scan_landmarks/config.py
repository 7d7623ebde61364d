"""Settings of scan landmarks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from comparisons.choices import Pieces, Templates
from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.scan_landmarks.extension import ScanLandmarksExtension

_MAPPED = "dense_maps"


class ScanLandmarksConfig(ExtensionConfig):
    """Landmarks made of raw scans (Scan-SLAM, Nieto 2005, chapter 5)."""

    landmarks: Literal["scans", "both"] = Field(
        "scans", description="in place of the log's measurements, or beside them"
    )
    pieces: Pieces | None = Field(
        None,
        description="all segments of a scan make one landmark, or each its own; if absent, joined, "
        "but single where a dense map is anchored to them",
    )
    templates: Templates = Field(
        "bare", description="enriched: align with what the dense map holds around, too"
    )
    fuse: bool = Field(False, description="fuse landmarks that turn out to be one")
    least_returns: int | None = Field(
        None, ge=3, le=10**6, description="of a template; if absent, 50 joined, 15 single"
    )
    residual: float = Field(
        0.15, gt=0.0, le=1.0, description="greatest error of a trial over its displacement"
    )
    open_directions: int = Field(
        2, ge=0, le=2, description="of x, y and heading, that a template may leave open"
    )
    trials: int = Field(2, ge=1, le=100, description="copies that a candidate is tried with")
    tried: int = Field(
        2, ge=0, le=10**4, description="single segments of a scan that are tried, 0 for all"
    )
    every: int | None = Field(
        None,
        ge=1,
        le=10**6,
        description="scans from one that may initialise landmarks to the next; if absent, 5 "
        "joined, 2 single",
    )
    in_view: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="share of a template that must be in view; if absent, 0.5 joined, 0.9 single",
    )
    aligned: int = Field(
        5, ge=0, le=10**6, description="templates that a scan is aligned with, 0 for all in view"
    )
    gate: float = Field(11.345, gt=0.0, le=1e6, description="of measurements, chi-square of three")

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
            raise ValueError(
                f"--attributes {config.ekf.attributes} tells points apart; use --landmarks points "
                "or both"
            )
        if "high_level" in config.extensions:
            raise ValueError("--high-level goes with --landmarks points only")
        if self.fuse and (_MAPPED in config.extensions or self.templates == "enriched"):
            # Regions anchored to a landmark that was fused would stay behind.
            raise ValueError(
                "--fuse-landmarks goes without --dense, --dynamic, --attributes layer and "
                "--templates enriched: regions of a map hang on scan landmarks for good"
            )

    def build(self, config: Configured) -> ScanLandmarksExtension:
        """Return the extension."""
        from comparisons.extensions.dense_maps.config import DenseMapsConfig
        from comparisons.extensions.scan_landmarks.extension import ScanLandmarksExtension

        dense = DenseMapsConfig.of(**config.settings_of(_MAPPED).model_dump())
        return ScanLandmarksExtension(self, mapped=_MAPPED in config.extensions, dense=dense)
