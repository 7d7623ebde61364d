"""All rows, in the documents' order. A further constant is one row more."""

from __future__ import annotations

from comparisons.documented import guivant, misono, nieto_dense, nieto_scans, nieto_slam
from comparisons.documented.row import Documented

GROUPS: dict[str, tuple[Documented, ...]] = {
    "G: Guivant, Masson and Nebot (2002)": guivant.ROWS,
    "M: Misono et al. (2007)": misono.ROWS,
    "N: Nieto (2005), chapter 2 and appendix A: SLAM": nieto_slam.ROWS,
    "N: Nieto (2005), chapters 3 and 4, section 6.3: dense maps": nieto_dense.ROWS,
    "N: Nieto (2005), chapter 5, sections 6.1 and 6.2: scans as landmarks": nieto_scans.ROWS,
}
ROWS: tuple[Documented, ...] = tuple(row for rows in GROUPS.values() for row in rows)
