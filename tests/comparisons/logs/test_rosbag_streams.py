"""Which topics of a bag are read is said; what is placeholder or outside is named and not used."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.cli.support import say_streams
from comparisons.errors import InputError
from comparisons.estimates.bag_estimate import split_topics
from comparisons.estimates.external import read_external
from comparisons.logs import odometry_noise
from comparisons.logs.readers import read_log, ros_points

pytest.importorskip("rosbags")

from tests.comparisons.logs.bags import EPOCH, XYZ, Message, T, Types, drive
from tests.helpers import present

D = Types().with_detections()
KIND = "nav_msgs/msg/Odometry"


def wheels(topic: str = "/wheel/odom", **changes: Any) -> list[Message]:
    """A curve at 5 Hz for 8 s."""
    times = np.arange(41) / 5.0
    return [(topic, *T.odometry(EPOCH + t, 0.8 * t, 0.1 * t, **changes)[1:]) for t in times]


def trees(begin: float, end: float) -> list[Message]:
    times = np.arange(begin, end, 0.25)
    return [
        D.detections(EPOCH + t, ("tree", "1", 3.0, 1.0), ("tree", "2", 4.0, -1.0)) for t in times
    ]


def in_order(messages: list[Message]) -> list[Message]:
    return sorted(messages, key=lambda message: message[2])


def test_each_stream_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By topic and count; also what is of no type that is read, or was not asked for."""
    other = ("/imu", "sensor_msgs/msg/Imu", EPOCH, T.make("sensor_msgs/msg/Imu"))
    marks = D.markers(EPOCH + 1.0, (1, 2.0, 0.0))
    messages = [*wheels(), *wheels("/filtered"), *trees(-0.5, 8.0), other, marks]
    path = D.write(tmp_path / "bag", in_order(messages))
    say_streams(read_log(path, topics=("/wheel/odom",)), str(path))
    lines = capsys.readouterr().err.splitlines()
    assert lines[:4] == [
        "slamcheck: bag: odometry: /wheel/odom, 41 messages; not read: /filtered (41)",
        "slamcheck: bag: measurements: /detections, 34 messages",
        "slamcheck: bag: topics not read: /imu (sensor_msgs/msg/Imu), "
        "/markers (visualization_msgs/msg/MarkerArray)",
        "slamcheck: bag: left out: 2 records outside the odometry (2 of 34 measurements)",
    ]
    assert lines[4].startswith("slamcheck: bag: odometry's noise: stated: 0.1 m per root metre")
    say_streams(read_log(path, topics=("/wheel/odom",)), str(tmp_path))
    assert capsys.readouterr().err == ""  # of another log


@pytest.mark.parametrize("topic", ["odometry", "laser", "cloud", "fix", "detections"])
def test_two_candidates_are_refused(tmp_path: Path, topic: str) -> None:
    """Of every type that is read by itself; the one with more messages may be an estimate."""
    records = np.ones(3, XYZ)
    made = {
        "odometry": wheels(),
        "laser": [T.laser(EPOCH + t) for t in (1.0, 2.0)],
        "cloud": [T.cloud(EPOCH + t, records) for t in (1.0, 2.0)],
        "fix": [T.fix(EPOCH + t, 48.0, 11.0) for t in (1.0, 2.0)],
        "detections": trees(0.0, 2.0),
    }
    again = [("/filtered", *message[1:]) for message in made[topic]]
    messages = [*made["odometry"], *made["laser"], *made[topic], *again, again[-1]]
    path = D.write(tmp_path / "bag", in_order(messages))
    with pytest.raises(InputError, match=r"2 topics of type .*/filtered \(\d+ messages\)"):
        read_log(path)
    assert read_log(path, topics=("/filtered",)).records


def test_without_odometry_candidates_for_nothing_are_no_matter(tmp_path: Path) -> None:
    fixes = [(name, *T.fix(EPOCH + 1.0, 48.0, 11.0)[1:]) for name in ("/a", "/b")]
    log = read_log(T.write(tmp_path / "bag", [T.laser(EPOCH + 1.0), *fixes]))
    assert log.provenance["positions"] == f"left out: no messages of type {KIND}"


@pytest.mark.parametrize("begin", [-1.0, -0.06, -1e-9, 0.0, 1e-9, 0.06, 1.0])
@pytest.mark.parametrize("end", [7.0, 7.94, 8.06, 9.0])
def test_what_lies_outside_is_cut_and_counted(tmp_path: Path, begin: float, end: float) -> None:
    messages = trees(begin, end)
    log = read_log(D.write(tmp_path / "bag", in_order([*wheels(), *messages])))
    inside = sum(EPOCH <= message[2] <= EPOCH + 8.0 for message in messages)
    cut = len(messages) - inside
    of_each = f" ({cut} of {len(messages)} measurements)" if cut else ""
    assert log.provenance["left_out"] == f"{cut} records outside the odometry{of_each}"
    assert len(log.measurements.time_s) == 2 * inside


def in_slots(**values: float) -> np.ndarray:
    """(6, 6) of a value by slot, as s07=1.0."""
    found = np.zeros(36)
    for slot, value in values.items():
        found[int(slot[1:])] = value
    return found.reshape(6, 6)


def of_all(value: float) -> np.ndarray:
    return in_slots(s00=value, s07=value, s35=value)


PLACEHOLDERS = {
    "0": (of_all(0.0), "are 0", "are 0"),
    "-1": (of_all(-1.0), "variance of x of -1", "variance of speed of -1"),
    "first -1": (in_slots(s00=-1.0), "variance of x of -1", "variance of speed of -1"),
    "1e-9": (of_all(1e-9), "are the same at every pose", "variance of speed of 1e-09, below 1e-06"),
    "1e308": (of_all(1e308), "variance of x of 1e+308, above 1000", "1e+308, above 1000"),
    "nan": (of_all(np.nan), "are not finite", "are not finite"),
    "z": (in_slots(s14=0.1), "stand in slots of z alone", "stand in slots of z alone"),
    "roll, pitch": (in_slots(s21=0.1, s28=0.1), "slots of roll and pitch alone", "roll and pitch"),
    "3 x 3": (in_slots(s00=0.1, s04=0.1, s08=0.1), "are not symmetric (slots 4 and 24 differ)",
              "are not symmetric (slots 4 and 24 differ)"),
    "yaw in z": (in_slots(s00=0.1, s07=0.1, s14=0.1), "have no variance of heading",
                 "variance of yaw rate of 0, below 1e-06"),
}  # fmt: skip


def with_covariances(messages: list[Message], pose: Any = None, twist: Any = None) -> list[Message]:
    """The same; either (6, 6) of all messages."""
    for _, _, _, message in messages:
        if pose is not None:
            message.pose.covariance[:] = np.ravel(pose)
        if twist is not None:
            message.twist.covariance[:] = np.ravel(twist)
    return messages


def noise_of(path: Path, pose: Any, twist: Any) -> tuple[str, np.ndarray]:
    messages = [*with_covariances(wheels(), pose, twist), T.laser(EPOCH), T.laser(EPOCH + 8.0)]
    log = read_log(T.write(path, in_order(messages)))
    return log.provenance["odometry_noise"], log.odometry.covariance  # type: ignore[union-attr]


@pytest.mark.parametrize("name", PLACEHOLDERS)
def test_placeholders_are_named_and_not_used(tmp_path: Path, name: str) -> None:
    """Of pose and twist; beside a sound twist, too, which is used."""
    six, pose_words, twist_words = PLACEHOLDERS[name]
    _, stated = noise_of(tmp_path / "none", of_all(0.0), of_all(0.0))
    words, covariance = noise_of(tmp_path / "both", six, six)
    assert_not_used(words, pose_words, twist_words)
    np.testing.assert_array_equal(covariance, stated)
    words, _ = noise_of(tmp_path / "twist", six, of_all(0.01))
    assert words.startswith("Odometry's twist covariances, each sample's own")
    assert pose_words in words


def assert_not_used(words: str, pose: str, twist: str) -> None:
    assert words.startswith("stated: ")
    before, _, after = words.partition(", and its twist covariances ")
    assert pose in before
    assert twist in after


def test_a_check_that_lets_all_pass_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(odometry_noise, "_twist_fault", lambda variance: "")
    words, _ = noise_of(tmp_path / "a", of_all(1e-9), of_all(1e-9))
    with pytest.raises(AssertionError):
        assert_not_used(words, "", "")
    monkeypatch.undo()
    monkeypatch.setattr(ros_points, "slots_fault", lambda covariance: "")
    six, pose, twist = PLACEHOLDERS["3 x 3"]
    words, _ = noise_of(tmp_path / "b", six, six)
    with pytest.raises(AssertionError):
        assert_not_used(words, pose, twist)


def test_an_estimate_from_a_topic(tmp_path: Path) -> None:
    """Poses with their covariances, on the bag's clock."""
    growing = []
    for k, (_, kind, time, message) in enumerate(wheels()):
        message.pose.covariance[:] = (of_all(0.01 * (k + 1))).ravel()
        growing.append(("/filtered", kind, time, message))
    path = D.write(tmp_path / "bag", in_order([*wheels(), *growing, growing[-1]]))
    with pytest.raises(
        InputError, match=r"2 topics that may be the estimate: /filtered \(nav_msgs"
    ):
        read_external(path)
    with pytest.raises(InputError, match="bag: no topic /x, expected some of /filtered"):
        read_external(path, topics=("/x",))
    given = read_external(path, topics=("/filtered",)).validated()
    assert given.source == f"/filtered, 42 messages of {KIND}"
    assert given.left_out.startswith("1 of 42 poses of /filtered repeat the time")
    np.testing.assert_allclose(given.time_s - EPOCH, np.arange(41) / 5.0, atol=1e-6)
    np.testing.assert_allclose(given.pose[:, 2], 0.1 * np.arange(41) / 5.0, atol=1e-12)
    np.testing.assert_allclose(present(given.pose_covariance)[4], 0.05 * np.eye(3))


@pytest.mark.parametrize("name", PLACEHOLDERS)
def test_placeholders_of_an_estimate(tmp_path: Path, name: str) -> None:
    six, words, _ = PLACEHOLDERS[name]
    path = T.write(tmp_path / "bag", with_covariances(wheels("/filtered"), six))
    given = read_external(path)
    assert given.pose_covariance is None
    assert given.left_out.startswith("pose covariances of /filtered ")
    assert words in given.left_out
    assert given.left_out.endswith(", and are not used")


@pytest.mark.parametrize("covariance", [True, False])
def test_stamped_poses_are_an_estimate(tmp_path: Path, covariance: bool) -> None:
    kind = f"geometry_msgs/msg/Pose{'WithCovariance' * covariance}Stamped"
    messages = []
    for topic, _, time, message in wheels("/amcl_pose"):
        made = T.make(kind)
        made.header = message.header
        made.pose = message.pose if covariance else message.pose.pose
        messages.append((topic, kind, time, made))
    given = read_external(T.write(tmp_path / "bag", messages))
    np.testing.assert_allclose(given.pose[:, 0], 0.8 * np.arange(41) / 5.0)
    assert given.pose_covariance is None
    assert bool(given.left_out) == covariance
    with pytest.raises(InputError, match="is a ROS bag, which --trace does not go with"):
        read_external(tmp_path / "bag", trace="x")


def test_topics_of_log_and_estimate(tmp_path: Path) -> None:
    two = D.write(tmp_path / "two", [*wheels("/w"), *wheels("/f"), T.laser(EPOCH + 1.0)])
    three = D.write(tmp_path / "three", [*wheels("/w"), *wheels("/f"), *wheels("/g")])
    one = T.write(tmp_path / "one", drive(T))
    folder = tmp_path / "folder"
    folder.mkdir()
    for estimate, log, topics, expected in (
        (two, two, ("/f",), (("/w",), ("/f",))),
        (two, two, ("/w", "/f"), (("/w",), ("/f",))),
        (two, two, ("/scan", "/f"), (("/scan", "/w"), ("/f",))),
        (two, one, ("/f",), ((), ("/f",))),
        (two, folder, ("/f",), ((), ("/f",))),
        (folder, two, ("/f",), (("/f",), ())),
        (three, three, ("/f",), ((), ("/f",))),
        (two, two, (), ((), ())),
    ):
        assert split_topics(estimate, log, topics) == expected


def test_an_estimate_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    topic, kind, _, first = wheels("/f")[0]
    falling = T.write(tmp_path / "falling", [*wheels("/f"), (topic, kind, EPOCH + 9.0, first)])
    with pytest.raises(InputError, match="falling: /f, message 41: expected times that increase"):
        read_external(falling)
    none = T.write(tmp_path / "none", [T.laser(EPOCH)])
    with pytest.raises(InputError, match="none: no messages of type nav_msgs/msg/Odometry, "):
        read_external(none)
