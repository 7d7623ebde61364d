import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.features.tree_detection import (
    ROUNDNESS,
    TreeTracker,
    TrunkModel,
    cluster,
    diameter_variance,
    observed_diameter,
)
from tests.ekf_reference.numerics import central_difference
from tests.ekf_reference.ray_casting import Solids, cast

ANGLES = np.deg2rad(np.linspace(-90.0, 90.0, 361))
STILL = np.zeros(3)


def scan_of(trunks: Array, pose: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Ranges (361,) to trunks (T, 3) x, y, diameter; the nearest hit counts, NaN for none."""
    ranges = cast(ANGLES, pose, Solids(disc=trunks))
    ranges = ranges + sigma * rng.standard_normal(len(ranges))
    return np.where(np.isfinite(ranges), ranges, np.nan)


@pytest.mark.slow
@pytest.mark.parametrize("distance", [5.0, 10.0, 15.0, 20.0])
@pytest.mark.parametrize("diameter", [0.3, 0.6])
def test_bias_of_range_and_diameter(distance: float, diameter: float) -> None:
    """Over many placings between the beams: below 1 cm in range and 2 cm in diameter."""
    rng = np.random.default_rng(0)
    range_error, diameter_error = [], []
    for _ in range(150):
        bearing = rng.uniform(-1.2, 1.2)
        tracker = TreeTracker(model=TrunkModel(sigma_range_m=0.02))
        trunk = np.array([[distance * np.cos(bearing), distance * np.sin(bearing), diameter]])
        seen = None
        for _ in range(20):  # the sensor turns a little between the scans
            turn = rng.uniform(-0.01, 0.01)
            seen = tracker.detect(ANGLES, scan_of(trunk, np.array((0, 0, turn)), 0.02, rng), STILL)
        assert seen is not None
        assert len(seen.track) == 1
        range_error.append(seen.range_m[0] - distance)
        diameter_error.append(seen.diameter_m[0] - diameter)
    assert abs(np.mean(range_error)) < 0.01
    assert abs(np.mean(diameter_error)) < 0.02


def test_the_width_as_printed_is_biased() -> None:
    """Equation 11 as printed is one beam spacing short, 17 cm of diameter at 20 m; ours is not."""
    rng = np.random.default_rng(1)
    printed, corrected = [], []
    for _ in range(300):
        bearing = rng.uniform(-1.2, 1.2)
        trunk = np.array([[20 * np.cos(bearing), 20 * np.sin(bearing), 0.6]])
        found = cluster(ANGLES, scan_of(trunk, STILL, 0.0, rng), 0.3)
        width = (found.last - found.first) * np.deg2rad(0.5)
        printed.append(observed_diameter(found.range_m, width)[0])
        corrected.append(observed_diameter(found.range_m, found.width_rad)[0])
    assert np.isclose(np.mean(printed) - 0.6, -20 * np.deg2rad(0.5), atol=0.02)
    assert np.isclose(np.mean(corrected), 0.6, atol=0.02)


def circle_seen(distance_m: float, diameter_m: float) -> tuple[float, float]:
    """Mean range and angular width of a circle whose centre is so far away, by rays to it."""
    radius = 0.5 * diameter_m
    edge = np.arcsin(radius / distance_m)
    angle = edge * np.linspace(-1.0, 1.0, 100_001)
    away = distance_m * np.sin(angle)  # of the ray from the centre
    hit = distance_m * np.cos(angle) - np.sqrt(np.maximum(radius**2 - away**2, 0.0))
    return float(hit.mean()), float(2.0 * edge)


@pytest.mark.parametrize(
    ("distance", "diameter", "lost"), [(3.0, 1.0, 0.13), (3.0, 0.3, 0.04), (20.0, 1.0, 0.02)]
)
def test_the_diameter_as_printed_is_too_small(
    distance: float, diameter: float, lost: float
) -> None:
    """Equation 10 multiplies the width by the mean range; the distance of the centre holds."""
    range_m, width_rad = circle_seen(distance, diameter)
    printed = range_m * width_rad
    assert np.isclose(1.0 - printed / diameter, lost, atol=0.005)
    found = observed_diameter(np.array([range_m]), np.array([width_rad]))[0]
    assert abs(found / diameter - 1.0) < 0.006


def test_roundness_is_the_mean_over_the_visible_half() -> None:
    angle = np.linspace(-1, 1, 20001)[1:-1]
    assert np.isclose(np.mean(np.sqrt(1 - angle**2)), 2 * ROUNDNESS, atol=1e-4)


def test_variance_is_the_propagated_one() -> None:
    """Equation 12 with numeric derivatives of z_D = width * range, plus eq. 15's shape noise."""
    model = TrunkModel(sigma_range_m=0.05, sigma_width_rad=0.004, sigma_shape_m=0.03)
    r, w = 12.0, 0.03
    g = central_difference(lambda x: np.array([x[0] * x[1]]), np.array((r, w)))
    expected = g @ np.diag((0.05**2, 0.004**2)) @ g.T + 0.03**2
    found = diameter_variance(np.array([r]), np.array([w]), model)
    assert np.allclose(found, expected.ravel(), rtol=1e-9)
    assert w**2 * 0.05**2 < 1e-2 * r**2 * 0.004**2  # eq. 13


def test_clusters_part_at_gaps_and_jumps() -> None:
    ranges = np.full(361, np.nan)
    ranges[10:14], ranges[14:16], ranges[20] = (5.0, 5.1, 5.2, 5.1), 8.0, 5.0
    found = cluster(ANGLES, ranges, 0.3)
    assert found.first.tolist() == [10, 14, 20]
    assert found.last.tolist() == [13, 15, 20]
    assert np.allclose(found.width_rad, np.deg2rad((2.0, 1.0, 0.5)))
    assert np.allclose(found.range_m, (5.1, 8.0, 5.0))
    assert not len(cluster(ANGLES, np.full(361, np.nan), 0.3).first)


def test_the_filter_averages_and_its_variance_falls() -> None:
    """A constant seen n times: mean of the observations, variance over n."""
    rng = np.random.default_rng(2)
    tracker = TreeTracker()
    trunk = np.array([[10.0, 2.0, 0.5]])
    observed, variance = [], []
    for n in range(1, 30):
        scan = scan_of(trunk, np.array((0.0, 0.0, rng.uniform(-0.01, 0.01))), 0.02, rng)
        found = cluster(ANGLES, scan, 0.3)
        observed.append(observed_diameter(found.range_m, found.width_rad)[0])
        variance.append(diameter_variance(found.range_m, found.width_rad, tracker.model)[0])
        seen = tracker.detect(ANGLES, scan, STILL)
        weights = 1.0 / np.array(variance)
        assert np.isclose(seen.diameter_m[0], np.average(observed, weights=weights))
        assert np.isclose(seen.diameter_variance[0], 1.0 / weights.sum())
        assert seen.scans.tolist() == [n]


def test_tracks_follow_the_vehicle_and_end() -> None:
    rng = np.random.default_rng(3)
    trunks = np.array([[12.0, 3.0, 0.4], [12.0, -3.0, 0.4]])
    tracker, pose, motion = TreeTracker(), np.zeros(3), np.array((0.6, 0.05, 0.08))
    numbers = set()
    for _ in range(8):
        seen = tracker.detect(ANGLES, scan_of(trunks, pose, 0.01, rng), motion)
        numbers |= set(seen.track.tolist())
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        step = np.array((cos * 0.6 - sin * 0.05, sin * 0.6 + cos * 0.05, 0.08))
        pose = pose + step
    assert numbers == {0, 1}
    for _ in range(7):
        assert not len(tracker.detect(ANGLES, np.full(361, np.nan), STILL).track)
    again = tracker.detect(ANGLES, scan_of(trunks, pose, 0.01, rng), STILL)
    assert again.track.min() == 2


def test_a_long_way_between_scans_is_made_up_for() -> None:
    """Two metres forward and a turn, with trunks nearer together than that: tracks still hold."""
    rng = np.random.default_rng(4)
    trunks = np.array([[12.0, 1.5, 0.4], [12.0, -1.5, 0.4], [15.0, 0.0, 0.4]])
    motion = np.array((2.0, 0.3, -0.2))
    tracker = TreeTracker()
    before = tracker.detect(ANGLES, scan_of(trunks, STILL, 0.01, rng), STILL)
    after = tracker.detect(ANGLES, scan_of(trunks, motion, 0.01, rng), motion)
    assert sorted(after.track.tolist()) == sorted(before.track.tolist()) == [0, 1, 2]
    assert after.scans.tolist() == [2, 2, 2]


def test_walls_and_far_things_are_no_trunks() -> None:
    ranges = np.full(361, np.nan)
    ranges[100:200] = 6.0  # five metres wide
    ranges[300:310] = 60.0
    assert not len(TreeTracker().detect(ANGLES, ranges, STILL).track)
