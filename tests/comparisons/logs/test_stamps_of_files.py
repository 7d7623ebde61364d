"""Times of text files: exact to the nanosecond, whichever file they stand in."""

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from comparisons.cli.new_log import _read_truth
from comparisons.errors import InputError
from comparisons.estimates.folder import read_trajectory
from comparisons.estimates.trajectory_files import read_trajectory_file
from comparisons.logs import stamps
from comparisons.logs.new_log import UserFiles, build
from comparisons.logs.plain_csv import PlainTable, read_plain
from comparisons.logs.stamps import after_ns, nanoseconds, seconds_after
from comparisons.logs.table import TextTable

START = 1_700_000_000
"""Seconds since 1970."""
OFFSETS = np.random.default_rng(78).integers(1, 10**9, 6).tolist()
"""Of the first stamps [ns]; as floats most lie before or after what the file says."""
SIGMAS = {"sigma_range_m": 0.1, "sigma_bearing_rad": 0.01, "sigma_speed_mps": 0.1}


def stamps_ns(offset_ns: int) -> list[int]:
    """Eleven stamps, 0.1 s apart."""
    return [START * 10**9 + offset_ns + k * 10**8 for k in range(11)]


def decimal(time_ns: int) -> str:
    """A stamp in seconds."""
    return f"{time_ns // 10**9}.{time_ns % 10**9:09d}"


def written(folder: Path, offset_ns: int, late: int = 0, tum: bool = False) -> UserFiles:
    """Files of a drive along x at 1 m/s from (3, 2), with truth; late: of truth, in samples."""
    times = stamps_ns(offset_ns)
    rows = [f"{t},1.0,0.0" for t in times]
    (folder / "odometry.csv").write_text("\n".join(["t_ns,v,w", *rows]) + "\n")
    rows = [f"{t},5.0,0.1,a" for t in times[:-1]]
    (folder / "trees.csv").write_text("\n".join(["t_ns,range,bearing,label", *rows]) + "\n")
    poses = [(t, 3.0 + 0.1 * k) for k, t in enumerate(times)][late:]
    truth = folder / "truth.tum"
    if tum:
        truth.write_text("".join(f"{decimal(t)} {x} 2 0 0 0 0 1\n" for t, x in poses))
    else:
        truth.write_text("\n".join(["t_ns,x,y,yaw", *(f"{t},{x},2,0" for t, x in poses)]) + "\n")
    return UserFiles(
        name="mine",
        paths={"odometry": folder / "odometry.csv", "measurements": folder / "trees.csv"},
        stated={**SIGMAS, "sigma_turn": 0.02},
        truth=partial(_read_truth, truth, {}, {}),
    )


@pytest.mark.parametrize("tum", [False, True])
@pytest.mark.parametrize("offset_ns", OFFSETS)
def test_a_start_at_the_first_true_pose_is_the_truth(
    offset_ns: int, tum: bool, tmp_path: Path
) -> None:
    """The first stamps of odometry and truth are the same number of nanoseconds."""
    log, remarks, notes = build(written(tmp_path, offset_ns, tum=tum))
    assert log.prior.pose.tolist() == [3.0, 2.0, 0.0]
    assert log.truth.poses is not None
    assert log.truth.poses.time_s.tolist() == log.odometry.time_s.tolist()
    assert "start: 3 m, 2 m, 0 rad (from truth)" in notes
    assert remarks["pose"].startswith("default: the true pose")


def test_truth_by_floats_would_miss_the_start(tmp_path: Path) -> None:
    """Read through a float, which has 0.24 us, and rounded to a microsecond."""

    def by_floats(read: Callable[[int], PlainTable], start_s: int) -> PlainTable:
        table = read(0)
        time_s = np.round(table.columns["time_s"] - start_s, 6)
        return replace(table, columns=table.columns | {"time_s": time_s})

    missed = 0
    for offset_ns in OFFSETS:
        files = written(tmp_path, offset_ns)
        assert files.truth is not None
        notes = build(replace(files, truth=partial(by_floats, files.truth))).notes
        missed += any("(origin, although truth begins" in note for note in notes)
    assert missed


def test_a_start_before_truth_is_said(tmp_path: Path) -> None:
    notes = build(written(tmp_path, 5, late=1)).notes
    said = "start: 0 m, 0 m, 0 rad (origin, although truth begins 0.1 s later; --prior-pose"
    assert any(note.startswith(said) for note in notes)


def test_a_start_between_true_poses_is_interpolated(tmp_path: Path) -> None:
    files = written(tmp_path, 7)
    rows = (tmp_path / "truth.tum").read_text().splitlines()
    rows[1] = f"{stamps_ns(7)[0] - 10**8},2.8,2,0"  # 0.1 s before, and none at the start
    rows[2:3] = [f"{stamps_ns(7)[0] + 10**8},3.2,2,0"]
    (tmp_path / "truth.tum").write_text("\n".join(rows) + "\n")
    assert build(files).log.prior.pose == pytest.approx([3.0, 2.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("offset_ns", OFFSETS)
def test_every_reader_of_trajectories_keeps_nanoseconds(offset_ns: int, tmp_path: Path) -> None:
    times = stamps_ns(offset_ns)
    path = tmp_path / "trajectory.tum"
    path.write_text("".join(f"{decimal(t)} {k} 0 0 0 0 0 1\n" for k, t in enumerate(times)))
    exact = read_trajectory_file(path).time_ns
    assert exact is not None
    assert exact.tolist() == times
    other = read_trajectory(path)[2]
    assert other is not None
    assert other.tolist() == times
    rows = [f"{t},{k},0,0,1,0,0,0" for k, t in enumerate(times)]
    (tmp_path / "euroc.csv").write_text("\n".join(["#t,x,y,z,qw,qx,qy,qz", *rows]) + "\n")
    rows = [f"{t},{k},0,0" for k, t in enumerate(times)]
    (tmp_path / "plain.csv").write_text("\n".join(["t_ns,x,y,yaw", *rows]) + "\n")
    (tmp_path / "times.txt").write_text("".join(f"{decimal(t)}\n" for t in times))
    rows = [f"1 0 0 {k} 0 1 0 0 0 0 1 0" for k in range(len(times))]
    (tmp_path / "kitti.txt").write_text("\n".join(rows) + "\n")
    for name in ("euroc.csv", "plain.csv", "kitti.txt"):
        found = read_trajectory_file(tmp_path / name).time_ns
        assert found is not None, name
        assert found.tolist() == times, name


def test_small_times_are_what_floats_have() -> None:
    """No second record of times is kept where float64 has nanoseconds."""
    assert stamps.resolved_by_floats(np.array([0.0, 1e6]))
    assert not stamps.resolved_by_floats(np.array([1.7e9]))
    assert stamps.resolved_by_floats(np.zeros(0))


def test_decimals_are_subtracted_before_they_are_rounded() -> None:
    words = ["1700000000.123456789", "1.700000001e9", " 1700000002 ".strip()]
    assert seconds_after(words, START).tolist() == [0.123456789, 1.0, 2.0]
    assert seconds_after(["1700000000123456789"], START, 10**9).tolist() == [0.123456789]
    exact = nanoseconds(words)
    assert exact is not None
    assert exact[0] == 1_700_000_000_123_456_789
    assert after_ns(exact, Decimal("1700000000.1"))[0] == 0.023456789
    assert nanoseconds(["1e10"]) is None


def test_decimals_of_a_table_are_as_written(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("# time x\n1700000000.123456789 1 # first\n\n1700000001 2\n")
    table = TextTable(tmp_path / "a.txt", ("time", "x"))
    assert table.decimals("time") == [Decimal("1700000000.123456789"), Decimal(1700000001)]


@pytest.mark.parametrize(
    ("sec", "nanosec"), [("1700000000", "5"), ("1700000000.0", "5.0"), ("1.7e9", "5")]
)
def test_seconds_and_nanoseconds_of_messages_are_both_read(
    sec: str, nanosec: str, tmp_path: Path
) -> None:
    """Whole numbers that a spreadsheet wrote with a point are read with their nanoseconds."""
    path = tmp_path / "odom.csv"
    path.write_text(f"header.stamp.sec,header.stamp.nanosec,v,w\n{sec},{nanosec},1,0\n")
    assert read_plain(path, ("time_s", "speed_mps"), start_s=START).columns["time_s"] == [5e-9]
    path.write_text("header.stamp.sec,header.stamp.nanosec,v,w\n1700000000,x,1,0\n")
    with pytest.raises(InputError, match=r"odom.csv:2: 'header.stamp.nanosec' is 'x', expected"):
        read_plain(path, ("time_s", "speed_mps"), start_s=START)
