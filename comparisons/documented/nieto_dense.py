"""Settings that Nieto (2005), chapters 3 and 4, states for dense maps."""

from __future__ import annotations

import math

from comparisons.documented.row import AnyBut, Documented

CAR_PARK = {"log.format": ("acfr-car-park",)}
OTHERS = {"log.format": AnyBut(("acfr-car-park",))}
_SIMULATIONS = (
    "scan-loop",
    "scan-loop-enclosed",
    "scan-loop-fine",
    "scan-loop-3d",
    "occupancy-loop",
    "occupancy-loop-enclosed",
)
_BY = " (research/dense_maps.py)"

ROWS = (
    Documented(
        place="N 3.5, first condition",
        what="correlation of each pair of a region's landmarks: high", value=0.9, named=True,
        at="dense_maps.least_correlation",
        also=("ekf_reference.dense.conditions:Conditions.least_correlation",),
    ),
    Documented(
        place="N 3.5, first condition",
        what="relative sigma that lets a pair into a region whatever its correlation (0: none)",
        value=0.0, unit="m", at="dense_maps.known_apart_m",
        absent="0.5 m, 1.5 m on scan landmarks alone",
        also=("ekf_reference.dense.conditions:Conditions.known_apart_m",),
        reason="0 leaves 51 % of the returns of scan-loop without a region instead of 16 %, 43 % "
        "instead of 13 % on occupancy-loop (6 and 8 drives of one loop, among 80 landmarks more), "
        "and the map is no closer to the surfaces (median 0.29 m instead of 0.26, 0.23 instead of "
        "0.21): landmarks near a well known vehicle are well known against each other and "
        "correlate little" + _BY,
    ),
    Documented(
        place="N 3.5", what="longest edge of a region (none in its three conditions)",
        value=math.inf, unit="m", at="dense_maps.longest_edge_m",
        defaults=("ekf_reference.dense.conditions:Conditions.longest_edge_m",),
        absent="35 m, 60 m on scan landmarks alone",
        reason="a bound that keeps regions small, with little effect: without it and with it 95 % "
        "of the distances are 0.68 m on scan-loop, 0.59 on occupancy-loop; without it 19 and 13 % "
        "of the returns are in no region, with it 16 and 13 % (the same drives)" + _BY,
    ),
    Documented(
        place="N 3.5, second condition, Fig. 3.10 (a)",
        what="how it is tested that a region cannot flip over", value="ellipses",
        at="dense_maps.flip_test",
        reason="the thesis calls it very conservative; ours takes the correlations into account. "
        "It hardly matters at the stated noise: by ellipses 944 regions instead of 946 on "
        "scan-loop, 1,102 instead of 1,115 on occupancy-loop (the same drives)" + _BY,
    ),
    Documented(
        place="N 3.9",
        what="returns wait for their region (3.7.3; the thesis' experiments leave it out)",
        value=False, at="dense_maps.delayed",
        reason="without it 46 % of the returns of scan-loop are in no region instead of 16 %, 38 % "
        "instead of 13 % on occupancy-loop; those that wait are less accurate (95 % of all "
        "distances 0.68 m with it, 0.60 without, and 0.59 and 0.53; the same drives)" + _BY,
    ),
    Documented(
        place="N 3.9, 4.1.3 (3.10 has them on the car park)",
        what="regions with a virtual corner (3.5.1) in the simulations", value=False,
        at="dense_maps.virtual_landmarks",
        when={"log.source": _SIMULATIONS},
        reason="without them 39 % of the returns of scan-loop are in no region instead of 16 %, "
        "29 % instead of 13 % on occupancy-loop; distances are alike (95 %: 0.65 m instead of "
        "0.68, 0.58 instead of 0.59; the same drives)" + _BY,
    ),
    Documented(
        place="N 4.1.1, eq. 4.4", what="p_max, occupancy where a return comes from", value=0.9,
        named=True, at="dense_maps.p_occupied",
        also=("ekf_reference.dense.sensor_model:InverseSensorModel.p_occupied",),
        reason="with 0.9 one noisy return makes a cell occupied: 95 % of the distances 0.94 m "
        "instead of 0.68 on scan-loop, 0.77 instead of 0.59 on occupancy-loop (p_free 0.3; the "
        "same drives)" + _BY,
    ),
    Documented(
        place="N 4.1.1, eq. 4.4", what="p_min, occupancy before a return", value=0.3, named=True,
        at="dense_maps.p_free",
        also=("ekf_reference.dense.sensor_model:InverseSensorModel.p_free",),
        reason="what stands is often looked past; measured with p_occupied 0.9: median of the "
        "distances 0.32 m instead of 0.26 on scan-loop, 0.25 instead of 0.21 on occupancy-loop "
        "(the same drives)" + _BY,
    ),
    Documented(
        place="N 4.1.2, eq. 4.7; 4.2.2, eq. 4.11", what="bound of occupancy", value=1.0,
        at="dense_maps.confidence",
        defaults=("ekf_reference.dense.layers.grid_update:GridUpdate.confidence",),
        reason="with a bound a map forgets what has changed; in a scene that stays it hardly "
        "matters: without it the occupied cells of one grid cover 1.02 times the area of "
        "DenseSLAM's after ten rounds of occupancy-loop, with it 1.00 times "
        "(N4.4 in docs/results-reproduction.md)",
    ),
    Documented(
        place="N 4.1.3, Fig. 4.6", what="size of cells", value=0.2, unit="m",
        at="dense_maps.resolution_m", when=OTHERS,
        also=("ekf_reference.dense.layers.grid_update:GridUpdate.resolution_m",),
    ),
    Documented(
        place="N 4.4, Fig. 4.15", what="size of cells of the car park's occupancy grid", value=0.4,
        unit="m", at="dense_maps.resolution_m", when=CAR_PARK,
        reason="runs use section 4.1.3's 0.2 m everywhere, which shows finer shapes: 27,134 cells "
        "instead of 7,128, 556 of them occupied instead of 287 "
        "(slamcheck map acfr_car_park --layer occupancy)",
    ),
    Documented(
        place="N 4.2.3, 4.3.3", what="d_min of particles and of Gaussians", value=0.2, unit="m",
        at="dense_maps.d_min_m", when=OTHERS,
        defaults=(
            "ekf_reference.dense.layers.particles:Particles.d_min_m",
            "ekf_reference.dense.layers.gaussians:Gaussians.d_min_m",
        ),
    ),
    Documented(
        place="N 4.2.3, 4.3.3",
        what="particles and Gaussians that have come to lie on others are dropped: not subsampled",
        value=False, at="dense_maps.thinned",
        defaults=(
            "ekf_reference.dense.layers.particles:Particles.thinned",
            "ekf_reference.dense.layers.gaussians:Gaussians.thinned",
        ),
        reason="to bound their number: after ten rounds of occupancy-loop 17,087 particles instead "
        "of 51,902, of which 73 % instead of 91 % weigh more than 0.8, and 12,823 Gaussians "
        "instead of 32,249; from the surfaces, both are 1.03 times as far as raw returns either "
        "way (research/dense_maps.py --particles)",
    ),
    Documented(
        place="N 4.2.3", what="weight below which a particle is dropped: not subsampled", value=0.0,
        at="dense_maps.least_weight",
        reason="to bound their number: a tenth of all weigh less (N4.10 there)",
    ),
    Documented(
        place="N 6.5, Fig. 6.14", what="d_min of the car park's Gaussians", value=0.5, unit="m",
        at="dense_maps.d_min_m", when=CAR_PARK,
        reason="runs use section 4.3.3's 0.2 m everywhere, which shows finer shapes: 1,458 "
        "Gaussians instead of 412 (slamcheck map acfr_car_park --layer sog)",
    ),
)  # fmt: skip
