"""Trajectories as single files: what is written is read again, damage is named."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.estimates.external import read_external
from comparisons.estimates.trajectory_files import (
    FORMATS,
    Trajectory,
    read_trajectory_file,
    write_trajectory,
)
from comparisons.logs.message_csv import MESSAGES
from tests.commands import refused, works
from tests.comparisons.logs.test_foreign_files import DRIVE
from tests.comparisons.logs.test_message_csv import TOOLS, Writer, odometry, stamps
from tests.helpers import present, random_covariance


@pytest.fixture
def trajectory() -> Trajectory:
    """Through several turns, at uneven times."""
    rng = np.random.default_rng(0)
    time_s = 1.7e9 + np.cumsum(rng.uniform(0.01, 1.0, 200))
    pose = np.cumsum(rng.standard_normal((200, 3)), axis=0)
    pose[:, 2] = np.cumsum(rng.uniform(-0.5, 0.7, 200))
    covariance = np.array([random_covariance(rng, 3) for _ in time_s])
    return Trajectory(time_s, pose, 0.5 * (covariance + covariance.transpose(0, 2, 1)))


def test_csv_holds_every_bit(tmp_path: Path, trajectory: Trajectory) -> None:
    write_trajectory(trajectory, tmp_path / "a", "csv")
    again = read_trajectory_file(tmp_path / "a")
    for before, after in zip(trajectory[:-1], again[:-1], strict=True):
        assert np.array_equal(before, after)  # type: ignore[arg-type]
    write_trajectory(again, tmp_path / "b", "csv")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("format_name", ["tum", "kitti"])
def test_the_others_hold_times_and_positions(
    tmp_path: Path, trajectory: Trajectory, format_name: str
) -> None:
    """To the bit; headings to rounding, up to whole turns in which the first may begin."""
    write_trajectory(trajectory, tmp_path / "a", format_name)
    again = read_trajectory_file(tmp_path / "a")
    assert np.array_equal(again.time_s, trajectory.time_s)
    assert np.array_equal(again.pose[:, :2], trajectory.pose[:, :2])
    turns = (again.pose[:, 2] - trajectory.pose[:, 2]) / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-14
    assert again.covariance is None


def test_a_wrong_order_of_the_matrix_is_seen(tmp_path: Path, trajectory: Trajectory) -> None:
    """Column by column in place of row by row: the test above must notice."""
    write_trajectory(trajectory, tmp_path / "a", "kitti")
    rows = np.loadtxt(tmp_path / "a").reshape(-1, 3, 4)
    swapped = np.concatenate((rows[:, :, :3].transpose(0, 2, 1), rows[:, :, 3:]), axis=2)
    np.savetxt(tmp_path / "a", swapped.reshape(-1, 12), fmt="%.17g")
    again = read_trajectory_file(tmp_path / "a")
    turns = (again.pose[:, 2] - trajectory.pose[:, 2]) / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() > 0.1


def in_camera(pose: Array) -> Array:
    """(K, 3, 4) of the camera's frame: x right, y down, z ahead."""
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    rotation = Rotation.from_euler("z", pose[:, 2:]).as_matrix()
    place = np.column_stack((pose[:, :2], np.zeros(len(pose)))) @ turn.T
    return np.concatenate((turn @ rotation @ turn.T, place[:, :, None]), axis=2)


@pytest.mark.parametrize("format_name", ["tum", "kitti"])
@pytest.mark.parametrize("turn_rad", [0.01, 0.5])
def test_the_frame_of_a_camera_is_named(tmp_path: Path, format_name: str, turn_rad: float) -> None:
    """A drive ahead with small headings, of which the way ahead would be lost, and with large."""
    pose = np.column_stack((np.arange(20.0), 0.05 * np.arange(20.0), np.full(20, turn_rad)))
    pose[:, :2] = pose[:, :2] @ Rotation.from_euler("z", turn_rad).as_matrix()[:2, :2].T
    matrix = in_camera(pose)
    if format_name == "kitti":
        np.savetxt(tmp_path / "a", matrix.reshape(-1, 12))
        np.savetxt(tmp_path / "times.txt", np.arange(20))
    else:
        quaternion = Rotation.from_matrix(matrix[:, :, :3]).as_quat()
        np.savetxt(tmp_path / "a", np.column_stack((np.arange(20), matrix[:, :, 3], quaternion)))
    with pytest.raises(InputError, match=r"a: 19 of 19.02 m lie along .* camera's frame"):
        read_trajectory_file(tmp_path / "a")
    trajectory = Trajectory(np.arange(20.0), pose)
    write_trajectory(trajectory, tmp_path / "right" / "b", format_name)
    assert np.allclose(read_trajectory_file(tmp_path / "right" / "b").pose, pose)


EUROC = "#timestamp, p_RS_R_x [m], ...\n" + "".join(
    f"{1403715524907143168 + 5_000_000 * k},{k},2,1,{w},0,0,{z},0.1,0.2\n"
    for k, (w, z) in enumerate(((1, 0), (np.cos(0.1), np.sin(0.1)), (np.cos(0.2), np.sin(0.2))))
)


def test_euroc_is_read(tmp_path: Path) -> None:
    """Nanoseconds, and quaternions w first; read as TUM's the headings would be others."""
    (tmp_path / "a.csv").write_text(EUROC)
    found = read_trajectory_file(tmp_path / "a.csv")
    assert np.allclose(found.pose, ((0, 2, 0), (1, 2, 0.2), (2, 2, 0.4)))
    assert np.allclose(found.time_s - 1403715524.907143168, (0.0, 0.005, 0.01), atol=1e-6)


NAMED = {
    "units": "x [cm],y [cm],stamp_ns,yaw_deg\n100,200,1500000000,90\n",
    "decimal commas": "time;x;y;theta [deg];comment\n1,5;1,0;2,0;90,0;none\n",
    "behind a mark": "# t,x,y,yaw_deg\n1.5,1,2,90\n",
}


@pytest.mark.parametrize("name", NAMED)
def test_columns_have_their_usual_names_and_units(tmp_path: Path, name: str) -> None:
    """Without the header's unit the heading would be 90 rad."""
    (tmp_path / "a").write_text(NAMED[name])
    found = read_trajectory_file(tmp_path / "a")
    assert found.time_s.tolist() == [1.5]
    assert found.pose == pytest.approx(np.array([[1.0, 2.0, np.pi / 2]]))
    bare = NAMED[name].replace("_deg", "").replace(" [deg]", "")
    (tmp_path / "a").write_text(bare)
    assert read_trajectory_file(tmp_path / "a").pose[0, 2] == 90.0


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.__name__)
def test_an_export_of_odometry_is_a_trajectory(tmp_path: Path, tool: Writer) -> None:
    """Its covariances, too, where they are not all zero."""
    rows = odometry()
    path = tmp_path / "odometry.csv"
    path.write_text(tool(MESSAGES["nav_msgs/Odometry"], rows))
    found = read_trajectory_file(path)
    assert found.time_s == pytest.approx([s + 1e-9 * ns for s, ns in stamps()], abs=1e-6)
    assert found.pose == pytest.approx(DRIVE.pose[: len(rows)], abs=1e-12)
    assert found.covariance is None
    at = 4 + 7  # behind stamp, frames and pose
    for row in rows:
        row[at : at + 36] = np.arange(36.0).tolist()
    path.write_text(tool(MESSAGES["nav_msgs/Odometry"], rows))
    covariance = read_trajectory_file(path).covariance
    assert present(covariance)[0].tolist() == [[0, 1, 5], [1, 7, 11], [5, 11, 35]]


def test_times_that_repeat_are_left_out(tmp_path: Path) -> None:
    rows = [(0, 1), (1, 2), (1, 3), (2, 4), (2, 5)]
    (tmp_path / "a").write_text("".join(f"{t} {x} 0 0 0 0 0 1\n" for t, x in rows))
    found = read_external(tmp_path / "a")
    assert found.pose[:, 0].tolist() == [1, 2, 4]
    assert found.left_out == (
        "2 of 5 poses of a repeat the time of the one before (first at 1.000000 s) and were left "
        "out"
    )
    said = works("export", "a", "b.csv", cwd=tmp_path)
    assert said == f"b.csv: 3 poses; {found.left_out}\n"


BAD = {
    "back in TUM": ("1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", None, "a:2: time 0.000000 s follows 1"),
    "commas": ("0,1,2\n", None, "a:1: no header, expected a line of names with commas"),
    "no times": (
        "1 0 0 0 0 1 0 0 0 0 1 0\n",
        None,
        "KITTI files have no times, expected times.txt",
    ),
    "few times": ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2, "0\n", "1 times, expected 2 as poses in"),
    "back": ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2, "1\n0\n", "times.txt:2: time 0.000000 s follows"),
    "camera": ("1 0 0 0 0 0 1 0 0 -1 0 0\n", "0\n", "a:1: r22 (of a pose in the plane x, y) is"),
    "scaled": ("2 0 0 0 0 2 0 0 0 0 1 0\n", "0\n", "a:1: rotation's norm is 2.0"),
    "far": ("1 0 0 1e11 0 1 0 0 0 0 1 0\n", "0\n", "a:1: x is 100000000000.0"),
    "csv header": ("time_s,x,y\n", None, "no column for heading_rad, expected one named heading"),
    "csv covariance": ("t,x,y,yaw,cov_00\n0,1,2,3,1\n", None, "a: no column for cov_01"),
    "csv unit": ("time_s,x,y,yaw\n1e12,1,2,3\n", None, "name the column 'time_ms' if that is"),
    "csv back": ("t,x,y,yaw\n1,1,2,3\n0,1,2,3\n", None, "a:3: time 0.000000 s follows 1"),
    "csv far": ("t,x,y,yaw\n\n1,1e11,2,3\n", None, "a:3: x_m is 100000000000.0"),
    "empty": ("time_s,x_m,y_m,heading_rad\n", None, "a: holds no poses"),
}


@pytest.mark.parametrize("name", BAD)
def test_damage_is_named(tmp_path: Path, name: str) -> None:
    text, times, message = BAD[name]
    (tmp_path / "a").write_text(text)
    if times is not None:
        (tmp_path / "times.txt").write_text(times)
    with pytest.raises(InputError) as caught:
        read_external(tmp_path / "a")
    assert message in str(caught.value)


def test_nothing_is_replaced(tmp_path: Path, trajectory: Trajectory) -> None:
    (tmp_path / "times.txt").write_text("somebody's")
    with pytest.raises(InputError, match=r"times\.txt: exists already"):
        write_trajectory(trajectory, tmp_path / "a", "kitti")
    assert not (tmp_path / "a").exists()
    with pytest.raises(InputError, match="is the name of the file of times"):
        write_trajectory(trajectory, tmp_path / "new" / "times.txt", "kitti")


@pytest.mark.slow
def test_the_commands(tmp_path: Path) -> None:
    """Every format says the same of an estimate; covariances of CSV are judged, too."""
    works("solve", "simulated-loop", "--out", "solved", cwd=tmp_path)
    for format_name in FORMATS:
        place = f"{format_name}/poses"
        printed = works("export", "solved/smoother", place, "--format", format_name, cwd=tmp_path)
        assert printed.startswith(f"{place}: ")
    for format_name in FORMATS:
        place = f"again/{format_name}/poses.{format_name}"
        works("export", "solved/smoother", place, cwd=tmp_path)
        assert (tmp_path / place).read_text() == (tmp_path / format_name / "poses").read_text()
    (tmp_path / "kitti" / "times.txt").rename(tmp_path / "clock")
    right = [
        (("csv/poses",), "no landmarks; compared"),
        (("kitti/poses", "--times", "clock"), "no pose covariances; compared"),
    ]
    for words, reported in right:
        done = works(
            "check", "simulated-loop", "--estimate", *words, "--out", "c", "--replace", cwd=tmp_path
        )
        assert reported in done
    wrong: list[tuple[tuple[str, ...], str]] = [
        (("export", "solved", "x.csv"), "is no estimate; give solved/smoother"),
        (("export", "csv/poses", "again/tum/poses.tum"), "exists already"),
        (("export", "csv/poses", "x", "--format", "xyz"), "format 'xyz' is unknown"),
        (("export", "csv/poses", "x"), "x: its suffix names no format, expected .tum"),
        (("export", "csv/poses", "x.tum", "--format", "csv"), "its suffix says tum, --format csv"),
        (("export", "csv/poses", "x.csv", "--times", "clock"), "--times is for KITTI"),
    ]
    for words, reported in wrong:
        assert reported in refused(*words, cwd=tmp_path)
