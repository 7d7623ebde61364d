"""Measurements made from raw scans."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.tree_features import with_tree_features
from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.logs.scans import Mount, Scans
from graphslam.scan import planar
from tests.ekf_reference.features.test_tree_detection import ANGLES, scan_of
from tests.helpers import assert_followed, compared, present, simulated


def with_scans(log: Log, mount: Mount = Mount()) -> Log:  # noqa: B008 - frozen
    """Scans of trunks, 0.4 m thick, where the landmarks stand."""
    truth = log.truth
    assert truth.poses is not None
    rng = np.random.default_rng(0)
    places = present(truth.landmarks).position_m
    trunks = np.column_stack((places, np.full(len(places), 0.4)))
    rows = np.arange(8, len(truth.poses.time_s), 8)
    place = np.array(list(vars(mount).values()))
    scanner = [planar.compose(truth.poses.pose[k], place) for k in rows]
    ranges = np.array([scan_of(trunks, pose, 0.02, rng) for pose in scanner])
    scans = Scans(
        time_s=truth.poses.time_s[rows],
        angle_rad=ANGLES,
        range_m=ranges,
        intensity=np.zeros_like(ranges),
        mount=mount,
    )
    return replace(log, scans=scans)


@pytest.mark.slow
def test_trunks_become_landmarks_with_their_diameters() -> None:
    log = with_tree_features(with_scans(simulated(seed=1)))
    near = log.measurements.range_m < 15.0
    assert abs(np.median(log.measurements.diameter_m[near]) - 0.4) < 0.03
    c = compared(log, association="nn")
    assert_followed(c, 1e-8)
    assert len(c.ekf.estimate.landmark) == 60  # every trunk once, and nothing else
    assert c.accuracy.smoother is not None
    assert c.accuracy.smoother.landmarks_found == 60
    assert present(c.accuracy.smoother.landmark_rmse_aligned_m) < 0.05


@pytest.mark.slow
def test_trunks_are_told_from_the_vehicle_wherever_its_scanner_sits() -> None:
    log = with_tree_features(with_scans(simulated(seed=1), Mount(1.5, -0.4, 0.3)))
    c = compared(log, association="nn")
    assert present(present(c.accuracy.smoother).ate_aligned_m) < 0.05


@pytest.mark.slow
def test_car_park_by_tree_features(shared_data: Path) -> None:
    """Raw scans alone carry the vehicle through; the trajectory is judged by RTK GPS."""
    log = with_tree_features(open_log(str(shared_data / "acfr_car_park")))
    c = compared(log)
    assert_followed(c, 1e-6)
    assert c.smoother.optimality.verified
    assert present(present(c.accuracy.smoother).gps_median_aligned_m) < 0.15


def test_features_that_cannot_be_had() -> None:
    log = simulated(loop_s=5.0)
    with pytest.raises(InputError, match="holds no scans to find trees in"):
        with_tree_features(log)
    blank = Scans(
        time_s=np.array([1.0, 2.0]),
        angle_rad=ANGLES,
        range_m=np.full((2, 361), np.nan),
        intensity=np.zeros((2, 361)),
    )
    with pytest.raises(InputError, match="no trunks in its scans"):
        with_tree_features(replace(log, scans=blank))
