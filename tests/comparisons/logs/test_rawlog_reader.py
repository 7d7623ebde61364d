"""MRPT rawlogs: their layouts, on files written here."""

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.odometry import RelativePoses, displacements
from comparisons.logs.readers import rawlog_stream, read_log
from graphslam.increments import dead_reckoned
from tests.comparisons.logs.rawlogs import (
    LANDMARKS,
    MOVES,
    START,
    action,
    beacons,
    drive,
    frame,
    odometry,
    pose_2d,
    pose_3d,
    rawlog,
    seen,
    sweep,
    thing,
)
from tests.comparisons.logs.test_readers import assert_refused
from tests.comparisons.logs.test_scan_readers import assert_survives_a_folder
from tests.helpers import present

RANGES = [2.0, 3.0, 90.0, 0.0, 5.0]


@pytest.mark.parametrize("packed", [True, False])
def test_measurements_and_motions(packed: bool, tmp_path: Path) -> None:
    """Frames without usable times count as seconds, and the log says so."""
    log = read_log(rawlog(tmp_path, packed=packed))
    assert (log.name, log.format) == ("drive", "rawlog")
    assert isinstance(log.odometry, RelativePoses)
    assert np.allclose(log.odometry.displacement, MOVES)
    assert log.odometry.time_s.tolist() == [1.0, 2.0, 3.0]
    assert log.provenance["times"].startswith("frame numbers in place of seconds")
    assert log.provenance["passed_over"] == "4 CObservationComment, 4 CObservationBeaconRanges"
    measurements = log.measurements
    assert measurements.landmark.tolist() == [*LANDMARKS] * 4
    assert np.allclose(measurements.sigma_range_m, 0.02)
    assert np.allclose(measurements.sigma_bearing_rad, 0.003)
    pose = dead_reckoned(np.zeros(3), log.odometry.displacement)[measurements.time_s.astype(int)]
    place = pose[:, 0] + 1j * pose[:, 1]
    place = place + measurements.range_m * np.exp(1j * (pose[:, 2] + measurements.bearing_rad))
    assert np.allclose(place, [*LANDMARKS.values()] * 4, atol=1e-6)


def test_times_of_frames(tmp_path: Path) -> None:
    log = read_log(rawlog(tmp_path, drive(ticks=2_500_000)))
    assert log.odometry.time_s.tolist() == [0.25, 0.5, 0.75]
    assert log.provenance["time_origin"].startswith("2019-10-19T13:57:43")
    assert "times" not in log.provenance


def test_unknown_landmarks(tmp_path: Path) -> None:
    log = read_log(rawlog(tmp_path, drive(labelled=False)))
    assert set(log.measurements.landmark.tolist()) == {-1}
    assert not log.measurements.labelled


def sampled(draw: np.ndarray, moved: tuple[float, float, float], model: int) -> np.ndarray:
    """(N, 3) displacements drawn as MRPT's documentation of its models of motion says."""
    x, y, turn = moved
    way = np.hypot(x, y)
    if model == 0:
        a1, a2, a3, a4, least_m, least_rad = 0.01, 0.06, 0.02, 0.05, 0.04, 0.002
        sigma_m = least_m + a1 * way + a2 * abs(turn)
        sigma_rad = least_rad + a3 * way + a4 * abs(turn)
        middle = complex(x, y) * np.exp(-0.5j * turn)
        drawn = turn + sigma_rad * draw[2]
        middle = middle + sigma_m * (draw[0] + 1j * draw[1])
        arm = middle * np.exp(0.5j * drawn)
        return np.column_stack((arm.real, arm.imag, drawn))
    a1, a2, a3, a4, least_m, least_rad = 0.05, 0.07, 0.01, 0.006, 0.001, 0.0009
    first = np.arctan2(y, x)
    second = turn - first
    one = first + (a1 * abs(first) + a2 * way) * draw[0]
    far = way + (a3 * way + a4 * (abs(first) + abs(second))) * draw[1]
    two = second + (a1 * abs(second) + a2 * way) * draw[2]
    return np.column_stack(
        (
            far * np.cos(one) + least_m * draw[3],
            far * np.sin(one) + least_m * draw[4],
            one + two + least_rad * draw[5],
        )
    )


@pytest.mark.parametrize("model", [0, 1])
@pytest.mark.parametrize("version", [6, 7])
def test_motion_models(model: int, version: int, tmp_path: Path) -> None:
    """Covariances are those of the model's own draws; the departing frame's would not do."""
    moved = (1.0, 0.3, 1.2)
    content = frame(seen([(1.0, 0.0, 0.0, 1)]))
    content += action(moved, model=model, version=version) + frame(seen([(1.0, 0.0, 0.0, 1)]))
    log = read_log(rawlog(tmp_path, content))
    assert isinstance(log.odometry, RelativePoses)
    draws = sampled(np.random.default_rng(0).normal(size=(6, 200_000)), moved, model)
    departing = np.cov((draws - moved).T)
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(1.2), np.sin(1.2)], [-np.sin(1.2), np.cos(1.2)]]
    scale = 0.03 * np.abs(departing).max()
    assert np.allclose(log.odometry.covariance[0], turn @ departing @ turn.T, atol=scale)
    assert not np.allclose(log.odometry.covariance[0], departing, atol=scale)


def test_a_turn_on_the_spot_has_no_direction_of_way(tmp_path: Path) -> None:
    """Nor has it one where the way is written as minus zero."""
    spreads = []
    for zero in (0.0, -0.0):
        content = frame(seen([(1.0, 0.0, 0.0, 1)])) + action((zero, 0.0, 0.4), model=1)
        log = read_log(rawlog(tmp_path, content + frame(seen([(1.0, 0.0, 0.0, 1)]))))
        assert isinstance(log.odometry, RelativePoses)
        spreads.append(log.odometry.covariance)
    assert np.array_equal(spreads[0], spreads[1])


def test_frames_without_measurements_are_bridged(tmp_path: Path) -> None:
    one = [(1.0, 0.5, 0.0, 1)]
    content = frame(seen(one)) + action((1, 0, 0.5)) + frame(beacons()) + action((1, 0, 0.5))
    log = read_log(rawlog(tmp_path, action((9, 9, 1)) + content + frame(seen(one))))
    assert isinstance(log.odometry, RelativePoses)
    expected = dead_reckoned(np.zeros(3), np.array([[1, 0, 0.5], [1, 0, 0.5]]))[-1]
    assert np.allclose(log.odometry.displacement, [expected])
    assert log.provenance["left_out"].startswith("1 motions before")


@pytest.mark.parametrize(("version", "place"), [(6, 1), (6, 2), (7, 3)])
def test_scans(version: int, place: int, tmp_path: Path) -> None:
    """Of the scanner with most; zeros, the maximum and beams marked so are no returns."""
    sensor = pose_3d(0.2, 0.1, 0.5, place)
    sweeps = [sweep(RANGES, sensor=sensor, version=version, anticlockwise=i < 1) for i in (0, 0, 1)]
    content = frame(sweeps[0]) + action((1, 0, 0)) + frame(sweeps[2], sweeps[1])
    log = read_log(rawlog(tmp_path, content))
    assert log.scans is not None
    assert log.scans.angle_rad.tolist() == [-1.5, -0.75, 0.0, 0.75, 1.5]
    assert np.array_equal(
        log.scans.range_m, [[2.0, np.nan, np.nan, np.nan, 5.0]] * 2, equal_nan=True
    )
    mount = log.scans.mount
    assert np.allclose((mount.forward_m, mount.left_m, mount.heading_rad), (0.2, 0.1, 0.5))
    assert log.scans.intensity[0].tolist() == ([0, 1, 2, 3, 4] if version == 7 else [0] * 5)
    assert log.provenance["scans"].endswith("CObservation2DRangeScan (front)")
    assert_survives_a_folder(log, tmp_path / "again")


def test_a_scanner_upside_down_and_eyes_that_look_aside(tmp_path: Path) -> None:
    """Beams lie the other way round; bearings are those from the robot's ahead."""
    half = struct.pack("<4d", 0.0, np.cos(0.25), np.sin(0.25), 0.0)  # yaw 0.5, then roll pi
    hanging = thing("CPose3D", 2, struct.pack("<3d", 0.2, 0.1, 0.5) + half)
    aside = pose_3d(yaw=3.0)
    content = frame(sweep(RANGES), seen([(1.0, 0.5, 0.0, 1)]))
    turned = frame(sweep(RANGES, sensor=hanging), seen([(1.0, 0.5, 0.0, 1)], sensor=aside))
    upright, other = (
        read_log(rawlog(tmp_path, one + action((1, 0, 0)) + one)) for one in (content, turned)
    )
    assert other.scans is not None
    assert np.allclose(other.scans.angle_rad, -present(upright.scans).angle_rad)
    assert other.scans.mount.heading_rad == pytest.approx(0.5)
    assert other.measurements.bearing_rad[0] == pytest.approx(3.5 - 2.0 * np.pi)


@pytest.mark.parametrize("version", [1, 2])
def test_observations_alone(version: int, tmp_path: Path) -> None:
    """Odometry's poses where the scans are; scans outside its time are left out."""
    step = 1_000_000
    parts = [odometry(0.1 * i, 0.0, 0.05 * i, START + i * step, version) for i in range(5)]
    parts += [sweep(RANGES, START + step * i // 2, version=7) for i in (1, 4, 99)]
    log = read_log(rawlog(tmp_path, b"".join(parts)))
    assert isinstance(log.odometry, RelativePoses)
    poses = np.array([[0.05, 0, 0.025], [0.2, 0, 0.1]])
    expected = displacements(np.array([0.0, 0.15]), poses)
    assert np.allclose(log.odometry.displacement, expected.displacement)
    assert np.allclose(log.odometry.covariance, expected.covariance)
    assert log.provenance["left_out"] == "1 instants outside the odometry"
    assert log.provenance["odometry"] == "5 CObservationOdometry, 1 motions between instants"


def test_truth_beside_the_log(tmp_path: Path) -> None:
    path = rawlog(tmp_path)
    pose = dead_reckoned(np.zeros(3), np.array(MOVES)) + (1.0, 2.0, 0.5)
    lines = "".join(f"{x} {y} 0 {heading} 0 0\n" for x, y, heading in pose)
    robot = tmp_path / "drive_ground_truth_robot_path.txt"
    robot.write_text("% Columns are: x y z yaw pitch roll\n\n" + lines)
    (tmp_path / "drive_ground_truth.txt").write_text(
        "".join(f"{p.real} {p.imag} 0 5 0 0 {name}\n" for name, p in LANDMARKS.items())
    )
    log = read_log(path)
    assert np.allclose(present(log.truth.poses).pose, pose)
    assert np.allclose(log.prior.pose, (1.0, 2.0, 0.5))
    assert present(log.truth.landmarks).id.tolist() == [3, 8, 9]
    robot.write_text(lines.split("\n", 1)[1])
    with pytest.raises(InputError, match="3 poses, expected 4, one for each frame of drive"):
        read_log(path)


def test_timed_truth_beside_the_log(tmp_path: Path) -> None:
    """Seconds since 1970; a file whose frames have no times cannot use it."""
    path = rawlog(tmp_path, drive(ticks=2_500_000))
    first = (START - 116444736000000000) / 1e7
    lines = "".join(f"{first + 0.25 * i:.6f} {i} 2 0.5\n" for i in range(4))
    (tmp_path / "drive.rawlog.GT.txt").write_text(lines)
    log = read_log(path)
    assert np.allclose(
        present(log.truth.poses).time_s, log.scans.time_s if log.scans else 0, atol=1e-6
    )
    assert np.allclose(log.prior.pose, (0.0, 2.0, 0.5), atol=1e-5)
    assert read_log(rawlog(tmp_path)).truth.poses is None


ONE = seen([(1.0, 0.5, 0.0, 1)])
BAD: dict[str, tuple[bytes, str]] = {
    "no object": (frame(ONE) + b"oops", f"byte {len(frame(ONE))}: no object starts here"),
    "unknown": (thing("CObservationGPS", 8, b""), "byte 0: CObservationGPS of version 8, expected"),
    "version": (thing("CSensoryFrame", 9, b""), "CSensoryFrame of version 9"),
    "control": (thing("C\x1b[31m", 0, b""), "byte 0: no object starts here"),
    "nested": (frame(frame(ONE)), "byte 19: CSensoryFrame of version 2, expected CObs"),
    "end": (thing("CActionCollection", 0, bytes(4), end=0x87), "does not end with 0x88 at byte 23"),
    "cut": (frame(ONE)[:-20], "cut?"),
    "count": (frame(sweep(RANGES, count=2**32 - 1)), "bytes more, expected at most"),
    "rows": (
        ONE.replace(b"\1\0\0\0\0\0\x80?", b"\xff\xff\xff\xff\0\0\x80?"),
        "68719476720 bytes more, expected at most",
    ),
    "empty": (b"", "no CObservationBearingRange or"),
    "beacons": (frame(beacons()) + action((1, 0, 0)), "no CObservationBearingRange or"),
    "space": (frame(seen([(1.0, 0.5, 0.2, 1)])) + action((1, 0, 0)), (
        "a pitch of 0.2 rad, which "
        "means"
    )),
    "3D": (thing("CActionCollection", 0, b"\1\0\0\0" + thing("CActionRobotMovement3D", 1, b"")),
           "CActionRobotMovement3D: a motion in space, expected one in the plane"),
    "matching": (action((1, 0, 0), method=1), "estimated by method 1, expected 0 (odometry)"),
    "model": (action((1, 0, 0), model=7), "model 7 of 1, expected model 0 or 1"),
    "infinite": (action((np.inf, 0, 0)), "byte 51: a pose holds inf, expected at most 1e+10"),
    "no noise": (
        frame(ONE) + action((1, 0, 0), gaussian=(0.0,) * 6) + frame(ONE),
        "byte 374: relative poses: covariance is not positive definite",
    ),
    "no motion": (
        frame(ONE) + frame(ONE) + action((1, 0, 0)),
        f"byte {len(frame(ONE))}: no motion since the frame before it",
    ),
    "offset": (frame(seen([(1.0, 0.5, 0.0, 1)], sensor=pose_3d(0.3))), "a sensor at 0.3, 0 m with"),
    "covariances": (frame(seen([], covariances=True)), "with a covariance for each measurement"),
    "range": (
        frame(seen([(-1.0, 0.5, 0.0, 1)])),
        "byte 19: measurements: range_m is -1.0, expected",
    ),
    "timeless": (sweep(RANGES, 0), "byte 0: an observation without a time"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_damaged_rawlogs(name: str, tmp_path: Path) -> None:
    content, message = BAD[name]
    assert_refused(rawlog(tmp_path, content), message, "rawlog")


def test_damaged_packing(tmp_path: Path) -> None:
    path = rawlog(tmp_path)
    whole = path.read_bytes()
    for content in (whole[:-9], whole[:60], whole[:-8] + bytes(8), whole + b"tail"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"drive\.rawlog: damaged gzip file"):
            read_log(path)


def test_bombs_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above the limit nothing more is unpacked."""
    monkeypatch.setattr(rawlog_stream, "MOST_BYTES", 2**20)
    path = tmp_path / "drive.rawlog"
    path.write_bytes(gzip.compress(drive() + bytes(2**26)))
    with pytest.raises(InputError, match="more than 1048576 bytes unpacked"):
        read_log(path)
    path.write_bytes(gzip.compress(frame() * 50_000))
    monkeypatch.setattr(rawlog_stream, "MOST_OBJECTS", 1000)
    with pytest.raises(InputError, match="byte 20000: more than 1000 objects"):
        read_log(path)


def test_what_is_no_rawlog(tmp_path: Path) -> None:
    path = tmp_path / "drive.rawlog"
    for content in (b"", b"FLASER 180", gzip.compress(b"FLASER"), b"\x1f\x8bbroken", b"\x84abcd"):
        path.write_bytes(content)
        assert not rawlog_stream.is_rawlog(path)
    assert pose_2d(0, 0, 0)[1:8] == b"CPose2D"
