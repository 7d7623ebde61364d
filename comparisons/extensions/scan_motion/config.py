"""Settings of motion from scans."""

from __future__ import annotations

from typing import Literal

from comparisons.config import ExtensionConfig, setting
from comparisons.options import ABSENT, SCANS, Option


class ScanMotionConfig(ExtensionConfig):
    """Motion by scan matching (KISS-ICP)."""

    extension = "comparisons.extensions.scan_motion.extension:ScanMotionExtension"
    switch = Option(
        "--motion",
        SCANS,
        "Motion: wheel, scan (scan matching), or both. [wheel]",
        jobs=("run",),
        settings={"wheel": ABSENT, "scan": {"motion": "scan"}, "both": {"motion": "both"}},
    )
    motion: Literal["scan", "both"] = setting(
        "both",
        "Use. scan: in place of the odometry; both: odometry, and a third estimate "
        "by scan matching",
    )

    def libraries(self) -> dict[str, str]:
        """Scan odometry is KISS-ICP's."""
        return {"kiss_icp": f"--motion {self.motion}"}
