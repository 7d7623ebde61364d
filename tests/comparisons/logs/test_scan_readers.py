"""Readers of raw scans on small files made here: the Victoria Park trio and CARMEN logs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from comparisons.adapters.tree_features import with_tree_features
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import (
    SIGMA_M_PER_SQRT_M,
    SIGMA_RAD_PER_SQRT_RAD,
    RelativePoses,
    SteeringOdometry,
    displacements,
    poses_at,
)
from comparisons.logs.readers import READERS, read_log
from tests.comparisons.logs.test_log_folder import assert_same
from tests.comparisons.logs.test_readers import assert_refused
from tests.helpers import present


def assert_survives_a_folder(log: Log, folder: Path) -> None:
    write_log_folder(log, folder)
    assert_same(read_log_folder(folder), replace(log, format="log-folder"))


NO_GPS: dict[str, object] = dict.fromkeys(("timeGps", "Lo_m", "La_m"))


def trio(folder: Path, **changes: object) -> Path:
    """Straight on at 1 m/s for 20 s; the GPS frame is turned by 40 degrees and shifted."""
    words = np.full((3, 361), 8191, dtype=np.uint16)
    words[:, 170:190] = 1000 + 3 * 8192
    words[1, 5] = 0
    along = np.arange(0.0, 20.0, 0.2)
    fixes = 100.0 + 50.0j + along * np.exp(1j * np.deg2rad(40.0))
    data: dict[str, object] = {
        "time": np.arange(21000, 41000, 25, dtype=np.int32)[:, None],
        "speed": np.ones((800, 1)),
        "steering": np.zeros((800, 1)),
        "TLsr": np.array([[22000, 22213, 22427]], dtype=np.int32),
        "LASER": words,
        "timeGps": (21000 + 1000 * along).astype(np.int32),
        "Lo_m": fixes.real,
        "La_m": fixes.imag,
        **changes,
    }
    for name, keys in (
        ("aa3_dr.mat", ("time", "speed", "steering")),
        ("aa3_lsr2.mat", ("TLsr", "LASER")),
        ("aa3_gpsx.mat", ("timeGps", "Lo_m", "La_m")),
    ):
        content = {key: data[key] for key in keys if data[key] is not None}
        if content:
            savemat(folder / name, content)
    return folder


def test_the_trio(tmp_path: Path) -> None:
    log = read_log(trio(tmp_path))
    assert log.format == "aa3"
    assert isinstance(log.odometry, SteeringOdometry)
    assert log.scans is not None
    assert log.positions is not None
    assert np.allclose(log.scans.time_s, (1.0, 1.213, 1.427))
    assert np.allclose(np.rad2deg(log.scans.angle_rad[[0, 180, 181, 360]]), (-90, 0, 0.5, 90))
    assert np.allclose(log.scans.range_m[:, 170:190], 10.0)
    assert np.isnan(log.scans.range_m[1, [5, 6, 300]]).all()
    assert log.scans.intensity[0, [170, 0]].tolist() == [3.0, 0.0]
    assert not len(log.measurements.time_s)
    assert (log.prior.time_s, log.prior.pose.tolist()) == (0.0, [0.0, 0.0, 0.0])
    # Along the vehicle's first heading, one metre per second from its start.
    expected = np.column_stack((log.positions.time_s, np.zeros(100)))
    assert np.allclose(log.positions.position_m, expected, atol=1e-9)
    assert_survives_a_folder(log, tmp_path / "again")


def test_the_trio_without_gps(tmp_path: Path) -> None:
    log = read_log(trio(tmp_path, **NO_GPS))
    assert log.positions is None
    assert log.prior.time_s == 0.0


def test_trunks_are_found_in_the_trio(tmp_path: Path) -> None:
    """A trunk of 0.5 m, 10 m ahead, is seen by every scan while the vehicle stands."""
    words = np.full((30, 361), 8191, dtype=np.uint16)
    words[:, 178:183] = 1000
    times = (22000 + 214 * np.arange(30)).astype(np.int32)
    log = read_log(trio(tmp_path, speed=np.zeros(800), TLsr=times, LASER=words, **NO_GPS))
    found = with_tree_features(log).measurements
    assert len(found.time_s) > 10
    assert np.allclose(found.range_m, 10.2, atol=0.2)
    assert np.allclose(found.bearing_rad, 0.0, atol=0.01)


def test_which_folder_is_which(shared_data: Path) -> None:
    """Detections come first where both are there; a trio without its laser says so."""
    real = shared_data / "victoria_park"
    assert next(n for n, r in READERS.items() if r.recognises(real)) == "victoria-park"
    with pytest.raises(InputError, match=r"aa3_lsr2\.mat: no such file"):
        read_log(real, "aa3")


def test_the_real_gps_lies_on_the_real_start(tmp_path: Path, shared_data: Path) -> None:
    """The frame agrees with the hand-made one of gps.dat to 4 degrees and 3 m."""
    real = shared_data / "victoria_park"
    trio(tmp_path)
    for name in ("aa3_dr.mat", "aa3_gpsx.mat"):
        (tmp_path / name).unlink()
        (tmp_path / name).symlink_to(real / name)
    log, given = read_log(tmp_path), read_log(real)
    assert log.positions is not None
    assert given.positions is not None
    assert np.allclose(log.positions.time_s, given.positions.time_s)
    assert np.allclose(log.odometry.time_s, given.odometry.time_s, atol=2e-3)
    ours = log.positions.position_m @ np.array([1.0, 1j])
    theirs = given.positions.position_m @ np.array([1.0, 1j])
    turn = np.angle(np.vdot(ours - ours[0], theirs - theirs[0]))
    assert abs(np.rad2deg(turn)) < 4.0
    assert abs(ours[0] - theirs[0]) < 3.0


BAD_TRIOS: dict[str, tuple[dict[str, object], str]] = {
    "shape": ({"LASER": np.ones((3, 360))}, "aa3_lsr2.mat: LASER has shape (3, 360), expected (N,"),
    "fraction": (
        {"LASER": np.full((3, 361), 0.5)},
        "aa3_lsr2.mat: LASER, row 0: beam 0 is 0.5, expected a whole number below 65536",
    ),
    "scans": ({"LASER": np.ones((2, 361))}, "aa3_lsr2.mat: scans: range_m has shape (2, 361)"),
    "variable": ({"TLsr": None}, "aa3_lsr2.mat: no variable TLsr, expected TLsr, LASER"),
    "backwards": (
        {"TLsr": [3.0, 2.0, 4.0]},
        "aa3_lsr2.mat: scans, row 1: time -0.001000 s follows",
    ),
    "nan": ({"speed": np.full(800, np.nan)}, "aa3_dr.mat: speed holds a value that is not a"),
    "lengths": ({"speed": np.ones(7)}, "aa3_dr.mat: steering odometry: speed_mps has shape (7,)"),
    "gps": ({"La_m": np.ones(7)}, "aa3_gpsx.mat: timeGps, Lo_m and La_m differ in length"),
    "still": (
        {"speed": np.zeros(800)},
        "aa3_gpsx.mat: positions: the first 11 s do not determine the",
    ),
    "empty": ({"TLsr": np.zeros((0, 0))}, "aa3_lsr2.mat: holds no records"),
}


@pytest.mark.parametrize("name", BAD_TRIOS)
def test_damaged_trios(name: str, tmp_path: Path) -> None:
    changes, message = BAD_TRIOS[name]
    assert_refused(trio(tmp_path, **changes), message)


def flaser(
    time: float | str,
    x: float,
    heading: float = 0.0,
    laser: float = 0.2,
    beams: int = 180,
    logger: float | str = 0.1,
) -> str:
    """The laser `laser` metres ahead of the robot."""
    ranges = " ".join(["2.50", "0.0", "81.91", *["3.00"] * (beams - 3)])
    ahead = f"{x + laser * np.cos(heading):.6f} {laser * np.sin(heading):.6f}"
    return (
        f"FLASER {beams} {ranges} {ahead} {heading:.6f} {x:.6f} 0.0 {heading:.6f} {time} "
        f"host {logger}\n"
    )


def robotlaser(time: float, x: float, maximum: float = 50.0) -> str:
    """Three beams from -0.5 to 0.5 rad, with remissions."""
    return (
        f"ROBOTLASER1 0 -0.5 1.0 0.5 {maximum} 0.01 1 3 2.0 49.0 50.0 3 7 8 9 "
        f"{x + 0.1} 0.3 1.0 {x} 0.0 0.0 0.5 0.0 0.3 0.3 0.0 {time} host {time}\n"
    )


CARMEN = (
    "# a log\nPARAM robot_front_laser_max 81.0 host 0\nODOM 0 0 0 0 0 0 100.0 host 0\n"
    + flaser(100.0, 0.0)
    + "RLASER 180 1.0 2.0\nSOMETHING else\n"
    + flaser(100.2, 0.5)
    + flaser(100.2, 0.5)
    + flaser(100.4, 1.0, 0.3)
)


def carmen(folder: Path, text: str = CARMEN) -> Path:
    path = folder / "drive.clf"
    path.write_text(text)
    return path


def displacement(log: Log) -> np.ndarray:
    assert isinstance(log.odometry, RelativePoses)
    return log.odometry.displacement


def test_carmen(tmp_path: Path) -> None:
    log = read_log(carmen(tmp_path))
    assert (log.name, log.format) == ("drive", "carmen")
    assert log.scans is not None
    assert np.allclose(log.scans.time_s, (0.0, 0.2, 0.4))
    assert np.allclose(np.rad2deg(log.scans.angle_rad[[0, 90, 179]]), (-90.0, 0.0, 89.0))
    assert np.array_equal(log.scans.range_m[0, :4], (2.5, np.nan, np.nan, 3.0), equal_nan=True)
    assert np.allclose((log.scans.mount.forward_m, log.scans.mount.left_m), (0.2, 0.0), atol=1e-6)
    assert np.allclose(displacement(log), ((0.5, 0, 0), (0.5, 0, 0.3)))
    assert np.allclose(log.odometry.time_s, log.scans.time_s[1:])
    assert log.provenance["left_out"].startswith("1 repeated scans")
    assert log.provenance["lines_passed_over"] == "1 RLASER, 1 unknown"
    assert_survives_a_folder(log, tmp_path / "again")


def test_carmen_with_configured_lasers(tmp_path: Path) -> None:
    """They come before FLASER lines, which some logs hold beside them."""
    text = flaser(0.0, 0.0) + robotlaser(10.0, 0.0) + robotlaser(10.5, 1.0)
    log = read_log(carmen(tmp_path, text))
    assert log.scans is not None
    assert log.scans.angle_rad.tolist() == [-0.5, 0.0, 0.5]
    assert np.array_equal(log.scans.range_m[0], (2.0, 49.0, np.nan), equal_nan=True)
    assert log.scans.intensity[1].tolist() == [7.0, 8.0, 9.0]
    mount = log.scans.mount
    assert np.allclose((mount.forward_m, mount.left_m, mount.heading_rad), (0.1, 0.3, 1.0))
    assert log.provenance["lines_passed_over"] == "1 FLASER"
    assert_survives_a_folder(log, tmp_path / "again")


def test_carmen_takes_odometry_lines_where_scans_carry_no_pose(tmp_path: Path) -> None:
    odometry = "".join(f"ODOM {t} 0 {3 + t} 0 0 0 {t}.0 host 0\n" for t in range(4))
    scans = "".join(flaser(t, 0.0) for t in (0.5, 2.5, 9.0))
    log = read_log(carmen(tmp_path, odometry + scans))
    # 2 m along x, seen from a heading of 3.5 rad, the turn the short way round.
    assert np.allclose(displacement(log)[0, :2], (2 * np.cos(3.5), -2 * np.sin(3.5)))
    assert np.isclose(displacement(log)[0, 2], 2.0)
    assert log.provenance["left_out"] == "0 repeated scans, 1 outside the odometry"
    assert present(log.scans).time_s.tolist() == [0.0, 2.0]


SIX = "1.13486e+09"


def steps(log: Log) -> list[float]:
    return [round(float(step), 6) for step in np.diff(present(log.scans).time_s)]


def test_carmen_times_of_six_digits(tmp_path: Path) -> None:
    """The logger's then, or the order of lines where these are as coarse; no scan is lost."""
    text = "".join(flaser(SIX, 0.5 * i, logger=3.0 + 0.2 * i) for i in range(4))
    log = read_log(carmen(tmp_path, text))
    assert steps(log) == [0.2, 0.2, 0.2]
    assert log.provenance["times"] == "the logger's, since IPC's repeat in 100 % of the scans"
    log = read_log(carmen(tmp_path, "".join(flaser(SIX, 0.5 * i, logger=SIX) for i in range(4))))
    assert steps(log) == [1.0, 1.0, 1.0]
    assert log.provenance["times"].startswith("scan numbers in place of seconds, since IPC's")
    assert np.allclose(displacement(log)[:, 0], 0.5)
    # A line without the logger's time, too.
    bare = "".join(flaser(SIX, 0.5 * i).rsplit(" ", 2)[0] + "\n" for i in range(4))
    assert steps(read_log(carmen(tmp_path, bare))) == [1.0, 1.0, 1.0]


def test_carmen_lines_out_of_order(tmp_path: Path) -> None:
    """By milliseconds: sorted, each with its pose. By more: the logger's times, or file order."""
    times = (100.0, 100.2, 100.197, 100.4)
    text = "".join(flaser(t, 10 * (t - 100), logger=i) for i, t in enumerate(times))
    log = read_log(carmen(tmp_path, text))
    assert steps(log) == [0.197, 0.003, 0.2]
    assert log.provenance["sorted"].startswith("1 FLASER lines")
    assert np.allclose(displacement(log)[:, 0], (1.97, 0.03, 2.0))
    log = read_log(carmen(tmp_path, text.replace("100.197", "99.9")))
    assert steps(log) == [1.0, 1.0, 1.0]
    assert log.provenance["times"] == "the logger's, since IPC's fall back by 0.3 s in line 3"
    fallen = text.replace("100.197", "99.9").replace("host 3", "host 0.5")
    log = read_log(carmen(tmp_path, fallen))
    assert steps(log) == [1.0, 1.0, 1.0]
    assert log.provenance["times"] == (
        "scan numbers in place of seconds, since IPC's fall back by 0.3 s in line 3; the "
        "logger's do so, too"
    )
    assert isinstance(log.odometry, RelativePoses)
    assert np.allclose(log.odometry.displacement[:, 0], (2.0, -0.03, 2.03))  # as the lines stand


def test_carmen_odometry_lines_without_times(tmp_path: Path) -> None:
    """Where a clock falls back they lie between the scans as in the file; sorted, they do not."""
    moving = [f"ODOM {x} 0 0 0 0 0 {t} host {t}\n" for x, t in ((0, 5.0), (1, 9.0), (2, 6.0))]
    scans = [flaser(t, 0.0, logger=t) for t in (5.1, 9.1, 6.1)]
    text = "".join(line for pair in zip(moving, scans, strict=True) for line in pair)
    log = read_log(carmen(tmp_path, text + "ODOM 3 0 0 0 0 0 6.5 host 6.5\n"))
    assert isinstance(log.odometry, RelativePoses)
    assert np.allclose(log.odometry.displacement, ((1, 0, 0),) * 2)


def test_carmen_as_gmapping_writes(tmp_path: Path) -> None:
    """ODOM lines of time 0 after each FLASER line: without effect, but told."""
    zero = "ODOM 7 7 0 0 0 0 0 host 0\n"
    timed = "ODOM 0 0 0 0 0 0 100.0 host 0\n"
    text = timed + "".join(flaser(100 + 0.2 * i, 0.5 * i) + zero for i in range(4))
    log = read_log(carmen(tmp_path, text))
    assert np.allclose(displacement(log), ((0.5, 0, 0),) * 3)
    assert "gmapping writes ODOM lines of time 0" in log.provenance["odometry"]
    # Where ODOM lines do move it, those of time 0 would have it start elsewhere.
    still = "".join(
        flaser(100 + i, 0.0) + f"ODOM {i} 0 0 0 0 0 {100 + i} host 0\n" + zero for i in range(4)
    )
    log = read_log(carmen(tmp_path, still))
    assert np.allclose(displacement(log), ((1, 0, 0),) * 3)


def test_carmen_odometry_lines_out_of_order(tmp_path: Path) -> None:
    lines = [f"ODOM {x} 0 0 0 0 0 {100 + x} host 0\n" for x in (0.0, 0.5, 1.0, 0.98, 2.0)]
    text = "".join(lines) + flaser(100.99, 0.0) + flaser(101.5, 0.0)
    log = read_log(carmen(tmp_path, text))
    assert np.allclose(displacement(log), ((0.51, 0, 0),))


def test_carmen_with_a_stated_resolution(tmp_path: Path) -> None:
    text = "PARAM laser_front_laser_resolution 0.25 host 0\n" + flaser(0.0, 0.0, beams=401)
    log = read_log(carmen(tmp_path, text))
    assert log.scans is not None
    assert np.allclose(np.rad2deg(log.scans.angle_rad[[0, 200, 400]]), (-50.0, 0.0, 50.0))
    assert log.scans.range_m[0, 2] != log.scans.range_m[0, 2]


ROBOT = robotlaser(1.0, 0.0)
BAD_CARMEN = {
    "count": (
        CARMEN.replace("FLASER 180", "FLASER 1000000000"),
        ":4: num_readings is '1000000000'",
    ),
    "short": (CARMEN.replace("FLASER 180", "FLASER 179", 1), ":4: 191 words, expected 188 to 190"),
    "beams": (
        flaser(0.0, 0.0, beams=90),
        ":1: num_readings is 90, expected 180, 181, 360, 361, or",
    ),
    "change": (
        flaser(0.0, 0.0) + flaser(1.0, 0.0, beams=361),
        ":2: 361 beams from -1.571 to 1.571 rad, expected 180 from -1.571 to 1.553 as in line 1, "
        "or some of them in a row",
    ),
    "mount": (
        CARMEN + flaser(101.0, 2.0, laser=0.5),
        ":10: the laser's pose is 0.5 m forward, 0 m left, 0 rad of the robot's, expected 0.2",
    ),
    "nan": (CARMEN.replace("2.50", "nan"), ":4: range is 'nan', expected a finite number"),
    "word": (CARMEN.replace("2.50", "oops"), ":4: range is 'oops', expected a finite number"),
    "negative": (CARMEN.replace("2.50", "-1"), ":4: range is -1, expected 0 or more"),
    "huge": (CARMEN.replace("2.50", "1e300"), ":4: range is 1e+300, expected at most 1e+10"),
    "odometry": (
        flaser(1.0, 0.0) + "ODOM 0 0 0 0 0 0 2.0 host 0\nODOM 0 0 0 0 0 0 1.0 host 0\n",
        ":3: time 1.000000 s follows 2.000000 s, expected times to increase but for 0.1 s",
    ),
    "no times": (
        "".join(flaser(SIX, 0.0, logger=SIX) for _ in range(4)) + "ODOM 0 0 0 0 0 0 1 host 0\n",
        "no FLASER line lies within the time of the ODOM lines",
    ),
    "no odometry's": (
        "".join(flaser(100.0 + t, 0.0) for t in range(4)) + "ODOM 0 0 0 0 0 0 0 host 0\n" * 2,
        "no ODOM line has a time (IPC's), expected some",
    ),
    "parameter": (
        CARMEN.replace("max 81.0", "max 0"),
        ":2: robot_front_laser_max is 0, expected ab",
    ),
    "no scan": ("# nothing\nODOM 0 0 0 0 0 0 1.0 host 0\n", "expected at least one FLASER or"),
    "empty": ("", "expected at least one FLASER or ROBOTLASER1 line"),
    "remissions": (ROBOT.replace("3 7 8 9", "2 7 8"), ":1: num_remissions is 2, expected 0 or 3"),
    "view": (
        ROBOT.replace("-0.5 1.0", "-0.5 3.0"),
        ":1: field_of_view is 3, expected 3 beams times",
    ),
    "step": (ROBOT.replace("1.0 0.5 50", "1.0 0.0 50"), ":1: angular_resolution is 0, expected ab"),
    "turn": (ROBOT.replace("-0.5 1.0", "-500 1.0"), ":1: start_angle is -500 and field_of_view 1"),
    "cut": (ROBOT[:40], ":1: num_readings is '3', expected a whole number from 1 on, with"),
}


@pytest.mark.parametrize("name", BAD_CARMEN)
def test_damaged_carmen(name: str, tmp_path: Path) -> None:
    text, message = BAD_CARMEN[name]
    assert_refused(carmen(tmp_path, text), message, "carmen")


def test_stated_noise_does_not_depend_on_the_rate_of_scans() -> None:
    """The variances of a way and of a turn add up to the same, however they are cut."""
    total = []
    for count in (2, 11):
        way = np.column_stack((np.linspace(0, 4, count), np.zeros(count), np.linspace(0, 1, count)))
        covariance = displacements(np.arange(float(count)), way).covariance
        total.append(np.trace(covariance.sum(axis=0)))
    assert np.isclose(total[0], total[1], rtol=1e-2)
    straight = displacements(np.arange(2.0), np.array(((0.0, 0, 0), (1, 0, 0)))).covariance[0]
    assert np.isclose(np.sqrt(straight[0, 0]), SIGMA_M_PER_SQRT_M, rtol=1e-3)
    turned = displacements(np.arange(2.0), np.array(((0.0, 0, 0), (0, 0, 1)))).covariance[0]
    assert np.isclose(np.sqrt(turned[2, 2]), SIGMA_RAD_PER_SQRT_RAD, rtol=1e-3)


def test_displacements_compose_to_the_poses() -> None:
    rng = np.random.default_rng(3)
    pose = np.cumsum(rng.normal(size=(20, 3)), axis=0)
    at, heading = pose[0, 0] + 1j * pose[0, 1], pose[0, 2]
    for dx, dy, turn in displacements(np.arange(20.0), pose).displacement:
        at, heading = at + (dx + 1j * dy) * np.exp(1j * heading), heading + turn
    assert np.isclose(at, pose[-1, 0] + 1j * pose[-1, 1])
    assert np.isclose(np.exp(1j * heading), np.exp(1j * pose[-1, 2]))


def test_headings_are_interpolated_the_short_way_round() -> None:
    found = poses_at(np.array([0.5]), np.arange(2.0), np.array(((0.0, 0, 3.1), (2, 4, -3.1))))
    assert np.allclose(found, (1.0, 2.0, np.pi))
