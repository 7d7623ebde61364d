"""Constants of Nieto (2005), chapter 5, sections 6.1 and 6.2: scans as landmarks."""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="N 6.1.3",
        what="time between two searches for high level landmarks",
        value=60.0,
        unit="s",
        at="high_level.every_s",
        reason="",
    ),
)
