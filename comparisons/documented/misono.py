"""Constants of Misono et al. (2007)."""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="M 3.4, eq. 17",
        what="association: distance in metres",
        value="euclidean",
        at="ekf.association",
        when={"ekf.filter": ("misono", "misono-full")},
        reason="",
    ),
)
