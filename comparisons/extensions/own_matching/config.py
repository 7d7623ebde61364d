"""Settings of the smoother's own matcher."""

from __future__ import annotations

from comparisons.config import Configured, ExtensionConfig
from comparisons.options import ABSENT, Option


class OwnMatchingConfig(ExtensionConfig):
    """Second solution, with scan landmarks matched by Open3D's generalised ICP."""

    extension = "comparisons.extensions.own_matching.extension:OwnMatching"
    switch = Option(
        "--smoother-matcher", jobs=("run",), settings={"ekf": ABSENT, "generalised-icp": {}}
    )

    def check_with(self, config: Configured) -> None:
        """There must be scan landmarks to match."""
        if "scan_landmarks" not in config.extensions:
            raise ValueError(
                "--smoother-matcher generalised-icp goes with --landmarks scans or both"
            )

    def libraries(self) -> dict[str, str]:
        """The matcher is Open3D's."""
        return {"open3d": "--smoother-matcher generalised-icp"}
