"""Constants of Nieto (2005), chapters 3 and 4, section 6.3: dense maps."""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="N 3.5, first condition",
        what="relative sigma that lets a pair into a region whatever its correlation (0: none)",
        value=0.0,
        unit="m",
        at="dense_maps.known_apart_m",
        reason="",
    ),
)
