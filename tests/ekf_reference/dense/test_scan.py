import math

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.scan import Beams, Scan, ScanSensor
from tests.ekf_reference.numerics import central_difference

SENSOR = ScanSensor(0.1, 0.01, 0.05)
POSE = np.array([3.0, -2.0, 2.5])


def wrapped(angle: Array) -> Array:
    turned: Array = np.mod(angle + np.pi, 2.0 * np.pi) - np.pi
    return turned


def full_circle(rng: np.random.Generator, gap: tuple[float, float] | None = None) -> Scan:
    bearing = np.arange(-math.pi, math.pi, 0.05)
    range_m = rng.uniform(3.0, 20.0, len(bearing))
    if gap:
        range_m[(bearing > gap[0]) & (bearing < gap[1])] = np.nan
    return Scan.of_ranges(POSE, bearing, range_m, SENSOR)


def brute_force(scan: Scan, point: Array) -> Beams:
    apart = point - scan.origin
    distance = np.linalg.norm(apart, axis=1)
    bearing = np.arctan2(apart[:, 1], apart[:, 0]) - scan.pose[2]
    off = np.abs(wrapped(bearing[:, None] - scan.bearing_rad))
    least = off.min(axis=1)
    ahead = scan.range_m[off.argmin(axis=1)] - distance
    return Beams(ahead, least, least <= scan.sensor.reach_rad)


@pytest.mark.parametrize("gap", [None, (-0.5, 1.0), (2.0, 4.0)])
def test_beams_equal_brute_force(gap: tuple[float, float] | None) -> None:
    rng = np.random.default_rng(0)
    scan = full_circle(rng, gap)
    point = POSE[:2] + rng.uniform(-15, 15, (20_000, 2))
    found, expected = scan.beams(point), brute_force(scan, point)
    same = np.isclose(found.ahead_m, expected.ahead_m)  # the same beam
    assert same.mean() > 0.98
    assert (found.off_rad - expected.off_rad)[~same].max() < 1e-3  # halfway between two
    for a, b in zip(vars(found).values(), vars(expected).values(), strict=True):
        assert np.allclose(a[same], b[same])
    if gap is None:
        assert found.seen.all()
        flipped = Scan(
            pose=scan.pose, bearing_rad=scan.bearing_rad, range_m=scan.range_m[::-1], sensor=SENSOR
        ).beams(point)
        assert not np.allclose(flipped.ahead_m, expected.ahead_m, atol=1.0)


def test_the_fast_answer_is_the_exact_one_but_at_rims() -> None:
    rng = np.random.default_rng(1)
    scan = full_circle(rng, (0.3, 1.2))
    own = rng.uniform(-15, 15, (20_000, 2))
    fast = scan.short_of(*own.astype(np.float32).T)
    exact = scan.beams_ahead(*own.T)
    expected = np.where(exact.seen, exact.ahead_m, -np.inf)
    with np.errstate(invalid="ignore"):
        same = np.isclose(fast, expected, atol=1e-4)
    assert same.mean() > 0.995


def test_gaps_say_nothing() -> None:
    scan = full_circle(np.random.default_rng(2), (-0.5, 1.0))
    for bearing, seen in ((0.2, False), (-0.4, False), (1.2, True), (-3.1, True)):
        direction = scan.pose[2] + bearing
        point = scan.origin + 2.0 * np.array([(math.cos(direction), math.sin(direction))])
        assert scan.beams(point).seen[0] == seen
    none = Scan.of_ranges(POSE, np.zeros(3), np.full(3, np.nan), SENSOR)
    assert not none.beams(np.zeros((4, 2))).seen.any()


def test_beams_in_any_order_and_any_turn_are_the_same_scan() -> None:
    rng = np.random.default_rng(3)
    scan = full_circle(rng)
    mixed = rng.permutation(len(scan.range_m))
    turns = 2.0 * np.pi * rng.integers(-2, 3, len(mixed))
    other = Scan.of_ranges(POSE, scan.bearing_rad[mixed] + turns, scan.range_m[mixed], SENSOR)
    assert np.allclose(other.bearing_rad, scan.bearing_rad)
    assert np.array_equal(other.range_m, scan.range_m)
    assert (np.diff(other.bearing_rad) >= 0).all()


def test_points_across_the_back_meet_the_nearest_beam() -> None:
    """At plus and minus pi a beam's neighbour is at the other end of the array."""
    bearing = np.array([-3.1, 0.0, 3.12])
    scan = Scan.of_ranges(
        np.zeros(3), bearing, np.array([5.0, 6.0, 7.0]), ScanSensor(0.1, 0.1, 0.1)
    )
    direction = np.array([3.14159, -3.14159, -3.12, 3.11, 0.01])
    point = 4.0 * np.column_stack((np.cos(direction), np.sin(direction)))
    assert np.allclose(4.0 + scan.beams(point).ahead_m, [7.0, 7.0, 5.0, 7.0, 6.0])
    assert scan.beams(point).seen.all()
    assert Scan.of_ranges(np.zeros(3), np.array([np.pi]), np.ones(1), SENSOR).bearing_rad[0] < np.pi


def test_points_and_covariance_by_central_differences() -> None:
    scan = full_circle(np.random.default_rng(4))
    noise = np.diag((SENSOR.sigma_range_m**2, SENSOR.sigma_bearing_rad**2))
    for i in range(0, len(scan.range_m), 17):

        def place(z: Array) -> Array:
            direction = scan.pose[2] + z[1]
            end: Array = scan.origin + z[0] * np.array((math.cos(direction), math.sin(direction)))
            return end

        z = np.array((scan.range_m[i], scan.bearing_rad[i]))
        jacobian = central_difference(place, z)
        assert np.allclose(scan.point[i], place(z))
        assert np.allclose(scan.covariance[i], jacobian @ noise @ jacobian.T, rtol=1e-6, atol=1e-12)
        broken = jacobian @ np.sqrt(noise) @ jacobian.T  # sigmas for their squares, N 4.2
        assert not np.allclose(scan.covariance[i], broken, rtol=0.1)


def test_box() -> None:
    scan = full_circle(np.random.default_rng(5))
    west, south, east, north = scan.box(0.5)
    inside = np.vstack((scan.point, scan.origin))
    assert np.allclose((west, south), inside.min(axis=0) - 0.5)
    assert np.allclose((east, north), inside.max(axis=0) + 0.5)
