"""All rows, in the documents' order; those of Guivant (2002) and Misono (2007) stand here.

A further constant is one row more. Guivant's sigmas, gates and bounds on an update (section 4.2)
are given without numbers. Misono states few: "each parameter requires a value in our experience"
(4.1); course and sensors of its simulation are not in it, those of `waypoint-run` are ours.
"""

from __future__ import annotations

import math

from comparisons.documented import nieto_dense, nieto_scans, nieto_slam
from comparisons.documented.row import Documented

_OF_HEADINGS = ("full", "compressed", "compressed-suboptimal")
_FIGURES = "comparisons.experiments.reproduction.guivant"

GUIVANT = (
    Documented(
        place="G 2, eq. 2",
        what="bearing that the sensor reads straight ahead; readers take it off",
        value=math.pi / 2.0, unit="rad",
        at="comparisons.logs.readers.victoria_park:STRAIGHT_AHEAD_RAD",
    ),
    Documented(
        place="G 3.1, eq. 11", what="returns of a scan over 180 degrees (NR + 1)", value=361,
        at="comparisons.logs.simulate.scanners:half_degrees().size",
    ),
    Documented(
        place="G 3.1, after eq. 12", what="farthest range of trunks outdoors (from 3 m on)",
        value=40.0, unit="m", at="ekf_reference.features.tree_detection:TrunkModel.range_limit_m",
    ),
    Documented(
        place="G 4.1, after eq. 22",
        what="c1: least share of its variance that a passive state gains, else it is spared "
        "(the paper's example)",
        value=1e-4, at="comparisons.adapters.ekf_factory:LEAST_GAIN",
    ),
    Documented(
        place="G 5", what="accuracy of the RTK GPS at its best", value=0.02, unit="m",
        at=f"{_FIGURES}:RTK_M",
        reason="the figures take the 0.1 m that it reported for short periods in this experiment "
        "(next row)",
    ),
    Documented(
        place="G 5, Fig. 6",
        what="accuracy that the GPS reported for short periods, between the trees", value=0.1,
        unit="m", at=f"{_FIGURES}:RTK_M",
    ),
    Documented(
        place="G 4.2", what="gate of absolute positions: none", value=math.inf,
        at="ekf.position_gate", when={"ekf.gps": ("on", "half"), "ekf.filter": _OF_HEADINGS},
        absent="13.82", defaults=("ekf_reference.models.position:PositionFixes.gate",),
        reason="on Victoria Park (--filter compressed-suboptimal --gps half) 300 of 2,233 "
        "positions that are off are then fused: the mean NIS of positions is 19.4 instead of 1.34, "
        "and filter and smoother are 0.054 m apart in the map instead of 0.025; from the positions "
        "held out 0.733 m instead of 0.761",
    ),
    Documented(
        place="G 5, Fig. 6", what="accuracy of the positions in Victoria Park's log", value=0.1,
        unit="m", at="log.sigma_position_m", when={"log.format": ("victoria-park",)},
        absent="0.5 m",
        reason="gps.dat does not say how good a position is: at 0.1 m the gate rejects 2,200 of "
        "the 2,233 positions of --filter compressed --gps half, at 0.5 m 300; without a gate, as "
        "the preset has it, 0.1 m pulls the path to within 0.356 m of the positions held out, but "
        "their mean NIS is 301 and 57 of 327 landmarks are not the smoother's",
    ),
    Documented(
        place="G 5, Fig. 9", what="SLAM without GPS before the loop is closed by GPS", value=200.0,
        unit="s", at=f"{_FIGURES}:ALONE_S",
    ),
)  # fmt: skip

MISONO = (
    Documented(
        place="M 3.1, eqs. 3 to 5",
        what="anything that keeps the direction cosines on the unit circle: nothing", value=False,
        at="ekf_reference.filters.misono:DirectionCosineOptions.renormalise",
    ),
    Documented(
        place="M 3.2, eq. 9", what="columns of the Jacobian by the direction cosines: none",
        value=False, at="ekf_reference.filters.misono:DirectionCosineOptions.full_jacobian",
    ),
    Documented(
        place="M 3.3",
        what="landmarks of one instant fused together: no, steps 2 and 3 are repeated M times",
        value=False, at="ekf_reference.filters.misono:DirectionCosineOptions.stacked",
    ),
    Documented(
        place="M 3.3",
        what="gate beyond which a measurement is rejected (`misono`; other filters have one)",
        value=float("inf"), at="comparisons.adapters.ekf_factory:NO_GATE",
    ),
    Documented(
        place="M 3.4, eq. 17", what="association: distance in metres", value="euclidean",
        at="ekf.association", when={"ekf.filter": ("misono", "misono-full")},
        absent="the log's labels, else nearest neighbour",
        reason="labels are taken where the log has them, so that filter and smoother are compared "
        "by their algebra and not by mistaken landmarks; by eq. 17 without GPS the published "
        "filter errs by 0.61 m, with labels and GPS by 0.48 m (median of 10 drives, "
        "slamcheck reproduce M5)",
    ),
    Documented(
        place="M 3.4, eq. 17", what="d_min is larger than the way of one sampling time", value=True,
        at="comparisons.adapters.ekf_factory:d_min_exceeds_way()",
    ),
)  # fmt: skip

GROUPS: dict[str, tuple[Documented, ...]] = {
    "G: Guivant, Masson and Nebot (2002)": GUIVANT,
    "M: Misono et al. (2007)": MISONO,
    "N: Nieto (2005), chapter 2 and appendix A: SLAM": nieto_slam.ROWS,
    "N: Nieto (2005), chapters 3 and 4, section 6.3: dense maps": nieto_dense.ROWS,
    "N: Nieto (2005), chapter 5, sections 6.1 and 6.2: scans as landmarks": nieto_scans.ROWS,
}
ROWS: tuple[Documented, ...] = tuple(row for rows in GROUPS.values() for row in rows)
