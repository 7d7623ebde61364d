"""A log of a user's CSV files and arrays: what is read, what is refused, and the way to a run."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.motion import check_regular, with_regular_motion
from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.logs.column_names import parted
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder
from comparisons.logs.new_log import UserFiles, build
from comparisons.logs.odometry import RelativePoses, SteeringOdometry, VelocityOdometry
from comparisons.logs.readers import read_log
from tests.commands import slamcheck

VELOCITY = "omega,t,v\n0.1,0.0,1.0\n0.1,0.5,1.0\n0.1,1.0,1.0\n"
TREES = "label,range,bearing,time,note\ntree_7,5,0.5,0.2,a\n,4,0.1,0.2,b\ntree_2,3,-0.5,0.7,c\n"
SIGMAS = {"sigma_range_m": 0.1, "sigma_bearing_rad": 0.01}
WHEELS = {"sigma_speed_mps": 0.1, "sigma_turn": 0.02}


def files(folder: Path, odometry: str = VELOCITY, trees: str = TREES, **more: Any) -> UserFiles:
    (folder / "odo.csv").write_text(odometry)
    (folder / "trees.csv").write_text(trees)
    paths = {"odometry": folder / "odo.csv", "measurements": folder / "trees.csv"}
    return UserFiles(
        name="mine",
        paths=paths | more.pop("paths", {}),
        stated=more.pop("stated", SIGMAS | WHEELS),
        **more,
    )


def test_columns_in_any_order_and_text_labels(tmp_path: Path) -> None:
    log, _, notes = build(files(tmp_path))
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.yaw_rate_radps.tolist() == [0.1, 0.1, 0.1]
    assert log.measurements.landmark.tolist() == [0, -1, 1]
    assert json.loads(log.provenance["labels"]) == {"tree_7": 0, "tree_2": 1}
    assert log.measurements.sigma_range_m.tolist() == [0.1, 0.1, 0.1]
    assert (log.prior.time_s, log.prior.pose.tolist()) == (0.0, [0.0, 0.0, 0.0])
    assert any(note.endswith("not used: note") for note in notes)


def test_unused_columns_that_differ_in_a_number_are_named_as_one(tmp_path: Path) -> None:
    """A covariance of 36 numbers would hide the columns that were read."""
    names = ",".join(f"cov{k}" for k in range(2, 35))
    wide = f"t,v,w,{names},x1,x2\n0,1,0{',0' * 35}\n1,1,0{',0' * 35}\n"
    notes = build(files(tmp_path, wide)).notes
    assert any(note.endswith("not used: cov2 to cov34 (33), x1, x2") for note in notes)


def test_decimal_commas_beside_other_separators(tmp_path: Path) -> None:
    """Of a column without points: where both stand, one of them is not for decimals."""
    log = build(files(tmp_path, "time_s;v_kmh;omega [deg/s]\n0;3,6;1\n1,5;7,2;1\n")).log
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.speed_mps.tolist() == [1.0, 2.0]
    assert log.odometry.time_s.tolist() == [0.0, 1.5]
    for rows in ("0;1.003,6;1", "0;1,000;1\n1;1.5;1"):
        with pytest.raises(InputError, match=r"odo.csv:2: 'v' is '1.*', expected a finite number"):
            build(files(tmp_path, f"t;v;w\n{rows}\n"))


def test_names_of_mrclam_are_known(tmp_path: Path) -> None:
    drive = "time,forward_velocity,angular_velocity\n0,1,0.1\n1,2,0.1\n"
    log = build(files(tmp_path, drive, "time,subject_nb,range,bearing\n0.1,27,5,0\n")).log
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.yaw_rate_radps.tolist() == [0.1, 0.1]
    assert log.measurements.landmark.tolist() == [27]


def test_repeated_records_are_no_further_information(tmp_path: Path) -> None:
    trees = "id,range,bearing,t\n1,5,0,0.1\n1,5,0,0.1\n1,5,0.01,0.1\n"
    log, _, notes = build(files(tmp_path, trees=trees))
    assert log.measurements.bearing_rad.tolist() == [0.0, 0.01]
    assert "left out: 1 of 3 measurements, repeated (first at line 3)" in notes
    (tmp_path / "gps.csv").write_text("t,x,y\n0,1,2\n0,1,2\n1,2,2\n")
    stated = SIGMAS | WHEELS | {"sigma_m": 0.5}
    positions = build(
        files(tmp_path, stated=stated, paths={"positions": tmp_path / "gps.csv"})
    ).log.positions
    assert positions is not None
    assert positions.time_s.tolist() == [0.0, 1.0]


def test_words_for_unknown_and_commas_at_the_end(tmp_path: Path) -> None:
    trees = "id,range,bearing,t\nNA,5,0,0.1,\nUnknown,5,1,0.1,,\noak,4,0,0.2\n"
    log = build(files(tmp_path, trees=trees)).log
    assert log.measurements.landmark.tolist() == [-1, -1, 0]


@pytest.mark.parametrize(
    ("header", "parts"),
    [
        ("Yaw Rate _ [ deg/s ]", ("yaw_rate", "deg/s")),
        ("range_m", ("range_m", None)),
        ("range (m)", ("range", "m")),
        ("[m]", ("", "m")),
        ("speed [", ("speed_[", None)),
        ("a (b) [m]", ("a", "b) [m")),
        ("omega [" + " " * 200_000 + "x", ("omega_[" + "_" * 200_000 + "x", None)),
        ("a" + " _" * 100_000 + "[m]", ("a", "m")),
    ],
)
def test_a_header_is_a_name_and_a_unit_however_long(
    header: str, parts: tuple[str, str | None]
) -> None:
    """A pattern that goes back over blanks would take years for the last two."""
    assert parted(header) == parts


def test_a_header_behind_a_hash_as_numpy_writes_it(tmp_path: Path) -> None:
    log = build(files(tmp_path, "# t,v,w\n0,1,0.1\n1,2,0.1\n")).log
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.speed_mps.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_units_by_header(delimiter: str, tmp_path: Path) -> None:
    odometry = (
        "v_kmh,omega [deg/s],stamp_ns\n"
        "3.6,90,1700000000000000000\n3.6,90,1700000000500000001\n3.6,90,1700000001000000000\n"
    ).replace(",", delimiter)
    trees = "id,bearing_deg,distance [mm],t_ms\n3,-90,2500,1700000000250\n"
    log = build(files(tmp_path, odometry, trees)).log
    assert isinstance(log.odometry, VelocityOdometry)
    assert np.allclose(log.odometry.speed_mps, 1.0)
    assert np.allclose(log.odometry.yaw_rate_radps, np.pi / 2)
    assert log.odometry.time_s.tolist() == [0.0, 0.500000001, 1.0]
    assert log.measurements.time_s.tolist() == [0.25]
    assert log.provenance["time_origin_s"] == "1700000000"
    assert np.allclose(
        (log.measurements.range_m, log.measurements.bearing_rad), [[2.5], [-np.pi / 2]]
    )
    assert log.measurements.landmark.tolist() == [3]
    assert "labels" not in log.provenance


def test_units_by_option_are_of_one_column_and_its_sigma(tmp_path: Path) -> None:
    """A yaw rate in rad/s stays one, beside bearings in degrees."""
    trees = "id,bearing,range,t\n3,45,2,0.5\n"
    with pytest.raises(InputError, match=r"'bearing' is 45 in radians, .* give --unit bearing=deg"):
        build(files(tmp_path, trees=trees))
    stated = SIGMAS | WHEELS | {"sigma_bearing_rad": "1deg", "sigma_range_m": "5cm"}
    log, _, notes = build(files(tmp_path, trees=trees, units={"bearing": "deg"}, stated=stated))
    assert np.allclose(log.measurements.bearing_rad, np.pi / 4)
    assert np.allclose(log.measurements.sigma_bearing_rad, np.deg2rad(1.0))
    assert np.allclose(log.measurements.sigma_range_m, 0.05)
    assert "bearing_rad from 'bearing' in deg by --unit (0.7854 to 0.7854)" in " ".join(notes)
    assert isinstance(log.odometry, VelocityOdometry)
    assert np.allclose(log.odometry.yaw_rate_radps, 0.1)


def test_the_unit_of_a_sigma_is_its_own(tmp_path: Path) -> None:
    """Never that of its column: said where that is another, refused in a file."""
    trees = "id,bearing_deg,range,t\n3,45,2,0.5\n"
    stated: dict[str, Any] = SIGMAS | WHEELS | {"sigma_bearing_rad": "0.02"}
    log, _, notes = build(files(tmp_path, trees=trees, stated=stated))
    assert log.measurements.sigma_bearing_rad.tolist() == [0.02]
    said = "--sigma-bearing 0.02 is 0.02 rad, though 'bearing_deg' is in deg: a sigma without a"
    assert any(note.startswith(said) for note in notes)
    sigmas = "id,bearing_deg,sigma_bearing,range,t\n3,45,2,2,0.5\n"
    stated = WHEELS | {"sigma_range_m": 0.1}
    match = r"'sigma_bearing' names no unit beside 'bearing_deg' in deg, .* sigma_bearing_deg, or"
    with pytest.raises(InputError, match=match):
        build(files(tmp_path, trees=sigmas, stated=stated))
    for trees, units in (
        (sigmas, {"sigma_bearing": "deg"}), (sigmas.replace("bearing,r", "bearing_deg,r"), {}),
    ):  # fmt: skip
        found = build(files(tmp_path, trees=trees, stated=stated, units=units)).log
        assert np.allclose(found.measurements.sigma_bearing_rad, np.deg2rad(2.0))


@pytest.mark.parametrize("sigma", ["1.5deg", "1.5dps", "1.5deg/s", "1.5 degrees/s", "0.0261799"])
def test_a_sigma_of_rates_may_be_an_angle_a_second(sigma: str, tmp_path: Path) -> None:
    stated = SIGMAS | {"sigma_speed_mps": 0.1, "sigma_turn": sigma}
    odometry = VELOCITY.replace("omega", "gyro_z [dps]")
    log = build(files(tmp_path, odometry, stated=stated)).log
    assert isinstance(log.odometry, VelocityOdometry)
    assert np.isclose(log.odometry.noise.sigma_turn, np.deg2rad(1.5))


@pytest.mark.parametrize(
    ("units", "stated", "message"),
    [
        ({"bearings": "deg"}, {}, "--unit bearings=deg: no file has such a column that is read"),
        ({"bearing": "gon"}, {}, "--unit bearing=gon: the unit is unknown, expected rad, deg"),
        ({"range_m": "mm"}, {}, "--unit range_m=mm: 'range_m' of .* says m, expected the same"),
        ({"odometry:bearing": "deg"}, {}, "no file has such a column"),
        ({}, {"sigma_turn": "1m"}, "--sigma-turn is '1m', expected a number, .* radps, rad/s"),
        ({}, {"sigma_range_m": "x"}, "--sigma-range is 'x', expected a number, or one with a unit"),
    ],
)
def test_units_refused(
    units: dict[str, str], stated: dict[str, str], message: str, tmp_path: Path
) -> None:
    trees = "id,bearing,range_m,t\n3,1,2,0.5\n"
    with pytest.raises(InputError, match=message):
        build(files(tmp_path, trees=trees, units=units, stated=SIGMAS | WHEELS | stated))


EPOCH = 1_700_000_000


@pytest.mark.parametrize(
    ("times", "unit"),
    [
        ([f"{EPOCH + k}.25" for k in range(3)], ""),
        ([f"{EPOCH + k}250" for k in range(3)], " in ms, by their size"),
        ([f"{EPOCH + k}250000" for k in range(3)], " in us, by their size"),
        ([f"{EPOCH + k}250000000" for k in range(3)], " in ns, by their size"),
        ([f"2023-11-14T22:13:{20 + k}.25Z" for k in range(3)], " in ISO 8601"),
        ([f"2023-11-14 23:13:{20 + k}.250000000+01:00" for k in range(3)], " in ISO 8601"),
        ([f"2023-11-14 22:13:{20 + k},25" for k in range(3)], " in ISO 8601"),
    ],
)
def test_times_say_by_their_form_what_they_are(times: list[str], unit: str, tmp_path: Path) -> None:
    odometry = "t;v;w\n" + "".join(f"{one};1;0.1\n" for one in times)
    log, _, notes = build(files(tmp_path, odometry, f"id;range;bearing;t\n1;5;0;{times[1]}\n"))
    assert log.odometry.time_s.tolist() == [k + 0.25 for k in range(3)]
    assert f"time_s from 't'{unit} (" in notes[0]


def test_times_are_refused_that_are_no_dates(tmp_path: Path) -> None:
    odometry = "t,v,w\n2023-11-14T22:13:20Z,1,0\n2023-13-14T22:13:20Z,1,0\n"
    with pytest.raises(InputError, match=r"odo.csv:3: '2023-13-14T22:13:20Z' is no date, expected"):
        build(files(tmp_path, odometry))


def test_steering_needs_a_wheelbase(tmp_path: Path) -> None:
    odometry = "t,v,steering\n0,1,0.1\n1,1,0.1\n"
    with pytest.raises(InputError, match="--wheelbase is missing"):
        build(files(tmp_path, odometry))
    given = files(tmp_path, odometry, stated=SIGMAS | WHEELS | {"wheelbase_m": 2.5})
    log = build(given).log
    assert isinstance(log.odometry, SteeringOdometry)
    assert log.odometry.vehicle.wheelbase_m == 2.5


POSES = "t,x,y,yaw\n" + "".join(
    f"{0.1 * k:.1f},{0.1 * k:.1f},0,{0.02 * k:.2f}\n" for k in range(21)
)


def test_poses_become_motions(tmp_path: Path) -> None:
    """With a pose wherever something is measured; the variance goes with the share of a motion."""
    trees = "id,bearing,range,t\n3,0.1,2,0.25\n3,0.1,2,1.0\n3,0.1,2,9.0\n"
    log, _, notes = build(files(tmp_path, POSES, trees, stated=SIGMAS))
    assert isinstance(log.odometry, RelativePoses)
    assert log.odometry.time_s.tolist() == [0.25, 0.5, 1.0, 1.5, 2.0]
    assert np.allclose(log.odometry.displacement[0], (0.25, 0.0, 0.05))
    assert log.provenance["odometry_noise"].startswith("stated: 0.1 m per root metre")
    assert "left out: 1 of 3 measurements, outside the time of the odometry" in notes
    sigmas = {"sigma_move_m": 0.02, "sigma_turn": 0.01}
    reported = build(files(tmp_path, POSES, trees, stated=SIGMAS | sigmas)).log.odometry
    assert isinstance(reported, RelativePoses)
    assert np.allclose(reported.covariance[0], 2.5 * np.diag((0.02, 0.02, 0.01)) ** 2)
    assert np.allclose(reported.covariance.sum(axis=0), 20 * np.diag((0.02, 0.02, 0.01)) ** 2)


def test_motions_with_covariances(tmp_path: Path) -> None:
    upper = ",".join(f"cov_{i}{j}" for i in range(3) for j in range(i, 3))
    odometry = f"t,dx,dy,dyaw,{upper}\n1,1,0,0.1,0.1,0,0,0.2,0,0.3\n2,1,0,0.1,0.1,0,0,0.2,0,0.3\n"
    log = build(files(tmp_path, odometry, "id,range,bearing,t\n1,5,0,2\n", stated=SIGMAS)).log
    assert isinstance(log.odometry, RelativePoses)
    assert log.odometry.covariance[1].diagonal().tolist() == [0.1, 0.2, 0.3]
    assert log.prior.time_s == 0.0
    with pytest.raises(InputError, match=r"trees.csv:2: time 1.5 s is not the end of a motion"):
        build(files(tmp_path, odometry, "id,range,bearing,t\n1,5,0,1.5\n", stated=SIGMAS))


def test_labels_in_a_column_of_another_name_are_missed_aloud(tmp_path: Path) -> None:
    found = build(files(tmp_path, VELOCITY, TREES.replace("label", "tree")))
    assert (
        "landmarks are unknown and will be associated by the estimators: there is no column "
        "landmark or id" in found.notes[-1]
    )


def test_truth_gives_the_prior_and_positions_their_sigma(tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text("t,x,y\n0,1,2\n0.5,1.5,2\n")
    (tmp_path / "map.csv").write_text("label,x,y\ntree_7,5,6\ntree_9,1,1\n")
    (tmp_path / "truth.tum").write_text("0 1 2 0 0 0 0 1\n2 3 2 0 0 0 0 1\n")
    command = "new-log out --odometry odo.csv --measurements trees.csv --positions gps.csv "
    command += "--sigma-position 0.5 --truth truth.tum --truth-landmarks map.csv "
    command += "--sigma-range 0.1 --sigma-bearing 0.01 --sigma-speed 0.1 --sigma-turn 0.02"
    files(tmp_path)
    done = slamcheck(*command.split(), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("next: slamcheck run out, or slamcheck check out --estimate PATH\n")
    assert "landmarks are unknown" not in done.stdout
    log = read_log_folder(tmp_path / "out")
    assert log.prior.pose.tolist() == [1.0, 2.0, 0.0]
    assert log.positions is not None
    assert np.allclose(log.positions.covariance, 0.25 * np.eye(2))
    assert log.truth.landmarks is not None
    assert log.truth.landmarks.id.tolist() == [0, 2]
    text = (tmp_path / "out" / "log.toml").read_text()
    assert (
        "pose = [1.0, 2.0, 0.0]  # default: the true pose at that time; --prior-pose gives another"
        in text
    )
    assert slamcheck(*command.split(), cwd=tmp_path).returncode == 2


BAD: dict[str, tuple[str, str, str]] = {
    "foreign": (
        "zeit,weg\n0,1\n", TREES,
        r"odo.csv:1: unknown columns: zeit, weg; expected time_s \(time, t, .*, speed_mps \(speed, "
        r"v, .*; rename the columns or give --column, see docs/",
    ),
    "hashes": (
        VELOCITY, "id,range,bearing,t\n#1,5,0,0.1\n", r"trees.csv: holds no records, .* with # is",
    ),
    "headerless": (
        "0,1,0.1\n1,1,0.1\n", TREES,
        r"odo.csv:1: no header, expected a line of names .*, among them time_s \(time, t, ",
    ),
    "twice": ("t,v,speed,w\n0,1,1,0\n", TREES, r"'v' and 'speed' both mean speed_mps"),
    "no time": ("v,w\n1,0\n", TREES, r"no column for time_s, expected one named time or t or"),
    "ranges alone": (
        VELOCITY, "id,range,t\n1,5,0.1\n",
        r"no column for bearing_rad, .*named bearing \(ranges alone are not supported in a log: "
        r"record your filter and slamcheck audit it, see docs/audit.md\); found id,",
    ),
    "bearings alone": (
        VELOCITY, "id,bearing,t\n1,0.5,0.1\n",
        r"no column for range_m, .* \(bearings alone are not supported in a log: record your "
        r"filter and slamcheck audit it, see docs/audit.md\); found id,",
    ),
    "neither": (
        VELOCITY, "id,abstand,winkel,t\n1,5,0,0.1\n",
        r"trees.csv: no column for range_m, expected one named range or distance, and no column "
        r"for bearing_rad, expected one named bearing; found id, abstand, winkel, t; rename "
        r"the columns or give --column",
    ),
    "long names": (
        VELOCITY, f"id,{'r' * 20_000},bearing,t\n1,5,0,0.1\n",
        r"trees.csv: no column for range_m, .*; found id, r{37}\.\.\., bearing, t; rename the",
    ),
    "trajectory": (
        "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", TREES,
        r"odo.csv:1: numbers with blanks .* as a TUM .*; slamcheck export TRAJECTORY.tum POSES.csv",
    ),
    "empty bearings": (
        VELOCITY, "id,range,bearing,t\n1,5,,0.1\n1,5, ,0.2\n",
        r"named bearing \(ranges alone are not .*\); found id, range, bearing \(empty\), t;",
    ),
    "a bearing lacks": (
        VELOCITY, "id,range,bearing,t\n1,5,0,0.1\n1,5,,0.2\n",
        r"trees.csv:3: 'bearing' is '', expected a finite number",
    ),
    "two kinds": (
        "t,dx,dy,dyaw,x,y,yaw\n0,1,0,0,0,0,0\n", TREES, r"holds poses and relative-poses.*--kind"
    ),
    "no kind": (
        "t,a\n0,1\n",
        TREES,
        r"odo.csv: odometry: unknown columns: a; expected beside t one of velocity: "
        r"speed or v, yaw_rate or yawrate; steering: .*; rename the columns or give --column, see",
    ),
    "unit": ("t [h],v,w\n0,1,0\n", TREES, r"unit 'h' of column 't \[h\]' is unknown, expected s,"),
    "ns": (
        "t_s,v,w\n1700000000000000000,1,0\n", TREES,
        r"odo.csv:2: 't_s' is 1700000000000000000 s, expected at most 1e\+10 s",
    ),
    "word": ("t,v,w\n0,1,0\n1,x,0\n", TREES, r"odo.csv:3: 'v' is 'x', expected a finite number"),
    "short": ("t,v,w\n0,1,0\n1,0\n", TREES, r"odo.csv:3: 2 values, expected 3 as in the header"),
    "backwards": ("t,v,w\n1,1,0\n\n0,1,0\n", TREES, r":4: time 0.0+ s follows 1.0+ s.*; sort the"),
    "range": (
        VELOCITY, "id,range,bearing,t\n1,5,0,0.1\n1,-5,0,0.2\n",
        r"trees.csv:3: range_m is -5.0, expected above 0",
    ),
    "elsewhere": (
        VELOCITY, "id,range,bearing,t\n1,5,0,50\n",
        r"trees.csv: from 50.000 to 50.000 s, expected times within the odometry's 0.000 to 1.500",
    ),
    "empty": ("", TREES, r"odo.csv: holds no records"),
    "header alone": ("t,v,w\n", TREES, r"odo.csv: holds no records"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_refused_with_place_and_expectation(name: str, tmp_path: Path) -> None:
    odometry, trees, message = BAD[name]
    with pytest.raises(InputError, match=message) as caught:
        build(files(tmp_path, odometry, trees))
    assert "\n" not in str(caught.value)


def test_sigmas_are_stated_once_and_where_they_are_needed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--sigma-range and --sigma-bearing are missing, expected"):
        build(files(tmp_path, stated=WHEELS))
    with pytest.raises(InputError, match="--sigma-range is missing, expected a number or a column"):
        build(files(tmp_path, stated=WHEELS | {"sigma_bearing_rad": 0.01}))
    with pytest.raises(InputError, match="--sigma-move: the velocity odometry does not use it"):
        build(files(tmp_path, stated=SIGMAS | WHEELS | {"sigma_move_m": 0.1}))
    with pytest.raises(InputError, match="--sigma-position: the file of --positions gives"):
        build(files(tmp_path, stated=SIGMAS | WHEELS | {"sigma_m": 0.1}))
    for value in (0.0, float("nan")):
        with pytest.raises(InputError, match=r"--sigma-range is .*, expected between 1e-07 and"):
            build(files(tmp_path, stated=SIGMAS | WHEELS | {"sigma_range_m": value}))
    reported = "id,range,bearing,t,sigma_range,sigma_bearing_deg\n1,5,0,0.1,0.2,1\n"
    log = build(files(tmp_path, trees=reported, stated=WHEELS)).log
    assert log.measurements.sigma_range_m.tolist() == [0.2]
    assert np.allclose(log.measurements.sigma_bearing_rad, np.deg2rad(1.0))


def test_noise_is_raised_until_the_log_is_accepted() -> None:
    """A fast vehicle with one sample a motion; without the raise it is refused."""
    time_s = np.arange(0.0, 200.0, 10.0)
    fast = {"time_s": time_s, "speed_mps": 300.0, "yaw_rate_radps": 0.0}
    seen = {"time_s": time_s, "range_m": 5.0, "bearing_rad": 0.0, **SIGMAS}
    log = Log.from_arrays({**fast, "sigma_speed_mps": 5.0, "sigma_turn": 1.0}, seen)
    with pytest.raises(InputError, match="is singular"):
        check_regular(log, build_timeline(log))
    raised = with_regular_motion(log)
    check_regular(raised, build_timeline(raised))


ARRAYS = {"time_s": [0.0, 1.0], "speed_mps": [1.0, 1.0], "yaw_rate_radps": 0.1, **WHEELS}
SEEN = {"time_s": [0.5], "range_m": [5.0], "bearing_rad": [0.1], **SIGMAS}


def test_from_arrays() -> None:
    log = Log.from_arrays(ARRAYS, {**SEEN, "landmark": ["a"]}, name="drive")
    assert (log.name, log.measurements.landmark.tolist()) == ("drive", [0])
    truth = {"time_s": [-1.0, 1.0], "x_m": [0.0, 2.0], "y_m": 3.0, "heading_rad": 0.0}
    assert Log.from_arrays(ARRAYS, SEEN, truth=truth).prior.pose.tolist() == [1.0, 3.0, 0.0]


@pytest.mark.parametrize(
    ("odometry", "measurements", "message"),
    [
        ({"speed": [1.0]}, {}, "odometry: speed is unknown, expected one of"),
        ({}, {"range": 1.0}, "measurements: range is unknown, expected one of time_s"),
        ({"speed_mps": [1.0]}, {}, r"odometry: speed_mps has shape \(1,\), expected \(2,\)"),
        ({}, {"range_m": [-1.0]}, "measurements, row 0: range_m is -1.0, expected above 0"),
        ({}, {"bearing_rad": ["a"]}, "measurements: bearing_rad is not numeric"),
        ({}, {"landmark": [0.5]}, "measurements, row 0: landmark is 0.5, expected a whole number"),
        ({"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}, {}, "holds velocity and poses"),
    ],
)
def test_arrays_refused(
    odometry: dict[str, Any], measurements: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Log.from_arrays({**ARRAYS, **odometry}, {**SEEN, **measurements})


def test_arrays_that_are_no_columns() -> None:
    with pytest.raises(InputError, match="measurements: is a list, expected columns by name"):
        Log.from_arrays(ARRAYS, [1.0])  # type: ignore[arg-type]
    with pytest.raises(InputError, match="odometry: speed_mps is no column of 2 values"):
        Log.from_arrays({**ARRAYS, "speed_mps": [[1.0], [1.0, 2.0]]}, SEEN)


def test_log_toml_is_its_folder(tmp_path: Path) -> None:
    """Also for a run, which takes any other TOML file for a configuration."""
    from comparisons.cli.flags import Arguments
    from comparisons.cli.jobs import read_job
    from comparisons.config import RunConfig
    from comparisons.logs.log_folder import write_log_folder

    write_log_folder(build(files(tmp_path)).log, tmp_path / "log")
    path = tmp_path / "log" / "log.toml"
    assert read_log(path).records == read_log(path.parent).records

    def of(path: Path) -> Arguments:
        return Arguments(str(path), (), None, (), False, None, False, None, {}, {})

    assert read_job(of(path), RunConfig)[0].records["odometry"] == 3
    config = tmp_path / "other" / "log.toml"
    config.parent.mkdir()
    config.write_text(f'job = "run"\n[log]\nsource = "{path.parent}"\n')
    assert read_job(of(config), RunConfig)[0].name == "mine"


def test_faults_of_a_log_folder_name_the_page(tmp_path: Path) -> None:
    from comparisons.logs.log_folder import write_log_folder

    write_log_folder(build(files(tmp_path)).log, tmp_path / "log")
    (tmp_path / "log" / "odometry.csv").write_text("a,b\n")
    with pytest.raises(InputError, match=r"expected the header .* \(see docs/formats.md\)$"):
        read_log(tmp_path / "log")


@pytest.mark.slow
def test_the_page_can_be_followed(tmp_path: Path) -> None:
    """The lines of its files, and its Python; test_tutorials runs its commands."""
    root = Path(__file__).resolve().parents[3]
    page = (root / "docs" / "your-own-log.md").read_text()
    drive = root / "examples" / "own_filter" / "drive.py"
    subprocess.run([sys.executable, drive], cwd=tmp_path, check=True)
    for name in ("odometry", "measurements"):  # as the page shows them
        for line in (tmp_path / f"{name}.csv").read_text().splitlines()[:3]:
            assert line in page, line
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    space: dict[str, Any] = {}
    exec(code, space)  # noqa: S102
    assert space["log"].provenance["labels"] == '{"oak": 0, "elm": 1}'


def test_a_column_of_sigmas_of_positions_is_read(tmp_path: Path) -> None:
    """As the message for a missing one says; a sigma that is stated besides is refused."""
    (tmp_path / "gps.csv").write_text("t,x,y,sigma_cm\n0,0,0,50\n1,1,0,30\n")
    paths = {"positions": tmp_path / "gps.csv"}
    positions = build(files(tmp_path, paths=paths)).log.positions
    assert positions is not None
    assert np.allclose(positions.covariance[:, 0, 0], [0.25, 0.09])
    assert np.array_equal(positions.covariance, positions.covariance[:, ::-1, ::-1])
    with pytest.raises(InputError, match="--sigma-position: the file of --positions gives its own"):
        build(files(tmp_path, paths=paths, stated=SIGMAS | WHEELS | {"sigma_m": 0.5}))


def test_a_sigma_that_is_stated_and_in_the_file_is_refused(tmp_path: Path) -> None:
    trees = "label,range,bearing,time,sigma_range\n1,5,0.5,0.2,0.1\n"
    message = "--sigma-range: the file of --measurements gives its own sigmas, or there is none"
    with pytest.raises(InputError, match=message):
        build(files(tmp_path, trees=trees))
