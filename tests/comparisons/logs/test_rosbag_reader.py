"""ROS bags written at test time; without the extra, one line says what to install."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.scan_odometry import run_scan_odometry
from comparisons.adapters.tree_features import with_tree_features
from comparisons.errors import InputError
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.readers import read_log
from tests.comparisons.logs.test_readers import assert_refused
from tests.comparisons.logs.test_scan_readers import assert_survives_a_folder

pytest.importorskip("rosbags")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores

from tests.comparisons.logs.bags import EPOCH, XYZ, Message, T, Types, drive
from tests.helpers import present


@pytest.mark.parametrize("kind", ["mcap", "mcap file", "db3", "db3 file", "bag"])
def test_laser_scans_with_odometry(kind: str, tmp_path: Path) -> None:
    types = Types(Stores.ROS1_NOETIC) if kind == "bag" else T
    path = tmp_path / ("drive.bag" if kind == "bag" else "drive")
    types.write(path, drive(types), mcap=kind.startswith("mcap"))
    if kind.endswith("file"):
        path = next(path.glob("*." + kind.split()[0]))
    log = read_log(path)
    assert (log.name, log.format) == ("drive", "rosbag")
    scans = present(log.scans)
    assert np.allclose(scans.time_s, (0.0, 0.25, 0.8))
    assert np.allclose(scans.angle_rad, (-0.5, -0.25, 0.0, 0.25, 0.5))
    assert np.array_equal(scans.range_m[0], (1.0, *[np.nan] * 4), equal_nan=True)
    assert scans.intensity[2].tolist() == [5.0, 4.0, 3.0, 0.0, 1.0]
    assert np.isclose(scans.beam_s, 1e-3)
    mount = scans.mount
    assert np.allclose((mount.forward_m, mount.left_m, abs(mount.heading_rad)), (-1, 0, np.pi))
    assert isinstance(log.odometry, RelativePoses)
    assert np.allclose(log.odometry.time_s, scans.time_s[1:])
    # From 0.1 s to 0.35 s: half a metre along x, seen from a heading of 0.1 rad.
    expected = (0.5 * np.cos(0.1), -0.5 * np.sin(0.1), 0.25)
    assert np.allclose(log.odometry.displacement[0], expected)
    assert log.provenance["Odometry"] == "/odom, 4 messages; 1 with a repeated time left out"
    assert log.provenance["left_out"] == "1 records outside the odometry (1 of 4 scans)"
    assert log.provenance["scans_mount"] == "laser seen from base"
    assert_survives_a_folder(log, tmp_path / "again")


def test_of_several_topics_one_is_asked_for(tmp_path: Path) -> None:
    few = [("/a", *T.laser(t)[1:]) for t in (1.0, 2.0)]
    many = [("/b", *T.laser(t)[1:]) for t in (1.0, 2.0, 3.0)]
    path = T.write(tmp_path / "bag", few + many)
    with pytest.raises(
        InputError,
        match=r"2 topics of type sensor_msgs/msg/LaserScan: /b \(3 messages\), /a \(2 messages\); "
        "expected one, say which by --topic NAME",
    ):
        read_log(path)
    log = read_log(path, topics=("/b",))
    assert log.provenance["LaserScan"] == "/b, 3 messages; not read: /a (2)"
    assert log.scans is not None
    assert not len(log.odometry.time_s)
    assert log.provenance["scans_mount"].startswith("unknown (laser from the base)")
    with pytest.raises(InputError, match="bag: holds no odometry, which following trunks needs"):
        with_tree_features(log)
    assert_survives_a_folder(log, tmp_path / "again")


def test_an_upside_down_laser_turns_its_beams(tmp_path: Path) -> None:
    mounted = T.static(("base_link", "laser", 0.0, 0.0, 0.3, np.pi))
    log = read_log(T.write(tmp_path / "bag", [mounted, T.laser(1.0)]))
    assert log.scans is not None
    assert np.allclose(log.scans.angle_rad, (0.5, 0.25, 0.0, -0.25, -0.5))
    assert np.isclose(log.scans.mount.heading_rad, 0.3)


def test_headers_without_times_leave_those_of_the_recording(tmp_path: Path) -> None:
    topic, kind, _, message = T.laser(0.0)
    scans: list[Message] = [(topic, kind, EPOCH + t, message) for t in (0.0, 0.5)]
    log = read_log(T.write(tmp_path / "bag", scans))
    assert present(log.scans).time_s.tolist() == [0.0, 0.5]
    assert log.provenance["LaserScan"].endswith("times of recording, since the headers have none")


POINTS = np.array(((1, 2, 3), (0, 0, 0), (np.nan, 1, 1), (4, 5, 6)), np.float64)
TIMES: dict[str, tuple[str, np.ndarray]] = {
    "none": ("", np.zeros(4)),
    "ns in t": ("<u4", np.array((1e7, 0, 0, 9e7))),
    "s in time": ("<f4", np.array((0.01, 0, 0, 0.09))),
    "ns in time": ("<f4", np.array((1e7, 0, 0, 9e7))),
    "s in timestamp": ("<f8", EPOCH + np.array((0.01, 0, 0, 0.09))),
    "ns in timestamp": ("<f8", 1e9 * EPOCH + np.array((1e7, 0, 0, 9e7))),
}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("name", TIMES)
def test_clouds(name: str, order: str, tmp_path: Path) -> None:
    """Any order of fields and bytes, gaps between them, two rows with padding."""
    dtype, values = TIMES[name]
    layout = [("z", order + "f8"), ("ring", "<u2"), ("x", order + "f8"), ("y", order + "f8")]
    if dtype:
        layout.append((name.split()[-1], order + dtype[1:]))
    records = np.zeros(4, layout)
    for column, axis in zip(POINTS.T, "xyz", strict=True):
        records[axis] = column
    if dtype:
        records[name.split()[-1]] = values
    step = records.dtype.itemsize
    rows = b"".join(records[i : i + 2].tobytes() + b"\xff" * 7 for i in (0, 2))
    message = T.cloud(
        EPOCH,
        records,
        height=2,
        width=2,
        row_step=2 * step + 7,
        data=np.frombuffer(rows, np.uint8),
        is_bigendian=order == ">",
    )
    mounted = T.static(("base_link", "lidar", 1.0, 0.0, np.pi / 2, 0.0))
    later = T.cloud(EPOCH + 1, records[:0])
    log = read_log(T.write(tmp_path / "bag", [mounted, message, later]))
    clouds = present(log.clouds)
    assert clouds.time_s.tolist() == [0.0, 1.0]
    assert clouds.first.tolist() == [0, 2, 2]
    assert np.allclose(clouds.point_m, ((-1.0, 1.0, 3.5), (-4.0, 4.0, 6.5)))
    assert np.allclose(clouds.point_s, (0.01, 0.09) if dtype else 0.0, atol=1e-6)
    assert_survives_a_folder(log, tmp_path / "again")


def test_scans_and_clouds_share_the_poses(tmp_path: Path) -> None:
    records = np.ones(3, XYZ)
    messages = [*drive(T), T.cloud(EPOCH + 0.5, records), T.cloud(EPOCH + 2.0, records)]
    log = read_log(T.write(tmp_path / "bag", messages))
    assert np.allclose(log.odometry.time_s, (0.25, 0.4, 0.8))
    assert np.allclose(present(log.clouds).time_s, 0.4)
    assert (
        log.provenance["left_out"] == "2 records outside the odometry (1 of 4 scans, 1 of 2 clouds)"
    )


def room(pose: np.ndarray, angle: np.ndarray, beam_s: float) -> np.ndarray:
    """Ranges to four walls while the vehicle drives on at 1 m/s and turns at 0.5 rad/s."""
    x, y, heading = pose.tolist()
    ranges = []
    for i, a in enumerate(angle.tolist()):
        h = heading + 0.5 * i * beam_s
        at = (x + i * beam_s * np.cos(h), y + i * beam_s * np.sin(h))
        c, s = np.cos(a + h), np.sin(a + h)
        ranges.append(min(((8 if c > 0 else -4) - at[0]) / c, ((3 if s > 0 else -5) - at[1]) / s))
    return np.array(ranges, np.float32)


@pytest.mark.parametrize("beam_s", [0.0, 1.5e-4])
def test_scan_odometry_of_a_bag(beam_s: float, tmp_path: Path) -> None:
    """With the sweep's own motion undone, by the share of the odometry between scans."""
    angle = -2.301 + 0.01 * np.arange(461)
    pose = np.zeros(3)
    messages = []
    for k in range(20):
        ranges = room(pose, angle, beam_s)
        scan = T.laser(
            EPOCH + 0.1 * k,
            ranges=ranges,
            intensities=np.zeros(0, np.float32),
            time_increment=beam_s,
            angle_min=-2.301,
            angle_increment=0.01,
            range_max=30.0,
        )
        messages += [T.odometry(EPOCH + 0.1 * k, pose[0], pose[2], y=pose[1]), scan]
        if k < 19:
            middle = pose[2] + 0.025
            pose = pose + (0.1 * np.cos(middle), 0.1 * np.sin(middle), 0.05)
    motion = run_scan_odometry(read_log(T.write(tmp_path / "bag", messages)))
    assert motion.breaks == 0
    assert np.allclose(motion.pose[-1], pose, atol=5e-3)


def clouds(**changes: object) -> list[Message]:
    """One of three points."""
    return [T.cloud(1.0, np.ones(3, XYZ), **changes)]


FIELD, *FIELDS = clouds()[0][3].fields
TILTED = ("base_link", "laser", 0.0, 0.0, 0.0, 0.5)
BAD: dict[str, tuple[list[Message], str]] = {
    "nothing": ([T.odometry(1.0, 0.0)], "no messages of type sensor_msgs/msg/LaserScan or"),
    "no ranges": ([T.laser(1.0, ranges=np.zeros(0, np.float32))], "/scan, message 0: no ranges"),
    "intensities": (
        [T.laser(1.0), T.laser(2.0, intensities=np.ones(2, np.float32))],
        "/scan, message 1: 2 intensities, expected 0 or 5",
    ),
    "nan": ([T.laser(1.0, angle_min=np.nan)], "message 0: angle_min is nan, expected a finite"),
    "maximum": ([T.laser(1.0, range_max=0.0)], "range_max is 0, expected above range_min 0.1"),
    "turn": ([T.laser(1.0, angle_increment=90.0)], "angle_increment 90 for 5 beams, expected"),
    "sweep": ([T.laser(1.0, time_increment=9.0)], "bag: scans: beam_s is 9.0, expected sweeps"),
    "beams": (
        [T.laser(1.0), T.laser(2.0, angle_min=-0.4)],
        "message 1: 5 beams from -0.4 to 0.6 rad, expected 5 from -0.5 to 0.5 as in the first",
    ),
    "frame": (
        [T.laser(1.0), T.laser(2.0, "rear")],
        "/scan, message 1: frame is rear, expected laser as in the first",
    ),
    "backwards": (
        [T.laser(1.0), T.laser(3.0), (*T.laser(1.0)[:2], 4.0, T.laser(2.0)[3])],
        "/scan, message 2: time 2.000000 s follows 3.000000 s, expected times to increase",
    ),
    "tilt": ([T.static(TILTED), T.laser(1.0)], "bag: /scan: mounted at a tilt of 28.6 degrees"),
    "apart": (
        [T.odometry(1.0, 0.0), T.odometry(2.0, 0.0), T.laser(5.0)],
        "no scan lies within the time of the odometry",
    ),
    "quaternion": (
        [
            T.laser(1.0),
            T.odometry(1.0, 0.0, quaternion=T.make("geometry_msgs/msg/Quaternion")),
        ],
        "/odom, message 0: a quaternion is [0.0, 0.0, 0.0, 0.0], expected one of unit length",
    ),
    "position": ([T.laser(1.0), T.odometry(1.0, np.inf)], "/odom, message 0: a position is [inf"),
    "fields": (
        clouds(fields=[FIELD]),
        "/points, message 0: fields are x, expected x, y and z among them",
    ),
    "width": (
        clouds(width=4_000_000_000),
        "36 bytes in rows of 36, expected 1 times 4000000000 points of 12",
    ),
    "height": (clouds(height=2), "36 bytes in rows of 36, expected 2 times 3 points of 12"),
    "step": (clouds(point_step=8), "field z lies at byte 8, expected within point_step 8"),
    "datatype": (
        clouds(fields=[replace(FIELD, datatype=4), *FIELDS]),
        "field x has datatype 4, expected floating point",
    ),
    "times": (
        [T.cloud(1.0, np.array([(1.0, 1.0, 1.0, 77e9)], [*XYZ, ("time", "<f8")]))],
        "field time runs from 7.7e+10 to 7.7e+10, expected seconds or nanoseconds within 5 s",
    ),
    "far": (
        [T.cloud(1.0, np.full(1, 1e30, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))],
        "/points, message 0: a coordinate is 1e+30, expected at most 1e+10",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_unusable_bags(name: str, tmp_path: Path) -> None:
    messages, message = BAD[name]
    assert_refused(T.write(tmp_path / "bag", messages), message)


def test_a_bag_cut_off_within_a_message(tmp_path: Path) -> None:
    raw = bytes(T.store.serialize_cdr(T.laser(1.0)[3], "sensor_msgs/msg/LaserScan"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=T.store)
        bag.write(connection, 1, raw)
        bag.write(connection, 2, raw[:-30])
    with pytest.raises(InputError, match=r"bag: /scan, message 1: cannot be read \("):
        read_log(tmp_path / "bag")


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = T.write(tmp_path / "bag", [T.laser(1.0)])
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(InputError, match=r"needs the extra ros: pip install slamcheck\[ros\]$"):
        read_log(path)
