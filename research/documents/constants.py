"""Constants of the documents that stand in code: a run has no setting for them.

`comparisons.documented` has those that are settings, which a document's preset sets. GROUPS has
both, for docs/settings.md. A further constant is one row more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from comparisons.documented import nieto_dense, nieto_scans, nieto_slam, rows
from comparisons.documented.row import Documented, Value

_FIGURES = "research.documents"
_DRIVES = "comparisons.logs.simulate.scan_drive"
_CAR_PARK = "comparisons.logs.readers.acfr_car_park"
_VICTORIA_PARK = "comparisons.logs.readers.victoria_park"
_A_1 = "comparisons.logs.transforms.published_sigmas:SensorSigmas"
_DYNAMIC = "ekf_reference.dense.dynamic:Differencing"
_TRIAL = "ekf_reference.scan_landmarks.template_extraction:TRIAL"
_SEGMENTS = "ekf_reference.scan_landmarks.segmentation:SegmentationOptions"
_SEARCH = "ekf_reference.scan_landmarks.high_level:SearchOptions"

_WHAT = {
    "sample_s": ("dead reckoning: sampling time", "s"),
    "sigma_steering_rad": ("steering sensor: sigma", "rad"),
    "sigma_speed_mps": ("velocity encoder: sigma", "m/s"),
    "scan_every": ("observations: sampling time, in samples of dead reckoning", "samples"),
    "max_range_m": ("observations: maximum range", "m"),
    "sigma_range_m": ("observations: sigma of range", "m"),
    "sigma_bearing_rad": ("observations: sigma of bearing", "rad"),
    "sigma_beam_rad": ("observations: sigma of a beam's bearing", "rad"),
    "speed_mps": ("speed of the vehicle", "m/s"),
    "loop_s": ("time to close the loop", "s"),
    "wheelbase_m": ("L of the UTE", "m"),
    "encoder_offset_m": ("H of the UTE", "m"),
    "sensor_forward_m": ("a of the UTE", "m"),
    "sensor_left_m": ("b of the UTE", "m"),
}


def _each(place: str, at: str, values: Mapping[str, Value]) -> Iterator[Documented]:
    """Rows of a table whose values runs use as they are. at: what has them as attributes."""
    for name, value in values.items():
        what, unit = _WHAT[name]
        yield Documented(place=place, what=what, value=value, at=f"{at}.{name}", unit=unit)


def _scanned(
    place: str, made: str, *, steering_deg: float, every: int, reach_m: float, range_m: float,
    bearing_deg: float,
) -> Iterator[Documented]:  # fmt: skip
    """Rows of one of the tables of simulated scans; single beams have the table's sigmas, too."""
    bearing = math.radians(bearing_deg)
    yield from _each(
        place, f"{_DRIVES}:{made}().drive",
        {"sample_s": 0.025, "sigma_steering_rad": math.radians(steering_deg),
         "sigma_speed_mps": 0.5, "scan_every": every, "max_range_m": reach_m,
         "sigma_range_m": range_m, "sigma_bearing_rad": bearing, "speed_mps": 3.0},
    )  # fmt: skip
    yield from _each(
        place, f"{_DRIVES}:{made}().scanner",
        {"max_range_m": reach_m, "sigma_range_m": range_m, "sigma_beam_rad": bearing},
    )  # fmt: skip


GUIVANT: tuple[Documented, ...] = (
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
        place="G 4", what="share of all states in a local area from which on all are active "
        "(compressed filter; the document has no such)", value=1.0,
        at="comparisons.adapters.ekf_factory:SHARE",
        reason="to keep phi costs more than it saves there: with 118 of 200 landmarks active a "
        "step takes 0.50 ms, one of the full filter 0.44 (research.documents G4.1)",
    ),
    Documented(
        place="G 5", what="accuracy of the RTK GPS at its best", value=0.02, unit="m",
        at=f"{_FIGURES}.guivant:RTK_M",
        reason="the figures take the 0.1 m that it reported for short periods in this experiment "
        "(next row)",
    ),
    Documented(
        place="G 5, Fig. 6",
        what="accuracy that the GPS reported for short periods, between the trees", value=0.1,
        unit="m", at=f"{_FIGURES}.guivant:RTK_M",
    ),
    Documented(
        place="G 5, Fig. 9", what="SLAM without GPS before the loop is closed by GPS", value=200.0,
        unit="s", at=f"{_FIGURES}.guivant:ALONE_S",
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
        place="M 3.4, eq. 17", what="d_min is larger than the way of one sampling time", value=True,
        at="comparisons.adapters.ekf_factory:d_min_exceeds_way()",
    ),
)  # fmt: skip

SLAM = (
    *_each(
        "N 2.9, Table 2.2", "comparisons.logs.simulate.drive:Drive",
        {"sample_s": 0.025, "sigma_steering_rad": math.radians(3.0), "sigma_speed_mps": 0.3,
         "scan_every": 8, "max_range_m": 20.0, "sigma_range_m": 0.15,
         "sigma_bearing_rad": math.radians(1.0), "speed_mps": 3.0, "loop_s": 85.0},
    ),
    Documented(
        place="N 2.9, Fig. 2.8; 3.9, Fig. 3.17; 5.6, Fig. 5.8",
        what="sigmas of the ellipses drawn of landmarks", value=3.0,
        at=f"{_FIGURES}.drawing:SIGMAS",
        also=("comparisons.extensions.scan_landmarks.figure:_SIGMAS",),
    ),
    *_scanned("N 3.9, Table 3.1", "dense_slam", steering_deg=3.0, every=14, reach_m=25.0,
              range_m=0.15, bearing_deg=1.5),
    *_scanned("N 4.1.3, Table 4.1", "occupancy", steering_deg=5.0, every=14, reach_m=25.0,
              range_m=0.10, bearing_deg=1.0),
    *_scanned("N 5.6, Table 5.1", "scan_slam", steering_deg=5.0, every=8, reach_m=35.0,
              range_m=0.10, bearing_deg=1.0),
    Documented(
        place="N 5.6, text", what="field of view of the sensor", value=30.0, unit="m",
        at=f"{_DRIVES}:scan_slam().scanner.max_range_m",
        reason="the text and Table 5.1 contradict each other; the table's 35 m is used",
    ),
    Documented(
        place="N 5.6, text", what="observations: sigma of bearing", value=math.radians(1.5),
        unit="rad", at=f"{_DRIVES}:scan_slam().scanner.sigma_beam_rad",
        reason="the text and Table 5.1 contradict each other; the table's 1 degree is used",
    ),
    *_each(
        "N 6.3.3, Fig. 6.9", f"{_DRIVES}:dynamic_lanes().scanner",
        {"sigma_range_m": 0.15, "sigma_beam_rad": math.radians(1.0)},
    ),
    Documented(
        place="N 6.3.3, Fig. 6.9", what="observations: sampling time, in samples of 0.025 s",
        value=4, unit="samples", at=f"{_DRIVES}:dynamic_lanes().drive.scan_every",
    ),
    Documented(
        place="N 6.3.3, Fig. 6.9", what="resolution of the map", value=0.2, unit="m",
        at="ekf_reference.dense.dynamic:DynamicLayer.resolution_m",
    ),
    Documented(
        place="N 6.3.3, Fig. 6.9", what="north of the two lanes of moving objects",
        value=(5.0, -5.0), unit="m", at="comparisons.logs.simulate.dynamic_worlds:LANES_M",
    ),
    Documented(
        place="N 6.3.3, slow motion", what="when the environment is modified", value=100.0,
        unit="s", at="comparisons.logs.simulate.dynamic_worlds:CHANGE_S",
        reason="our loop takes 34 s: at 40 s all places have been seen once, and the second loop "
        "still shows all changes",
    ),
    *_each(
        "N A.1", f"{_VICTORIA_PARK}:UTE",
        {"wheelbase_m": 2.83, "encoder_offset_m": 0.76, "sensor_forward_m": 3.78,
         "sensor_left_m": 0.5},
    ),
    Documented(
        place="N Table A.1", what="laser: maximum range", value=60.0, unit="m",
        at=f"{_CAR_PARK}:_NO_RETURN_M",
        reason="the log's no return is 81.9 m; none of the 64,634 returns is beyond 60 m, so both "
        "keep the same",
    ),
    Documented(
        place="N 6.3.3, fast motion", what="time between the two maps", value=1.0, unit="s",
        at=f"{_DYNAMIC}.fast_s",
    ),
    Documented(
        place="N Table A.1", what="velocity encoder: sigma", value=0.2, unit="m/s",
        at=f"{_A_1}.speed_mps",
    ),
    Documented(
        place="N Table A.1", what="steering sensor: sigma", value=math.radians(2.0), unit="rad",
        at=f"{_A_1}.steering_rad",
    ),
    Documented(
        place="N Table A.1", what="laser: sigma of range", value=0.15, unit="m",
        at=f"{_A_1}.range_m",
    ),
    Documented(
        place="N Table A.1", what="laser: sigma of bearing", value=math.radians(1.5), unit="rad",
        at=f"{_A_1}.bearing_rad",
    ),
)  # fmt: skip

DENSE = (
    Documented(
        place="N 4.4, Fig. 4.15", what="size of cells of the car park's occupancy grid, as drawn",
        value=0.4, unit="m", at=f"{_FIGURES}.nieto_car_park:CELL_M",
    ),
    Documented(
        place="N 3.9, Fig. 3.17", what="sigmas of a landmark's uncertainty bound", value=3.0,
        at="ekf_reference.dense.conditions:Conditions.flip_sigmas",
    ),
    Documented(
        place="N 4.1.2, eq. 4.7; 4.2.2, eq. 4.12", what="occupancy of what nothing is known of",
        value=0.5, at="ekf_reference.dense.layers.grid_update:PRIOR",
    ),
    Documented(
        place="N 4.1.3, Fig. 4.6", what="size of cells in almost empty regions", value=0.5,
        unit="m", at="ekf_reference.dense.layers.occupancy:Coarsening.resolution_m",
    ),
    Documented(
        place="N 4.1.3",
        what="cellsPercent: share of a region's cells that is empty in an almost empty one",
        value=0.99, at="ekf_reference.dense.layers.occupancy:Coarsening.share",
    ),
    Documented(
        place="N 4.1.3", what="minProb: occupancy below which a cell is empty", value=0.2,
        at="ekf_reference.dense.layers.occupancy:Coarsening.least",
    ),
    Documented(
        place="N 4.1.3, Fig. 4.3; 4.2.3",
        what="occupancy above which cells and particles are drawn and counted", value=0.8,
        at="comparisons.extensions.dense_maps.accuracy:OCCUPIED",
    ),
    Documented(
        place="N 4.3.3, eq. 4.18", what="k, of the widest Gaussian in d_min", value=0.8,
        at="ekf_reference.dense.layers.gaussians:Gaussians().widest",
    ),
)  # fmt: skip

SCANS = (
    Documented(
        place="N 6.1.3", what="time between two searches for high level landmarks, as drawn",
        value=60.0, unit="s", at=f"{_FIGURES}.nieto_high_level:EVERY_S",
    ),
    Documented(
        place="N 5.7", what="only what is in view of a segment's template is aligned", value=False,
        at="ekf_reference.scan_landmarks.template_extraction:SingleSegments.visible",
    ),
    Documented(
        place="N 5.4, eq. 5.17",
        what="unknowns of the fitted covariance, which more samples than that must fix", value=6,
        at="ekf_reference.scan_matching.alignment_covariance:LEAST_SAMPLES",
    ),
    Documented(
        place="N 6.2.1, Fig. 6.7 (c)", what="occupancy above which a cell is drawn", value=0.8,
        at="comparisons.extensions.dense_maps.accuracy:OCCUPIED",
    ),
    Documented(
        place="N 5.7", what="range between neighbours at which a segment ends", value=5.0, unit="m",
        at=f"{_SEGMENTS}.range_m",
    ),
    Documented(
        place="N 5.7", what="bearing between neighbours at which a segment ends",
        value=math.radians(3.0), unit="rad", at=f"{_SEGMENTS}.bearing_rad",
    ),
    Documented(
        place="N 5.2.2", what="only every second return is copied (the copy is of the segment)",
        value=False, at=f"{_TRIAL}.interleaved",
    ),
    Documented(
        place="N 6.1.3", what="from the corners to the sides of the rectangle", value=5.0, unit="m",
        at=f"{_SEARCH}.margin_m",
    ),
)  # fmt: skip

GROUPS: dict[str, tuple[Documented, ...]] = {
    "G: Guivant, Masson and Nebot (2002)": (*rows.GUIVANT, *GUIVANT),
    "M: Misono et al. (2007)": (*rows.MISONO, *MISONO),
    "N: Nieto (2005), chapter 2 and appendix A: SLAM": (*nieto_slam.ROWS, *SLAM),
    "N: Nieto (2005), chapters 3 and 4, section 6.3: dense maps": (*nieto_dense.ROWS, *DENSE),
    "N: Nieto (2005), chapter 5, sections 6.1 and 6.2: scans as landmarks": (
        *nieto_scans.ROWS,
        *SCANS,
    ),
}
ROWS: tuple[Documented, ...] = tuple(row for group in GROUPS.values() for row in group)
