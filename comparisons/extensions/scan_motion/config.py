"""Settings of motion from scans."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.scan_motion.extension import ScanMotionExtension


class ScanMotionConfig(ExtensionConfig):
    """Motion by scan matching (KISS-ICP)."""

    motion: Literal["scan", "both"] = Field(
        "both",
        description="Use. scan: in place of the odometry; both: odometry, and a third estimate "
        "by scan matching",
    )

    def libraries(self) -> dict[str, str]:
        """Scan odometry is KISS-ICP's."""
        return {"kiss_icp": f"--motion {self.motion}"}

    def build(self, config: Configured) -> ScanMotionExtension:
        """Return the extension."""
        from comparisons.extensions.scan_motion.extension import ScanMotionExtension

        return ScanMotionExtension(self.motion)
