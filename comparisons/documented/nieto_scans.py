"""Settings that Nieto (2005), chapter 5 and section 6.1, states for scans as landmarks.

Section 5.6, the simulation, asks for "a minimum number of neighbour points" and gives none; all
other numbers are those of section 5.7, of the car park.
"""

from __future__ import annotations

from comparisons.documented.nieto_dense import CAR_PARK, OTHERS
from comparisons.documented.row import Documented

_EXTRACTION = "ekf_reference.scan_landmarks.template_extraction"
_SLAM = "ekf_reference.scan_landmarks.scan_slam"
_SEGMENTS = "ekf_reference.scan_landmarks.segmentation:SegmentationOptions"
_SEARCH = "ekf_reference.scan_landmarks.high_level:SearchOptions"
_LIFE = "ekf_reference.scan_landmarks.high_level_lifecycle:HighLevelLandmarks"

_TEMPLATES = (
    Documented(
        place="N 5.2.2, 5.7", what="what becomes one landmark: each segment of a scan",
        value="per-segment", at="scan_landmarks.template_extraction",
        absent="whole-scan, per-segment under a dense map",
        reason="a segment alone tells less: by all settings of the thesis a path 0.27 and 0.50 as "
        "wrong as odometry's, with both loops closed (seeds 0 and 1 of scan-slam), whole scan 0.08 "
        "(median of seeds 0 to 2). On the car park, with the sandwich, 11 landmarks and 0.69 m "
        "from GPS (median), whole scan 0.20 m, odometry 0.74 m",
    ),
    Documented(
        place="N 5.6", what="least returns of a segment in the simulation", value=30, named=True,
        at="scan_landmarks.least_returns", when=OTHERS, absent="50 (whole-scan), 15 (per-segment)",
        reason="runs make one landmark of all segments of a scan: their path is 0.08 as wrong as "
        "odometry's (median of seeds 0 to 2 of scan-slam), by all settings of the thesis with 30 "
        "returns 0.27 and 0.50 (seeds 0 and 1)",
    ),
    Documented(
        place="N 5.7", what="least returns of a segment on the car park", value=100,
        at="scan_landmarks.least_returns", when=CAR_PARK,
        defaults=(f"{_SEGMENTS}.least_points", f"{_EXTRACTION}:JoinedSegments.least"),
        absent="50 (whole-scan), 15 (per-segment)",
        reason="4 segments have 100 in the first 60 s of Table 5.1's drive, seed 0; whole scan, "
        "the ATE is 0.46 m with 100 returns instead of 0.15 with 50",
    ),
    Documented(
        place="N 5.2.2, 5.7",
        what="scans from one whose segments are tried to the next: each new frame", value=1,
        at="scan_landmarks.every",
        defaults=(f"{_EXTRACTION}:JoinedSegments.every", f"{_EXTRACTION}:SingleSegments.every"),
        absent="5 (whole-scan), 2 (per-segment)",
        reason="a landmark in each scan is one too many: whole scan, 55 instead of 42 and an ATE "
        "of 0.85 m instead of 0.15 (the first 60 s of Table 5.1's drive, seed 0)",
    ),
    Documented(
        place="N 5.2.2", what="segments of a scan that are tried (0: each)", value=0,
        at="scan_landmarks.tried", defaults=(f"{_EXTRACTION}:SingleSegments.tried",),
        reason="to save time: per segment, the same 28 landmarks with all tried (the first 60 s of "
        "Table 5.1's drive, seed 0)",
    ),
    Documented(
        place="N 5.2.2", what="displaced copies that a segment is tried with", value=1,
        at="scan_landmarks.trials", defaults=(f"{_SEGMENTS}.trials",),
        reason="the worse of 2 is asked for, so that one lucky displacement lets nothing in; "
        "whole scan, 3 scans are rejected with 2 and 2 with 1 (the first 60 s of Table 5.1's "
        "drive, seed 0: ATE 0.21 m with 1, 0.15 with 2, which one drive cannot tell apart)",
    ),
    Documented(
        place="N 5.7", what="greatest error of a trial's alignment over its displacement",
        value=0.1, at="scan_landmarks.residual", defaults=(f"{_SEGMENTS}.residual",),
        reason="whole scan it decides nothing, 3 rejected by 0.15 and by 0.1; per segment, 0.1 "
        "rejects 59 instead of 40 with an ATE of 3.4 m instead of 2.4, in one drive (the first "
        "60 s of Table 5.1's, seed 0)",
    ),
    Documented(
        place="N 5.7",
        what="directions that a segment may leave open: the error is that of the whole pose",
        value=0, at="scan_landmarks.open_directions",
        reason="a wall alone tells its distance and its heading, and R says that it tells no more; "
        "whole scan, 0 rejects 6 instead of 3 with an ATE of 0.49 m instead of 0.15; per segment, "
        "77 instead of 40 with an ATE of 1.6 m instead of 2.4, in one drive: the thesis' may be "
        "the better one there (the first 60 s of Table 5.1's drive, seed 0)",
    ),
)  # fmt: skip
_OBSERVATION = (
    Documented(
        place="N 5.7", what="share of a template that must be in view", value=0.9,
        at="scan_landmarks.in_view",
        defaults=(
            f"{_EXTRACTION}:JoinedSegments.share",
            f"{_EXTRACTION}:SingleSegments.share",
            "ekf_reference.scan_landmarks.templates:SensorView.share",
        ),
        absent="0.5 (whole-scan), 0.9 (per-segment)",
        reason="the view changes sooner than one object's: whole scan, 0.9 gives 57 landmarks and "
        "an ATE of 0.20 m, 0.5 gives 42 and 0.15 m (the first 60 s of Table 5.1's drive, seed 0)",
    ),
    Documented(
        place="N 5.5", what="templates in view that a scan is aligned with (0: all)", value=0,
        at="scan_landmarks.aligned", defaults=(f"{_SLAM}:ScanSlamOptions.aligned",),
        reason="to save time: whole scan, all give the same 1,164 measurements as 5 (the first "
        "60 s of Table 5.1's drive, seed 0)",
    ),
    Documented(
        place="N 5.5, with 2.4",
        what="gate of an alignment: chi-square of three at 95 %, section 2.4's example",
        value=7.815, at="scan_landmarks.gate",
        defaults=(f"{_SLAM}:ScanSlamOptions.gate", f"{_SLAM}:GATE"),
        reason="99 %, as 95 % rejects good ones; it decides little: 2 of 1,165 instead of 1, with "
        "an ATE of 0.15 m in both (the first 60 s of Table 5.1's drive, seed 0)",
    ),
    Documented(
        place="N 5.4, eqs. 5.16 and 5.17",
        what="covariance of an alignment: of a Gaussian fitted to the correlation",
        value="curvature", at="scan_landmarks.alignment_covariance",
        defaults=("ekf_reference.scan_matching.alignment_covariance:CovarianceOptions.form",),
        reason="it is about that of one pair of returns, however many there are: over 200 "
        "alignments its NEES is below 0.3 of 3, where the sandwich's is in its 95 % band "
        "(tests/ekf_reference/scan_matching/test_alignment_covariance.py)",
    ),
    Documented(
        place="N 5.2.1, 5.4",
        what="returns that several alignments share are counted once (R is of each alone)",
        value=False, at="scan_landmarks.shared_noise",
        defaults=(f"{_SLAM}:ScanSlamOptions.shared_noise",),
        reason="taken for independent the filter is too sure, and its path worse: an ATE of 0.43 m "
        "instead of 0.15 (the first 60 s of Table 5.1's drive, seed 0)",
    ),
)  # fmt: skip
_SPARSE = (
    "runs use section 6.1.3's everywhere; with this section's 7 m and 0.5 m no landmark of the car "
    "park has 200 Gaussians; where 20 are enough 6 are found, and 2 are kept"
)
_HIGH_LEVEL = (
    Documented(
        place="N 6.1.3", what="time between two searches for high level landmarks", value=60.0,
        unit="s", at="high_level.every_s",
        reason="a loop of occupancy-loop takes 77 s: in drives of two loops 2.4 landmarks are kept "
        "by a search every minute and 9.7 by one every 20 s, and the vehicle's heading error falls "
        "from 0.905 to 0.904 and 0.886 degrees (means of seeds 0 to 9)",
    ),
    Documented(
        place="N 6.1.3", what="greatest distance of two corners of a high level landmark",
        value=12.0, unit="m", at="high_level.pair_m", when=OTHERS, defaults=(f"{_SEARCH}.pair_m",),
    ),
    Documented(
        place="N 6.1.3", what="least Gaussians of a high level landmark", value=200,
        at="high_level.least", defaults=(f"{_SEARCH}.least",),
    ),
    Documented(
        place="N 6.1.3, with 5.2.1",
        what="only what should be in view of a high level landmark's template is aligned",
        value=False, at="high_level.only_in_view", defaults=(f"{_LIFE}.only_in_view",),
        reason="a template has several sides of an object, a scan sees one: aligned as a whole 8.1 "
        "landmarks are kept and 112 of 1,562 measurements fail the gate, by what is in view 9.5 "
        "and 52 of 1,687 (means and sums of seeds 0 to 9 of occupancy-loop, two loops)",
    ),
    Documented(
        place="N 6.1.3, with 5.4",
        what="variance of a high level landmark's measurement over that of its alignment",
        value=1.0, at="high_level.variance_factor", defaults=(f"{_LIFE}.variance_factor",),
        reason="measurements of a visit share the template's errors: means of its halves differ "
        "with 4.1 NEES per degree of freedom, single ones with 1.4 (the same drives)",
    ),
    Documented(
        place="N 6.1.3, with 4.1.3 and 4.3.2",
        what="cells of the map that is searched, and d_min of its Gaussians", value=0.2, unit="m",
        at="high_level.cell_m", when=OTHERS, defaults=(f"{_SEARCH}.cell_m",),
    ),
    Documented(
        place="N 6.5, car park", what="greatest distance of two corners of a high level landmark",
        value=7.0, unit="m", at="high_level.pair_m", when=CAR_PARK,
        reason=_SPARSE,
    ),
    Documented(
        place="N 6.5, car park",
        what="cells of the map that is searched, and d_min of its Gaussians", value=0.5, unit="m",
        at="high_level.cell_m", when=CAR_PARK, reason=_SPARSE,
    ),
)  # fmt: skip
ROWS = (*_TEMPLATES, *_OBSERVATION, *_HIGH_LEVEL)
