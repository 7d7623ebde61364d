"""Constants of Nieto (2005), chapter 2 and appendix A."""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="N 2.9, Table 2.2",
        what="sigma of speed",
        value=0.3,
        unit="m/s",
        at="comparisons.logs.simulate.drive:Drive.sigma_speed_mps",
    ),
)
