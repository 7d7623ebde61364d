"""Settings of high level landmarks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.high_level.extension import HighLevel


class HighLevelConfig(ExtensionConfig):
    """High level landmarks: objects found in the filter's dense map (Nieto 2005, section 6.1).

    Section 6.1.3 searches every minute; in the worlds here a loop takes 77 s, and an object stays
    within reach for less than half of a minute.
    """

    cell_m: float = Field(
        0.2,
        ge=0.05,
        le=2.0,
        description="Cell size of the map and least distance of its Gaussians in metres",
    )
    pair_m: float = Field(
        12.0,
        ge=1.0,
        le=100.0,
        description="Greatest distance of two corners of a landmark in metres",
    )
    least: int = Field(200, ge=3, le=10**6, description="Least number of Gaussians of a landmark")
    every_s: float = Field(20.0, ge=0.1, le=1e6, description="Seconds between two searches")

    def build(self, config: Configured) -> HighLevel:
        """Return the extension."""
        from comparisons.extensions.dense_maps.config import DenseMapsConfig
        from comparisons.extensions.high_level.extension import HighLevel

        dense = DenseMapsConfig.of(**config.settings_of("dense_maps").model_dump())
        return HighLevel(self, dense)
