"""Constants of Misono et al. (2007).

The paper states few: "each parameter requires a value in our experience" (4.1). Course, sensors and
sigmas of its simulation are not in it; those of `waypoint-run` are ours.
"""

from __future__ import annotations

from comparisons.documented.row import Documented

ROWS = (
    Documented(
        place="M 3.1, eqs. 3 to 5",
        what="anything that keeps the direction cosines on the unit circle: nothing",
        value=False,
        at="ekf_reference.filters.misono:DirectionCosineOptions.renormalise",
    ),
    Documented(
        place="M 3.2, eq. 9",
        what="columns of the Jacobian by the direction cosines: none",
        value=False,
        at="ekf_reference.filters.misono:DirectionCosineOptions.full_jacobian",
    ),
    Documented(
        place="M 3.3",
        what="landmarks of one instant fused together: no, steps 2 and 3 are repeated M times",
        value=False,
        at="ekf_reference.filters.misono:DirectionCosineOptions.stacked",
    ),
    Documented(
        place="M 3.3",
        what="gate beyond which a measurement is rejected (`misono`; other filters have one)",
        value=float("inf"),
        at="comparisons.adapters.ekf_factory:NO_GATE",
    ),
    Documented(
        place="M 3.4, eq. 17",
        what="association: distance in metres",
        value="euclidean",
        at="ekf.association",
        when={"ekf.filter": ("misono", "misono-full")},
        absent="the log's labels, else nearest neighbour",
        reason="labels are taken where the log has them, so that filter and smoother are compared "
        "by their algebra and not by mistaken landmarks; by eq. 17 without GPS the published "
        "filter errs by 0.61 m, with labels and GPS by 0.48 m (median of 10 drives, "
        "benchmarks/waypoint_run.py)",
    ),
    Documented(
        place="M 3.4, eq. 17",
        what="d_min is larger than the way of one sampling time",
        value=True,
        at="comparisons.adapters.ekf_factory:d_min_exceeds_way()",
    ),
)
