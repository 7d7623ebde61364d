"""Settings of the rejection of what moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig, Needs

if TYPE_CHECKING:
    from comparisons.extensions.dynamic.extension import Dynamic


class DynamicConfig(ExtensionConfig):
    """Find where things move, and let the filter ignore these places (Nieto 2005, section 6.3)."""

    look_s: float = Field(0.25, gt=0.0, description="seconds between two differentiations of maps")
    threshold: float = Field(
        0.3, gt=0.0, lt=1.0, description="least change of occupancy of what moves fast"
    )
    slow_threshold: float = Field(
        0.35, gt=0.0, lt=1.0, description="the same of what is brought or taken away"
    )

    def needs(self) -> Needs:
        """A dense map that looks for motion."""
        return {"dense_maps": {"detect_motion": True}}

    def build(self, config: Configured) -> Dynamic:
        """Return the extension."""
        from comparisons.extensions.dynamic.extension import Dynamic

        return Dynamic(self)
