"""Constants of Guivant, Masson and Nebot (2002)."""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="G 4.1, after eq. 22",
        what="c1: least share of its variance that a passive state gains, else it is spared "
        "(the paper's example)",
        value=1e-4,
        at="comparisons.adapters.ekf_factory:LEAST_GAIN",
    ),
)
