"""Where beams ended, and which clouds are none."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from graphslam.scan import planar
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.points import (
    LEAST_POINTS,
    above_ground,
    compensated,
    placed,
    planar_points,
    swept_points,
    usable,
)
from graphslam.scan.registration import ScanError
from tests.graphslam.numerics import Array, relative_error
from tests.graphslam.scan.shapes import cast

pytestmark = pytest.mark.filterwarnings("error")

MOUNT = np.array((2.1, -0.4, 0.3))
WALL = np.array(((12.0, -50.0, 9.0, 50.0),))


def test_beams_end_where_the_formula_says() -> None:
    rng = np.random.default_rng(0)
    angle, way = rng.uniform(-2.0, 2.0, 40), rng.uniform(1.0, 30.0, 40)
    way[[3, 7]] = np.nan, np.inf
    points = planar_points(angle, way, MOUNT)
    expected = []
    for a, r in zip(angle.tolist(), way.tolist(), strict=True):
        if math.isfinite(r):
            on_scanner = np.array((r * math.cos(a), r * math.sin(a), 0.0))
            expected.append(planar.moved(MOUNT, on_scanner[None])[0])
    assert relative_error(points, np.array(expected)) < 1e-14
    assert not points[:, 2].any()
    turned_first = planar.compose(np.array((0.0, 0.0, MOUNT[2])), MOUNT * (1.0, 1.0, 0.0))
    assert relative_error(planar_points(angle, way, turned_first), np.array(expected)) > 1e-3


def test_every_beam_has_its_own_scanner_pose() -> None:
    rng = np.random.default_rng(1)
    angle, way = rng.uniform(-2.0, 2.0, 40), rng.uniform(1.0, 30.0, 40)
    scanner = rng.uniform(-3.0, 3.0, (40, 3))
    alone = [swept_points(angle[[k]], way[[k]], scanner[[k]])[0] for k in range(40)]
    assert np.array_equal(swept_points(angle, way, scanner), np.array(alone))
    one = planar_points(angle, way, scanner[0])
    assert relative_error(swept_points(angle, way, np.tile(scanner[0], (40, 1))), one) < 1e-15


def sweep(motion: Array, duration_s: float) -> tuple[Array, Array]:
    """Points (181, 3) of one wall in the vehicle's own frame at each beam, and their times."""
    angle = np.deg2rad(np.linspace(-45.0, 45.0, 181))
    seconds = np.linspace(0.0, duration_s, 181)
    vehicle = seconds[:, None] / duration_s * motion
    scanner = np.array([planar.compose(pose, MOUNT) for pose in vehicle])
    ranges = cast(WALL, angle, scanner)
    assert np.isfinite(ranges).all()
    return planar_points(angle, ranges, MOUNT), seconds


def off_the_wall(points: Array) -> float:
    normal = np.array((100.0, 3.0)) / math.hypot(100.0, 3.0)
    return float(np.abs((points[:, :2] - (12.0, -50.0)) @ normal).max())


@pytest.mark.parametrize("motion", [(0.6, 0.0, 0.0), (0.4, 0.1, 0.25), (-0.2, 0.0, -0.4)])
def test_a_moving_scanner_still_sees_a_straight_wall(motion: tuple[float, ...]) -> None:
    points, seconds = sweep(np.array(motion), 0.1)
    assert off_the_wall(points) > 0.1
    assert off_the_wall(compensated(points, seconds, np.array(motion), 0.1)) < 1e-12
    backwards = compensated(points, seconds, -np.array(motion), 0.1)
    assert off_the_wall(backwards) > off_the_wall(points)


def test_compensation_needs_no_time_in_order_and_keeps_heights() -> None:
    motion = np.array((0.4, 0.1, 0.25))
    points, seconds = sweep(motion, 0.1)
    points[:, 2] = np.linspace(-1.0, 2.0, len(points))
    whole = compensated(points, seconds, motion, 0.1)
    assert np.array_equal(whole[:, 2], points[:, 2])
    order = np.random.default_rng(0).permutation(len(points))
    assert np.array_equal(compensated(points[order], seconds[order], motion, 0.1), whole[order])
    assert np.array_equal(compensated(points, 0.0 * seconds, motion, 0.1), points)
    # Half of the scan's time at twice its length is the same motion.
    assert relative_error(compensated(points, seconds, 2.0 * motion, 0.2), whole) < 1e-14


def test_what_stands_is_kept_and_the_ground_is_not() -> None:
    rng = np.random.default_rng(0)
    ground = np.column_stack((rng.uniform(-9, 9, (300, 2)), rng.normal(-1.8, 0.02, 300)))
    walls = np.column_stack((rng.uniform(-9, 9, (200, 2)), rng.uniform(-1.2, 2.0, 200)))
    stray = np.array(((1.0, 1.0, -5.0),))
    kept = above_ground(np.vstack((ground, stray, walls)), 0.3)
    assert np.array_equal(kept, walls)
    holes = np.vstack((walls, np.full((2, 3), np.nan), ground))
    assert np.array_equal(above_ground(holes, 0.3), walls)


def test_planar_scans_have_no_ground() -> None:
    flat = np.column_stack((np.random.default_rng(0).normal(size=(50, 2)), np.zeros(50)))
    assert np.array_equal(above_ground(flat, 0.3), flat)
    assert above_ground(np.zeros((0, 3)), 0.3).shape == (0, 3)
    flat[::5] = np.nan
    assert np.array_equal(above_ground(flat, 0.3), flat, equal_nan=True)
    assert len(KissIcpOptions(least_range_m=0.0).prepared(flat)) == 40


def cloud(count: int = 100) -> Array:
    rng = np.random.default_rng(0)
    return np.column_stack((rng.uniform(2.0, 9.0, (count, 2)), np.linspace(-1.0, 2.0, count)))


def with_value(value: float) -> Array:
    points = cloud()
    points[:90] = value
    return points


def masked() -> Array:
    return np.ma.MaskedArray(cloud(), mask=np.arange(300).reshape(100, 3) % 7 == 0)


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "empty": (lambda: np.zeros((0, 3)), "0 of 0 points"),
    "an empty list": (list, "shape"),
    "none": (lambda: None, "shape"),
    "no numbers": (lambda: np.full((100, 3), np.nan), "0 of 100 points"),
    "few numbers": (lambda: with_value(np.nan), "10 of 100 points"),
    "one point": (lambda: cloud(1), "1 of 1 points"),
    "one too few": (lambda: cloud(LEAST_POINTS - 1), "19 of 19 points"),
    "one place": (lambda: np.tile((3.0, 2.0, 0.0), (100, 1)), "all points lie in one place"),
    "one place, upright": (
        lambda: np.column_stack((np.full((100, 2), 3.0), np.linspace(-1.0, 2.0, 100))),
        "all points lie in one place",
    ),
    "flat": (lambda: cloud().ravel(), "shape"),
    "two columns": (lambda: cloud()[:, :2], "shape"),
    "three dimensions": (lambda: cloud()[None], "shape"),
    "infinite": (lambda: with_value(np.inf), "10 of 100 points"),
    "infinitely low": (lambda: with_value(-np.inf), "10 of 100 points"),
    "absurd": (lambda: with_value(1e300), "10 of 100 points"),
    "absurdly wide": (
        lambda: np.where(np.arange(100)[:, None] % 2, 1.7e308, -1.7e308) * np.ones(3),
        "0 of 100 points",
    ),
    "too wide for doubles": (lambda: np.full((100, 3), np.longdouble("1e4000")), "0 of 100 points"),
    "far": (lambda: cloud() + (1e4, 0.0, 0.0), "0 of 100 points"),
    "near": (lambda: 1e-3 * cloud(), "0 of 100 points"),
    "planar and far": (lambda: (cloud() + 1e4) * (1.0, 1.0, 0.0), "0 of 100 points"),
    "objects": (lambda: cloud().astype(object), "object"),
    "text": (lambda: cloud().astype(str), "expected"),
    "bytes": (lambda: cloud().astype("S"), "expected"),
    "yes and no": (lambda: cloud() > 5.0, "bool"),
    "complex": (lambda: cloud() + 1j, "complex"),
    "times": (lambda: np.zeros((100, 3), dtype="datetime64[s]"), "expected"),
    "ragged": (lambda: [[1.0, 2.0, 3.0], [1.0]] * 30, "expected"),
    "masked": (masked, "masked"),
}


@pytest.mark.parametrize("bad", BAD)
def test_what_is_no_cloud_is_refused_in_a_line(bad: str) -> None:
    """On its own and as odometry prepares it. Warnings are errors in these tests."""
    make, complaint = BAD[bad]
    points: Any = make()
    with pytest.raises(ScanError, match=complaint) as caught:
        usable(points, 1.0, 75.0)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 150
    with pytest.raises(ScanError):
        KissIcpOptions().prepared(points)


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int32, np.uint8, ">f8"])
def test_other_numbers_are_taken(dtype: str) -> None:
    points = np.round(np.abs(cloud())).astype(dtype)
    points.setflags(write=False)
    kept = usable(points, 1.0, 75.0)
    assert kept.dtype == np.float64
    assert kept.flags.c_contiguous
    assert np.array_equal(kept, np.round(np.abs(cloud())))


def test_only_points_within_range_are_kept() -> None:
    points = np.vstack((cloud(), with_value(np.nan)[:5], ((80.0, 0.0, 0.0), (0.5, 0.0, 0.0))))
    before = points.copy()
    assert np.array_equal(usable(points, 1.0, 75.0), cloud())
    assert np.array_equal(points, before, equal_nan=True)


def test_clouds_are_placed_by_their_poses() -> None:
    poses = np.array(((1.0, 2.0, 0.3), (-4.0, 0.5, 2.0)))
    together = placed([cloud(20), cloud(30)], poses)
    assert np.array_equal(together[:20], planar.moved(poses[0], cloud(20)))
    assert np.array_equal(together[20:], planar.moved(poses[1], cloud(30)))
    assert placed([], np.zeros((0, 3))).shape == (0, 3)
