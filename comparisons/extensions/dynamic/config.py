"""Settings of the rejection of what moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.config import Configured, ExtensionConfig, Needs

if TYPE_CHECKING:
    from comparisons.extensions.dynamic.extension import Dynamic


class DynamicConfig(ExtensionConfig):
    """Find where things move, and let the filter ignore these places (Nieto 2005, section 6.3)."""

    def needs(self) -> Needs:
        """A dense map that looks for motion."""
        return {"dense_maps": {"detect_motion": True}}

    def build(self, config: Configured) -> Dynamic:
        """Return the extension."""
        from comparisons.extensions.dynamic.extension import Dynamic

        return Dynamic()
