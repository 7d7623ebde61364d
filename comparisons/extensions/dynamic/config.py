"""Settings of dynamic-object rejection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig, Needs

if TYPE_CHECKING:
    from comparisons.extensions.dynamic.extension import Dynamic


class DynamicConfig(ExtensionConfig):
    """Dynamic-object rejection: exclude where objects move (Nieto 2005, section 6.3)."""

    look_s: float = Field(0.25, gt=0.0, description="Seconds between two map differences")
    threshold: float = Field(
        0.3, gt=0.0, lt=1.0, description="Least change of occupancy of a fast object"
    )
    slow_threshold: float = Field(
        0.35,
        gt=0.0,
        lt=1.0,
        description="Least change of occupancy of an object that was added or removed",
    )

    def needs(self) -> Needs:
        """A dense map that looks for motion."""
        return {"dense_maps": {"detect_motion": True}}

    def build(self, config: Configured) -> Dynamic:
        """Return the extension."""
        from comparisons.extensions.dynamic.extension import Dynamic

        return Dynamic(self)
