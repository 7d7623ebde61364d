"""Columns under other names: which are known, which a user says, and which are refused."""

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.column_names import column_of, known_unit, meaning, parted, usual_name
from comparisons.logs.new_log import UserFiles, build
from comparisons.logs.odometry import VelocityOdometry
from comparisons.logs.schema import COLUMNS, UNITS
from tests.commands import slamcheck

STATED: dict[str, float | str] = {
    "sigma_range_m": 0.1, "sigma_bearing_rad": 0.01, "sigma_speed_mps": 0.1, "sigma_turn": 0.02
}  # fmt: skip
ODOMETRY = "zeit,tempo,drehung\n0,1,5.729578\n1,2,5.729578\n"
TREES = "baum,zeit,abstand,winkel\nb1,0.5,3,90\n"
NAMED = {
    "time": "zeit", "speed": "tempo", "yaw_rate": "drehung", "label": "baum", "range": "abstand",
    "bearing": "winkel",
}  # fmt: skip


def files(folder: Path, odometry: str = ODOMETRY, trees: str = TREES, **more: Any) -> UserFiles:
    (folder / "wheels.csv").write_text(odometry)
    (folder / "trees.csv").write_text(trees)
    paths = {"odometry": folder / "wheels.csv", "measurements": folder / "trees.csv"}
    return UserFiles(name="mine", paths=paths, stated=STATED, **more)


def test_a_user_says_which_header_has_a_column(tmp_path: Path) -> None:
    units = {"yaw_rate": "dps", "winkel": "degrees"}
    log, _, notes = build(files(tmp_path, columns=NAMED, units=units))
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.speed_mps.tolist() == [1.0, 2.0]
    assert np.allclose(log.odometry.yaw_rate_radps, 0.1)
    assert np.allclose(log.measurements.bearing_rad, np.pi / 2)
    assert log.labels == {0: "b1"}
    assert notes[0].startswith("odometry: wheels.csv, 2 rows: time_s from 'zeit' (0.000 to 1.000)")


def test_a_header_that_is_said_goes_before_a_usual_name(tmp_path: Path) -> None:
    """Of one file alone, and with the unit that ends it."""
    odometry = "t,stamp_unix_ns,v,w\n7,0,1,0\n8,1000000000,1,0\n"
    trees = "id,t,range,bearing\n1,0.5,3,0.1\n"
    said = {"odometry:time": "stamp_unix_ns"}
    log = build(files(tmp_path, odometry, trees, columns=said)).log
    assert log.odometry.time_s.tolist() == [0.0, 1.0]
    with pytest.raises(InputError, match=r"from 0.500 to 0.500 s, expected times within"):
        build(files(tmp_path, odometry, trees))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"tiem": "zeit"}, r"--column tiem=zeit: 'tiem' is unknown, expected time, speed, .*"),
        ({"time": "stunde"}, r"--column time=stunde: no file that needs it has a column 'stunde'"),
        ({"odometry:range": "abstand"}, r"odometry:range=abstand: no file that needs it has"),
    ],
)
def test_headers_that_are_said_and_not_there(
    columns: Mapping[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        build(files(tmp_path, columns={**NAMED, **columns}, units={"winkel": "deg"}))


def test_all_that_is_unknown_is_named_at_once(tmp_path: Path) -> None:
    """In both files, with the sigmas that are missing and an option that fits nothing."""
    given = files(tmp_path, "t,tempo\n0,1\n", "id,zeit,abstand,bearing\n1,0,1,0\n")
    object.__setattr__(given, "units", {"hoehe": "m"})
    with pytest.raises(InputError) as caught:
        build(given)
    said = str(caught.value)
    assert "wheels.csv: odometry: unknown columns: tempo; expected beside t one of" in said
    assert "trees.csv: no column for time_s, expected one named time" in said
    assert "and no column for range_m, expected one named range or distance" in said
    assert "--unit hoehe=m: no file has such a column that is read" in said
    assert said.count("docs/your-own-log.md") == 1
    assert "\n" not in said
    given = files(tmp_path, "t [h],v [furlong],w\n0,1,0\n")
    with pytest.raises(InputError, match=r"unit 'h' of column 't \[h\]' .*; unit 'furlong' of col"):
        build(given)


SPELT = {
    "time_s": ("Time_Stamp [nanoseconds]", "timestamp_ns", "ts_ns", "stamp_unix_ns", "unixTime_ns"),
    "yaw_rate_radps": (
        "gyro_z [dps]", "Yaw Rate (deg/s)", "w_deg_s", "psidot_dps", "turnRate_dps",
        "angular_rate [deg s^-1]", "omega_degps", "yaw_vel [degrees/s]",
    ),
    "speed_mps": ("vel_km_h", "Speed [kph]", "forwardSpeed_kmh", "v (km/h)"),
    "heading_rad": ("psi_deg", "yaw [degrees]", "theta (°)", "YAW_DEG", "heading_angle_deg"),
    "bearing_rad": ("azimuth [deg]", "az_deg", "angle [degrees]", "Bearing_deg"),
    "range_m": ("dist_mm", "Distance [MM]", "range_mm", "r (mm)", "rho_mm"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("column", "header"), [(column, one) for column, some in SPELT.items() for one in some]
)
def test_headers_as_people_write_them(column: str, header: str) -> None:
    """With their unit, which is not the default."""
    found = meaning(header, tuple(SPELT))
    assert found is not None
    assert found.column == column
    assert found.unit is not None
    assert UNITS[column.rpartition("_")[2]][found.unit] != 1.0


def test_no_name_means_two_columns_of_a_file() -> None:
    """Of those that one file may have; otherwise the first would be taken, whichever was meant."""
    odometry = (
        *("time_s", "speed_mps", "yaw_rate_radps", "steering_rad", "x_m", "y_m", "heading_rad"),
        *("dx_m", "dy_m", "dheading_rad"),
    )
    trees = ("time_s", "range_m", "bearing_rad", "sigma_range_m", "sigma_bearing_rad", "landmark")
    for wanted in (odometry, trees):
        for one, other in product(wanted, repeat=2):
            if one != other:
                assert column_of(usual_name(one), (other,)) is None, (one, other)


@pytest.mark.parametrize("header", ["cov11", "nsecs", "range_x", "time_zone", "w2", "vehicle", ""])
def test_other_names_mean_nothing(header: str) -> None:
    assert meaning(header, tuple(COLUMNS)) is None


def test_units_are_those_of_their_column() -> None:
    assert known_unit("bearing_rad", "Degrees") == "deg"
    assert known_unit("yaw_rate_radps", "dps") == "dps"
    assert known_unit("yaw_rate_radps", "rad s^-1") == "rad/s"
    assert known_unit("bearing_rad", "dps") is None
    assert known_unit("landmark", "m") is None
    assert parted("az [deg]") == ("az", "deg")


def test_less_usual_names_give_way(tmp_path: Path) -> None:
    """A header of a usual name is read, and a kind of odometry by usual names is chosen."""
    odometry = "t,v,w,vel,delta,px,py,psi\n0,1,0.1,9,9,9,9,9\n1,1,0.1,9,9,9,9,9\n"
    log, *_ = build(files(tmp_path, odometry, "id,name,t,range,dist,bearing\n1,a,0,3,9,0\n"))
    assert isinstance(log.odometry, VelocityOdometry)
    assert log.odometry.speed_mps.tolist() == [1.0, 1.0]
    assert log.measurements.range_m.tolist() == [3.0]
    assert log.measurements.landmark.tolist() == [1]
    with pytest.raises(
        InputError, match=r"'vel' and 'lin_vel' both .* give --column speed=vel, or"
    ):
        build(files(tmp_path, "t,vel,lin_vel,w\n0,1,1,0\n"))


@pytest.mark.parametrize(
    ("times", "unit"),
    [("0,32000000000", "ns"), ("0,1200000000", "us"), ("5,20000005000", "ns")],
)
def test_times_that_span_years_name_no_unit(times: str, unit: str, tmp_path: Path) -> None:
    first, last = times.split(",")
    odometry = f"t,v,w\n{first},1,0\n{last},1,0\n"
    with pytest.raises(InputError, match=rf"'t' spans \d+ days as .*--unit t={unit} \("):
        build(files(tmp_path, odometry))
    trees = f"id,t_{unit},range,bearing\n1,{first},3,0\n"
    assert build(files(tmp_path, odometry, trees, units={"t": unit})).log.duration_s < 86_400.0


def raw(folder: Path, seed: int) -> None:
    """A drive of 12 s as a newcomer has it: nanoseconds, degrees, text labels, names of his own."""
    rng = np.random.default_rng(seed)
    count = 240
    jitter = np.concatenate(([0], rng.integers(-4_000_000, 4_000_000, count - 1)))
    first = 1_700_000_000 * 10**9 + int(rng.integers(1, 10**9))
    stamp = first + np.arange(count) * 50_000_000 + jitter
    v, w = 1.2 + 0.3 * np.sin(0.02 * np.arange(count)), 0.4 + 0.1 * np.cos(0.01 * np.arange(count))
    pose = np.zeros((count, 3))
    pose[0] = 12.0, -7.0, 0.6
    for k, dt in enumerate(np.diff(stamp) * 1e-9):
        middle = pose[k, 2] + 0.5 * dt * w[k]
        pose[k + 1] = pose[k] + dt * np.array([v[k] * np.cos(middle), v[k] * np.sin(middle), w[k]])
    trees = pose[:, :2].mean(axis=0) + rng.uniform(-9.0, 9.0, (10, 2))
    wheels = ["stamp_unix_ns,tempo,psidot_dps"]
    for t, speed, rate in zip(stamp, v, w, strict=True):
        speed, rate = speed + 0.05 * rng.normal(), np.degrees(rate + 0.02 * rng.normal())
        wheels.append(f"{t},{speed:.6f},{rate:.6f}")
    seen = ["marker,stamp_unix_ns,dist,azimuth_deg"]
    for k, (name, tree) in product(range(0, count, 10), enumerate(trees)):
        way = tree - pose[k, :2]
        ahead = np.arctan2(way[1], way[0]) - pose[k, 2] + 0.015 * rng.normal()
        bearing = np.degrees((ahead + np.pi) % (2 * np.pi) - np.pi)
        seen.append(
            f"tag_{name},{stamp[k]},{np.hypot(*way) + 0.08 * rng.normal():.5f},{bearing:.5f}"
        )
    true = ["stamp_unix_ns,x,y,psi_deg"]
    true += [
        f"{t},{x:.6f},{y:.6f},{np.degrees(h):.6f}" for t, (x, y, h) in zip(stamp, pose, strict=True)
    ]
    for name, rows in (("wheels", wheels), ("tags", seen), ("mocap", true)):
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("seed", [1, 2])
def test_two_calls_lead_from_raw_files_to_a_verdict(seed: int, tmp_path: Path) -> None:
    raw(tmp_path, seed)
    first = "new-log mine --odometry wheels.csv --measurements tags.csv --truth mocap.csv "
    first += "--sigma-speed 0.05 --sigma-turn 1.2deg --sigma-range 8cm --sigma-bearing 0.9deg"
    done = slamcheck(*first.split(), "--column", "v=tempo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "start: 12 m, -7 m, 0.6 rad (from truth)" in done.stdout
    done = slamcheck("run", "mine", cwd=tmp_path)
    assert (done.returncode, done.stdout.splitlines()[0]) == (
        0,
        "verdict: agree; filter consistent",
    )
    done = slamcheck(*first.replace("mine", "other").split(), cwd=tmp_path)
    assert done.returncode == 2
    assert "wheels.csv: odometry: unknown columns: tempo" in done.stderr
