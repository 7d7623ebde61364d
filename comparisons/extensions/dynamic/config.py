"""Settings of dynamic-object rejection."""

from __future__ import annotations

from comparisons.config import ExtensionConfig, Needs, setting
from comparisons.options import SCANS, SWITCH, Option


class DynamicConfig(ExtensionConfig):
    """Dynamic-object rejection: exclude where objects move (Nieto 2005, section 6.3)."""

    extension = "comparisons.extensions.dynamic.extension:Dynamic"
    switch = Option(
        "--dynamic",
        SCANS,
        "Detect moving objects and exclude them from the filter. [off]",
        settings=SWITCH,
        off=True,
    )
    look_s: float = setting(0.25, "Seconds between two map differences", gt=0.0)
    absence_s: float = setting(
        10.0, "Seconds out of view after which a place is compared with the last visit", gt=0.0
    )
    threshold: float = setting(0.3, "Least change of occupancy of a fast object", gt=0.0, lt=1.0)
    slow_threshold: float = setting(
        0.35, "Least change of occupancy of an object that was added or removed", gt=0.0, lt=1.0
    )

    def needs(self) -> Needs:
        """A dense map that looks for motion."""
        return {"dense_maps": {"detect_motion": True}}
