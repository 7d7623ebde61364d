"""What bags hold besides scans: points of landmarks, fixes, covariances; and choosing topics."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from comparisons.errors import InputError
from comparisons.logs.log import Positions
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.readers import read_log
from tests.comparisons.logs.test_scan_readers import assert_survives_a_folder

pytest.importorskip("rosbags")

from rosbags.typesys import Stores

from comparisons.logs.odometry_noise import odometry_noise
from comparisons.logs.readers.gps_start import Reckoned, east_north, lay_fixes, lay_reckoned
from comparisons.logs.readers.ros_points import fix
from tests.comparisons.logs.bags import EPOCH, Message, T, Types
from tests.helpers import present, relative_error


def moves(count: int = 5, types: Types = T, **changes: Any) -> list[Message]:
    """1 m a second along x."""
    return [types.odometry(EPOCH + t, float(t), **changes) for t in range(count)]


def test_a_topic_is_chosen_by_name(tmp_path: Path) -> None:
    few = [("/a", *T.laser(t, range_max=9.0)[1:]) for t in (1.0, 2.0)]
    many = [("/b", *T.laser(t)[1:]) for t in (1.0, 2.0, 3.0)]
    path = T.write(tmp_path / "bag", [*few, *many, T.static(("a", "b", 0, 0, 0, 0))])
    assert read_log(path, topics=("/b",)).provenance["LaserScan"].startswith("/b, 3 messages")
    assert read_log(path, topics=("/a",)).provenance["LaserScan"].startswith("/a, 2 messages")
    reported = (
        "bag: no topic /scan, expected some of /a (sensor_msgs/msg/LaserScan), "
        "/b (sensor_msgs/msg/LaserScan), /tf_static (tf2_msgs/msg/TFMessage)"
    )
    for topics, message in (
        (("/scan",), reported),
        (("/a", "/b"), "topic /b is of the same type, expected one of each"),
        (("/tf_static",), "topic /tf_static is of type tf2_msgs/msg/TFMessage, expected one of"),
    ):
        with pytest.raises(InputError) as caught:
            read_log(path, topics=topics)
        assert message in str(caught.value)


def test_markers_are_read_when_asked_for(tmp_path: Path) -> None:
    drawn = [T.markers(EPOCH + t, (3, 2.0, 0.0), (7, 0.0, 4.0)) for t in (0.5, 2.0)]
    path = T.write(tmp_path / "bag", [*moves(), *drawn, T.markers(EPOCH + 3.0)])
    with pytest.raises(InputError, match="MarkerArray is read when asked for by --topic"):
        read_log(path)
    log = read_log(path, topics=("/markers",))
    assert log.measurements.time_s.tolist() == [0.5, 0.5, 2.0, 2.0]
    assert log.measurements.landmark.tolist() == [3, 7, 3, 7]
    assert np.allclose(log.measurements.range_m, (2, 4, 2, 4))
    assert np.allclose(log.measurements.bearing_rad, (0, np.pi / 2, 0, np.pi / 2))
    assert log.odometry.time_s.tolist() == [0.5, 1.0, 2.0, 3.0, 4.0]  # no corner is cut
    assert log.provenance["measurements_noise"] == "stated for 4 of 4: 0.1 m and 0.01745 rad"
    assert "1 that are empty" in log.provenance["MarkerArray"]
    assert_survives_a_folder(log, tmp_path / "again")


def test_markers_in_a_sensors_frame(tmp_path: Path) -> None:
    """A camera 1 m ahead that looks left: what is 2 m before it is 1 m ahead and 2 m left."""
    mounted = T.static(("base", "camera", 1.0, 0.0, np.pi / 2, 0.0))
    seen = T.markers(EPOCH + 1.0, (-4, 2.0, 0.0), ns="tag", frame="camera")
    log = read_log(T.write(tmp_path / "bag", [mounted, *moves(), seen]), topics=("/markers",))
    assert np.allclose(log.measurements.range_m, np.sqrt(5))
    assert np.allclose(log.measurements.bearing_rad, np.arctan2(2, 1))
    assert json.loads(log.provenance["labels"]) == {"tag/-4": 0}


def test_points_in_the_map_are_no_measurements(tmp_path: Path) -> None:
    seen = T.markers(EPOCH + 1.0, (4, 2.0, 0.0), frame="map")
    path = T.write(tmp_path / "bag", [*moves(), seen, T.laser(EPOCH + 1.0)])
    assert not len(read_log(path).measurements.time_s)
    with pytest.raises(InputError, match="frame is map, expected the vehicle's base or one that"):
        read_log(path, topics=("/markers",))


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_detections(kind: str, tmp_path: Path) -> None:
    """By the bag's own definitions; a class that is seen twice at once names no landmark."""
    types = Types(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE).with_detections()
    covariance = np.diag((0.04, 0.01, 0, 0, 0, 0))
    tags = [
        types.detections(EPOCH + 1.0, ("5", "", 3.0, 0.0), ("6", "", 0.0, 2.0),
                         covariance=covariance),
    ]  # fmt: skip
    path = types.write(tmp_path / f"tags.{kind}", [*moves(types=types), *tags])
    seen = read_log(path).measurements
    assert seen.landmark.tolist() == [5, 6]
    assert np.allclose(seen.range_m, (3, 2))
    assert np.allclose(seen.sigma_range_m, (0.2, 0.1))
    assert np.allclose(seen.sigma_bearing_rad, (0.1 / 3, 0.2 / 2))
    trees = types.detections(EPOCH + 2.0, ("5", "", 3.0, 0.0), ("5", "", 0.0, 2.0))
    path = types.write(tmp_path / f"trees.{kind}", [*moves(types=types), *tags, trees])
    assert read_log(path).measurements.landmark.tolist() == [-1, -1, -1, -1]
    if kind == "mcap":
        named = types.detections(EPOCH + 2.0, ("5", "t1", 3.0, 0.0), ("5", "t2", 0.0, 2.0))
        path = types.write(tmp_path / "tracked", [*moves(types=types), named])
        assert json.loads(read_log(path).provenance["labels"]) == {"t1": 0, "t2": 1}


def test_a_point_at_the_pose_and_a_fix_without_error_are_placeholders(tmp_path: Path) -> None:
    bag = T.write(tmp_path / "bag", [*moves(), T.markers(EPOCH + 1, (1, 0.0, 0.0))])
    with pytest.raises(InputError, match="/markers: a point lies at the vehicle's pose"):
        read_log(bag, topics=("/markers",))
    sharp = T.fix(EPOCH, 48.0, 11.0, variances=(1e-12, 1e-12, 1.0))[3]
    found = present(fix(sharp, ""))
    assert np.isnan(found[3:]).all()


def test_east_and_north_by_radii_of_curvature() -> None:
    """The plane's own formula, to second order in the distance; a sphere is 0.3 % off."""
    phi, lam = np.deg2rad(-33.88), np.deg2rad(151.19)
    away = np.array(((0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3), (-2e-3, 3e-3)))
    found = east_north(-33.88 + away[:, 0], 151.19 + away[:, 1], np.zeros(4))
    a, square = 6378137.0, 0.00669437999014
    bent = 1 - square * np.sin(phi) ** 2
    meridian, normal = a * (1 - square) / bent**1.5, a / np.sqrt(bent)
    d_phi, d_lam = np.deg2rad(away).T
    east = normal * np.cos(phi) * d_lam - normal * np.sin(phi) * d_phi * d_lam
    north = meridian * d_phi + normal * np.sin(phi) * np.cos(phi) * d_lam**2 / 2
    expected = np.column_stack((east, north))
    assert np.allclose(found, expected, atol=2e-3)
    assert not np.allclose(found, expected * 1.003, atol=2e-3)
    assert lam > 0


def drive_with_fixes(**changes: Any) -> list[Message]:
    """A quarter of a circle of 50 m, driven northwards in the world; the antenna 2 m ahead."""
    messages: list[Message] = [T.static(("base", "gps", 2.0, 0.0, 0.0, 0.0))]
    for k in range(41):
        turn = 0.04 * k
        x, y = 50 * np.sin(turn), 50 * (1 - np.cos(turn))
        messages.append(T.odometry(EPOCH + k, x, turn, y=y, twist_variances=np.full(3, 1e-6)))
        ahead, left = x + 2 * np.cos(turn), y + 2 * np.sin(turn)
        east, north = -left, ahead  # 90 degrees between the frames
        fix = T.fix(EPOCH + k + 0.0, 48 + north / 111200.6, 11 + east / 74692.7, **changes)
        messages.append(fix)
    return messages


def test_fixes_are_laid_onto_the_odometry(tmp_path: Path) -> None:
    lost = T.fix(EPOCH + 40.5, 0.0, 0.0, status=-1)
    last = T.odometry(EPOCH + 41, 51.0, 1.64, y=53.0)
    scans = [T.laser(EPOCH + k) for k in range(3)]
    log = read_log(T.write(tmp_path / "bag", [*drive_with_fixes(), lost, last, *scans]))
    positions = present(log.positions)
    assert log.provenance["positions"].startswith("WGS 84 about the first fix; 8 fixes up to 7 s")
    assert positions.time_s.tolist() == list(range(8, 41))  # the first eight are in the prior
    assert positions.antenna_m == (2.0, 0.0)
    turn = 0.04 * np.arange(8, 41)
    expected = 50 * np.column_stack((np.sin(turn), 1 - np.cos(turn)))
    expected += 2 * np.column_stack((np.cos(turn), np.sin(turn)))
    assert np.allclose(positions.position_m, expected, atol=0.05)  # metres per degree are rounded
    assert np.allclose(positions.covariance, 0.04 * np.eye(2))
    assert np.isin(positions.time_s, [0.0, *log.odometry.time_s]).all()
    sigma = np.sqrt(np.diagonal(log.prior.covariance))
    assert np.deg2rad(0.5) < sigma[2] <= np.deg2rad(1.01)
    assert (sigma[:2] > 0.05).all()
    assert (sigma[:2] < 0.2).all()
    assert_survives_a_folder(log, tmp_path / "again")


def test_fixes_without_covariance_or_motion(tmp_path: Path) -> None:
    scans = [T.laser(EPOCH + k) for k in range(3)]
    log = read_log(T.write(tmp_path / "bag", [*drive_with_fixes(kind=0), *scans]))
    assert log.positions is not None  # 3 m over the whole drive show it to 1.2 degrees, not to 1
    assert np.deg2rad(1.1) < np.sqrt(log.prior.covariance[2, 2]) < np.deg2rad(1.4)
    near = drive_with_fixes(kind=0)[:20]
    log = read_log(T.write(tmp_path / "near", [*near, *scans]))
    assert log.positions is None
    assert log.provenance["positions"].startswith("left out: 9 fixes along the odometry, expected")
    still = [T.odometry(EPOCH + t, 0.0) for t in range(4)]
    fixes = [T.fix(EPOCH + t, 48.0, 11.0) for t in range(4)]
    log = read_log(T.write(tmp_path / "still", [*still, *fixes, *scans]))
    assert log.positions is None
    assert log.provenance["positions"].startswith("left out: 4 fixes along the odometry, expected")


def test_the_start_that_fixes_show_is_as_certain_as_it_says() -> None:
    """20 drives with noise on the way: NEES in its band, far off it where the way is held exact."""
    count, steps, sigma = 20, 40, np.array((0.05, 0.05, 0.03))
    rng = np.random.default_rng(5)
    nees = np.zeros((count, 2))
    for drive, row in enumerate(nees):
        reported = np.tile((1.0, 0.0, 0.05), (steps, 1))
        true = _chained(reported + sigma * rng.normal(size=(steps, 3)))
        pose, place = _chained(reported), true[:, :2] @ np.array([1.0, 1j])
        heading = rng.uniform(-np.pi, np.pi)
        fixes = np.exp(1j * heading) * (place + np.exp(1j * true[:, 2])) + complex(30, drive)
        seen = np.column_stack((fixes.real, fixes.imag)) + 0.5 * rng.normal(size=(steps + 1, 2))
        time_s = np.arange(steps + 1.0)
        plane = Positions(time_s, seen, np.tile(0.25 * np.eye(2), (steps + 1, 1, 1)))
        antenna = pose[:, :2] @ np.array([1.0, 1j]) + np.exp(1j * pose[:, 2])
        for scale in (0, 1):
            covariance = scale * np.tile(np.diag(sigma**2), (steps, 1, 1))
            moved = Reckoned(time_s, pose, antenna, covariance)
            start, spread = lay_reckoned(moved, plane, 20.0)
            error = start - (30, drive, heading)
            error[2] = np.angle(np.exp(1j * error[2]))
            row[scale] = error @ np.linalg.solve(spread, error)
    low, high = chi2.ppf((0.001, 0.999), 3 * count) / count
    exact, honest = nees.mean(axis=0)
    assert low < honest < high
    assert exact > 3 * high


def test_the_direction_of_the_plane_says_nothing_of_the_start() -> None:
    """Laid onto one drive, fixes of a plane that is turned and moved give the same start."""
    steps, time_s = 60, np.arange(61.0)
    pose = _chained(np.tile((1.0, 0.0, 0.01), (steps, 1)))
    path = pose[:, :2] @ np.array([1.0, 1j])
    covariance = np.tile(np.diag((0.01, 0.04, 1e-4)) ** 2, (steps, 1, 1))
    moved = Reckoned(time_s, pose, path, covariance)
    laid = []
    for heading, corner in ((0.0, 0.0), (2.0, 30 - 7j)):
        turn = np.array(((np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading))))
        seen = path * np.exp(1j * heading) + corner
        spread = turn @ np.diag((0.5, 0.1)) ** 2 @ turn.T
        plane = Positions(
            time_s, np.column_stack((seen.real, seen.imag)), np.tile(spread, (steps + 1, 1, 1))
        )
        laid.append(present(lay_fixes(moved, plane)))
    one, other = laid
    assert one.spent == other.spent
    assert relative_error(other.covariance, one.covariance) < 1e-9
    assert relative_error(other.positions.covariance, one.positions.covariance) < 1e-9
    assert np.abs(other.positions.position_m - one.positions.position_m).max() < 1e-9


def _chained(moved: np.ndarray) -> np.ndarray:
    """(N + 1, 3) poses from the origin."""
    heading = np.concatenate(([0.0], np.cumsum(moved[:, 2])))
    step = (moved[:, 0] + 1j * moved[:, 1]) * np.exp(1j * heading[:-1])
    place = np.concatenate(([0.0], np.cumsum(step)))
    return np.column_stack((place.real, place.imag, heading))


def noise(path: Path, messages: list[Message]) -> tuple[RelativePoses, str]:
    scans = [T.laser(EPOCH + t) for t in (0.0, 1.0, 3.0)]
    log = read_log(T.write(path, [*messages, *scans]))
    assert isinstance(log.odometry, RelativePoses)
    return log.odometry, log.provenance["odometry_noise"]


def test_covariances_of_odometry(tmp_path: Path) -> None:
    """Twist: each sample's speed errs on its own. Pose: growth, the heading's lever taken out."""
    floor = 1e-6 * np.eye(3)
    found, words = noise(tmp_path / "twist", moves(twist_variances=(0.04, 0.0, 0.01)))
    assert words.startswith("Odometry's twist covariances")
    assert np.allclose(found.covariance[0], np.diag((0.04, 0.0, 0.01)) + floor)
    assert np.allclose(found.covariance[1], np.diag((0.08, 0.0, 0.02)) + floor)
    grown, added, reported = np.zeros((3, 3)), np.diag((0.02, 0.01, 0.005)), []
    for t in range(5):
        reported.append(T.odometry(EPOCH + t, float(t), pose_covariance=grown.copy()))
        carry = np.array(((1, 0, 0), (0, 1, 1.0), (0, 0, 1)))
        grown = carry @ grown @ carry.T + added
    found, words = noise(tmp_path / "pose", reported)
    assert words.startswith("the increments of Odometry's pose covariances")
    assert np.allclose(found.covariance[0], added + floor)
    assert np.allclose(found.covariance[1], 2 * added + floor)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"pose_covariance": (0.1, 0.1, 0.1)},
        {"twist_variances": (1e-3, 1e6, 1e-3)},
        {"twist_variances": (0.1, 0.1, 0.0)},
        {"twist_variances": (np.nan, 0.1, 0.1)},
    ],
    ids=["zeros", "constant", "unmeasured", "no turn", "nan"],
)
def test_covariances_that_are_none(changes: dict[str, Any], tmp_path: Path) -> None:
    found, words = noise(tmp_path / "bag", moves(**changes))
    assert words.startswith("stated: 0.1 m per root metre")
    assert np.allclose(found.covariance[0, 0, 0], 0.01 + 1e-6)


def test_growth_that_forgets_the_lever_is_refused() -> None:
    """Position variances that stay while the heading's error turns them are no reckoning's."""
    rows = np.zeros((4, 15))
    rows[:, 0] = np.arange(4.0)
    rows[:, 6:] = (np.arange(1, 5)[:, None, None] * np.diag((1e-4, 1e-4, 0.1))).reshape(4, 9)
    assert odometry_noise(np.arange(4.0), rows)[0] is None


@pytest.mark.parametrize("name", ["x = 1", "detections) or exec('')"])
def test_definitions_that_are_none_are_not_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bag is read without them; detections that were asked for are refused."""
    types = Types().with_detections()
    seen = types.detections(EPOCH + 1.0, ("5", "", 3.0, 0.0))
    scans = [types.laser(EPOCH + t) for t in (0.0, 1.0)]
    path = types.write(tmp_path / "bag", [*moves(), seen, *scans])
    assert len(read_log(path).measurements.time_s) == 1

    def brought(text: str, kind: str) -> dict[str, Any]:
        return {kind: ([], [(name, (1, ("string", 0)))])}

    monkeypatch.setattr("rosbags.typesys.get_types_from_msg", brought)
    log = read_log(path)
    assert not len(log.measurements.time_s)
    assert log.provenance["measurements"].startswith(
        "left out: /detections: the bag holds no usable"
    )
    with pytest.raises(InputError, match="no usable definition of vision_msgs/msg/Detection3DArr"):
        read_log(path, topics=("/detections",))
