"""All settings that a document states; those of Guivant (2002) and Misono (2007) stand here.

A further setting is one row more. Guivant's sigmas, gates and bounds on an update (section 4.2)
are given without numbers. Misono states few: "each parameter requires a value in our experience"
(4.1); course and sensors of its simulation are not in it, those of `waypoint-run` are ours.
"""

from __future__ import annotations

import math

from comparisons.documented import nieto_dense, nieto_scans, nieto_slam
from comparisons.documented.row import Documented

_OF_HEADINGS = ("full", "compressed", "compressed-suboptimal")

GUIVANT = (
    Documented(
        place="G 4.2", what="gate of absolute positions: none", value=math.inf,
        at="ekf.position_gate", when={"ekf.gps": ("on", "half"), "ekf.filter": _OF_HEADINGS},
        absent="13.82", defaults=("ekf_reference.models.position:PositionFixes.gate",),
        reason="on Victoria Park (--filter compressed-suboptimal --gps half) 387 of 2,523 "
        "positions that are off are then fused: the mean NIS of positions is 3.0 instead of 1.34; "
        "from the positions held out the filter is 0.895 m (median) instead of 0.983, the smoother "
        "0.870 instead of 0.868",
    ),
    Documented(
        place="G 5, Fig. 6", what="accuracy of the receiver for short periods, Victoria Park's log",
        value=0.1, unit="m", at="ekf.stretch_sigma_m",
        when={"log.format": ("victoria-park",), "ekf.gps": ("on", "half")},
        absent="all positions, 0.5 m",
        reason="gps.dat does not say how good a position is. The preset takes those of stretches "
        "of 5 s and more that keep one distance from SLAM, to 0.1 m, and one of at most 0.3 m, by "
        "a first run with all at 0.5 m; the others are left out: 786 of 4,465 in 14 stretches "
        "(--filter compressed --gps on), 40 s instead of 27. From the positions held out (--gps "
        "half) the smoother is then 0.815 m (median) instead of 0.870, but the filter, without a "
        "position for minutes, 1.68 m instead of 0.987. All positions at 0.1 m and without a gate: "
        "0.872 and 1.14 m, at 0.02 m 1.08 and 1.56",
    ),
)  # fmt: skip

MISONO = (
    Documented(
        place="M 3.4, eq. 17", what="association: distance in metres", value="euclidean",
        at="ekf.association", when={"ekf.filter": ("misono", "misono-full")},
        absent="the log's labels, else nearest neighbour",
        reason="labels are taken where the log has them, so that filter and smoother are compared "
        "by their algebra and not by mistaken landmarks; by eq. 17 without GPS the published "
        "filter errs by 0.61 m, with labels and GPS by 0.48 m (median of 10 drives, "
        "research.documents M5)",
    ),
)  # fmt: skip

ROWS: tuple[Documented, ...] = (
    *GUIVANT,
    *MISONO,
    *nieto_slam.ROWS,
    *nieto_dense.ROWS,
    *nieto_scans.ROWS,
)
