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
        "scans", description="in place of the log's sightings, or beside them"
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
            raise ValueError("--high-level on goes with --landmarks points only")
        if self.fuse and (_MAPPED in config.extensions or self.templates == "enriched"):
            # Regions anchored to a landmark that was fused would stay behind.
            raise ValueError(
                "--fuse-landmarks on goes without --dense, --dynamic on, --attributes layer and "
                "--templates enriched: regions of a map hang on scan landmarks for good"
            )

    def build(self, config: Configured) -> ScanLandmarksExtension:
        """Return the extension."""
        from comparisons.extensions.scan_landmarks.extension import ScanLandmarksExtension

        return ScanLandmarksExtension(self, mapped=_MAPPED in config.extensions)
