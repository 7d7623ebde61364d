"""CSV exports of ROS messages: the same log whatever tool wrote them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.message_csv import MESSAGES, message_of
from comparisons.logs.odometry import RelativePoses, VelocityOdometry
from tests.comparisons.logs.test_foreign_files import DRIVE, STEP_S, WHEELS, own

EPOCH = 1_700_000_000
COUNT = 60
MEASUREMENTS = "label,t,bearing [deg],range\n" + "".join(
    f"post {post},{EPOCH + t:.3f},{np.degrees(bearing)!r},{distance!r}\n".replace(
        "np.float64(", ""
    ).replace(")", "")
    for t, post, distance, bearing in DRIVE.seen
    if t < (COUNT - 2) * STEP_S
)


def stamps() -> list[tuple[int, int]]:
    """Seconds and nanoseconds of each message."""
    return [divmod(round(k * STEP_S * 1e9) + EPOCH * 10**9, 10**9) for k in range(COUNT)]


def quaternion(yaw: float) -> list[float]:
    return [0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]


def odometry() -> list[list[Any]]:
    """The fields of nav_msgs/Odometry; no covariances are known."""
    return [
        [*stamp, "odom", "base", x, y, 0.0, *quaternion(yaw), *[0.0] * 36]
        + [DRIVE.speed[k], 0.0, 0.0, 0.0, 0.0, DRIVE.turn[k], *[0.0] * 36]
        for k, (stamp, (x, y, yaw)) in enumerate(zip(stamps(), DRIVE.pose.tolist(), strict=False))
    ]


def text(rows: list[list[Any]], header: list[str] | None = None) -> str:
    lines = [] if header is None else [",".join(header)]
    words = [[f"{w:.17g}" if isinstance(w, float) else str(w) for w in row] for row in rows]
    return "\n".join(lines + [",".join(row) for row in words]) + "\n"


def rostopic(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    """`rostopic echo -p`: the time of recording, and one stamp in nanoseconds."""
    header = ["%time", "field.header.seq", "field.header.stamp"]
    header += [f"field.{name}" for name in names[2:]]
    whole = [row[0] * 10**9 + row[1] for row in rows]
    return text(
        [
            [ns + 5_000_000, k, ns, *row[2:]]
            for k, (ns, row) in enumerate(zip(whole, rows, strict=True))
        ],
        header,
    )


def ros2(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    """`ros2 topic echo --csv`: no header."""
    del names
    return text(rows)


def plotjuggler(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    header = [re.sub(r"covariance(\d+)", r"covariance[\1]", n).replace(".", "/") for n in names]
    stamped = [[row[0] + row[1] * 1e-9 + 0.005, *row] for row in rows]
    return text(stamped, ["__time", *(f"/robot/odom/{name}" for name in header)])


def matlab(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    """Names with capitals; covariances are counted from 1."""
    header = [re.sub(r"(\d+)", lambda m: f"_{int(m[1]) + 1}", name) for name in names]
    header = [".".join(w.capitalize() for w in name.split(".")) for name in header]
    return text(rows, [name.replace("Nanosec", "Nsec") for name in header])


def bagpy(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    header = [n.replace("stamp.sec", "stamp.secs").replace("nanosec", "nsecs") for n in names]
    header = [re.sub(r"(\d+)", r"_\1", name) for name in header]
    return text([[row[0] + row[1] * 1e-9 + 0.005, *row] for row in rows], ["Time", *header])


def flattened(names: tuple[str, ...], rows: list[list[Any]]) -> str:
    return text(rows, [name.replace(".", "_") for name in names])


TOOLS = (rostopic, ros2, plotjuggler, matlab, bagpy, flattened)
Writer = Callable[[tuple[str, ...], list[list[Any]]], str]


def read(folder: Path, drive: str, stated: dict[str, Any] | None = None, **more: Any) -> Log:
    return own(folder, drive, MEASUREMENTS, stated or {}, **more)


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.__name__)
def test_odometry_of_every_tool(tool: Writer, tmp_path: Path) -> None:
    """Its poses; its velocities where their sigma is stated. By the stamp, not the recording."""
    drive = tool(MESSAGES["nav_msgs/Odometry"], odometry())
    log = read(tmp_path, drive)
    assert isinstance(log.odometry, RelativePoses)
    assert log.prior.time_s == 0.0
    (k,) = np.flatnonzero(np.isclose(log.odometry.time_s, 1.0, rtol=0.0, atol=1e-4))
    path = [np.zeros(3)]
    for dx, dy, turn in log.odometry.displacement[: k + 1]:
        c, s = np.cos(path[-1][2]), np.sin(path[-1][2])
        path.append(path[-1] + (c * dx - s * dy, s * dx + c * dy, turn))
    assert np.allclose(path[-1], DRIVE.pose[10], atol=1e-9)
    driven = read(tmp_path, drive, WHEELS).odometry
    assert isinstance(driven, VelocityOdometry)
    assert np.allclose(driven.yaw_rate_radps, DRIVE.turn[:COUNT])
    assert np.allclose(driven.speed_mps, DRIVE.speed[:COUNT])
    assert driven.time_s.tolist() == [((s - EPOCH) * 10**9 + ns) / 1e9 for s, ns in stamps()]


def test_covariances_that_grow_are_the_noise(tmp_path: Path) -> None:
    """As of a bag: what each motion adds, and 1 mm and 1 mrad."""
    straight = []
    for k, row in enumerate(odometry()):
        grown = np.zeros((6, 6))
        before = 0.1 * (k - np.arange(1, k + 1))  # the heading's variance carries over to y
        grown[0, 0], grown[5, 5] = 1e-3 * k, 1e-4 * k
        grown[1, 1] = 1e-3 * k + 1e-4 * float(before @ before)
        grown[1, 5] = grown[5, 1] = 1e-4 * float(before.sum())
        pose = [0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        straight.append([*row[:4], *pose, *grown.ravel().tolist(), *row[47:]])
    log = read(tmp_path, flattened(MESSAGES["nav_msgs/Odometry"], straight))
    assert log.provenance["odometry_noise"].startswith("the increments of Odometry's pose cov")
    assert isinstance(log.odometry, RelativePoses)
    total = log.odometry.covariance.sum(axis=0) - len(log.odometry.time_s) * 1e-6 * np.eye(3)
    assert np.allclose(total.diagonal(), (1e-3 * 59, 1e-3 * 59, 1e-4 * 59))


def test_yaw_rates_of_an_imu(tmp_path: Path) -> None:
    """The mean over each sample of the odometry, in place of its own."""
    fine = np.arange(0.0, COUNT * STEP_S + 0.01, 0.01)
    rate = 0.2 + 0.1 * np.sin(fine)
    rows = [
        [
            EPOCH + int(t + 1e-6),
            round((t % 1.0) * 1e9) % 10**9,
            "imu",
            0.0,
            0.0,
            0.0,
            1.0,
            *[0.0] * 9,
        ]
        + [0.0, 0.0, w, *[0.0] * 9, 0.0, 0.0, 9.81, *[0.0] * 9]
        for t, w in zip(np.round(fine, 2).tolist(), rate.tolist(), strict=True)
    ]
    (tmp_path / "imu.csv").write_text(ros2((), rows))
    drive = bagpy(MESSAGES["nav_msgs/Odometry"], odometry())
    log = read(tmp_path, drive, WHEELS, imu=tmp_path / "imu.csv")
    assert isinstance(log.odometry, VelocityOdometry)
    start = np.arange(COUNT) * STEP_S
    mean = 0.2 - 0.1 * (np.cos(start + STEP_S) - np.cos(start)) / STEP_S
    assert np.allclose(log.odometry.yaw_rate_radps, mean, atol=1e-5)
    assert "yaw_rate_radps from 'imu.csv, mean of each sample'" in log.provenance["odometry file"]
    (tmp_path / "imu.csv").write_text(ros2((), rows[6:]))  # 0.06 s later, of twice 0.01 s allowed
    later = read(tmp_path, drive, WHEELS, imu=tmp_path / "imu.csv")
    assert len(later.odometry.time_s) == COUNT - 1
    (tmp_path / "imu.csv").write_text(ros2((), rows[:100]))
    with pytest.raises(
        InputError, match=r"imu.csv: from .* s, expected yaw rates for the odometry"
    ):
        read(tmp_path, drive, WHEELS, imu=tmp_path / "imu.csv")


def fixes(folder: Path) -> Path:
    """Without noise, in a plane turned by 40 degrees."""
    rows = []
    for stamp, (x, y, _) in zip(stamps(), DRIVE.truth.tolist(), strict=False):
        east, north = (complex(x, y) * np.exp(1j * np.deg2rad(40.0))).real, 0.0
        north = (complex(x, y) * np.exp(1j * np.deg2rad(40.0))).imag
        place = [51.0 + north / 111257.8, 7.0 + east / 70197.1, 0.0]
        rows.append([*stamp, "gps", 0, 1, *place, *(0.01 * np.eye(3)).ravel().tolist(), 2])
    (folder / "gps.csv").write_text(ros2((), rows))
    return folder / "gps.csv"


@pytest.mark.parametrize("kind", ["poses", "velocity"])
def test_fixes_are_laid_onto_the_odometry(kind: str, tmp_path: Path) -> None:
    """In the frame of the start, whatever the odometry; the first are spent on its heading."""
    drive = bagpy(MESSAGES["nav_msgs/Odometry"], odometry())
    stated = WHEELS if kind == "velocity" else {"sigma_move_m": 0.005, "sigma_turn": 0.002}
    log = read(tmp_path, drive, stated, paths={"positions": fixes(tmp_path)})
    assert log.positions is not None
    assert 10 < len(log.positions.time_s) < COUNT - 1
    k = np.round(log.positions.time_s / STEP_S).astype(int)
    assert np.abs(log.positions.position_m - DRIVE.truth[k, :2]).max() < 0.1
    assert np.allclose(log.positions.covariance, 0.01 * np.eye(2))
    assert 1e-6 < log.prior.covariance[2, 2] < np.deg2rad(15.0) ** 2


def test_poses_with_covariance_are_positions(tmp_path: Path) -> None:
    rows = [
        [*row[:2], "map", *row[4:11], *(0.04 * np.eye(6)).ravel().tolist()] for row in odometry()
    ]
    (tmp_path / "amcl.csv").write_text(ros2((), rows))
    log = read(
        tmp_path,
        bagpy(MESSAGES["nav_msgs/Odometry"], odometry()),
        WHEELS,
        paths={"positions": tmp_path / "amcl.csv"},
    )
    assert log.positions is not None
    assert np.allclose(log.positions.covariance, 0.04 * np.eye(2))
    assert np.allclose(log.positions.position_m, DRIVE.pose[:COUNT, :2])


def test_two_topics_in_a_file_and_no_quaternion(tmp_path: Path) -> None:
    names = ("header.stamp.sec", "header.stamp.nanosec", "position.x", "position.y")
    header = [f"{topic}/{name}" for topic in ("/a", "/b") for name in names]
    with pytest.raises(InputError, match=r"columns '/a/.*' and '/b/.*' both mean .*; export one t"):
        read(tmp_path, text([[0] * 8], header))
    rows = [[*row[:7], 0.0, 0.0, 0.0, 0.0, *row[11:]] for row in odometry()]
    with pytest.raises(
        InputError, match=r"odometry.csv:2: orientation is \(0, 0, 0, 0\), expected a"
    ):
        read(tmp_path, flattened(MESSAGES["nav_msgs/Odometry"], rows))


def test_a_line_without_names_is_a_message_by_the_kinds_of_its_words() -> None:
    line = [str(word) for word in odometry()[0]]
    assert message_of(line) == "nav_msgs/Odometry"
    assert message_of([*line[:4], "word", *line[5:]]) is None
    assert message_of(line[:-1]) is None
