from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.bundled import open_log
from comparisons.logs.hashing import _rounded, log_hash
from comparisons.logs.log import Landmarks, Log, Positions, Surfaces
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from comparisons.logs.scans import Clouds, Mount, Scans
from tests.commands import refused
from tests.comparisons.logs.test_readers import assert_refused
from tests.helpers import simulated


def full_log() -> Log:
    """Every stream that a log can have."""
    rng = np.random.default_rng(0)
    log = simulated(loop_s=10.0)
    covariance = np.array([[[0.1, 0.01], [0.01, 0.2]]] * 3)
    return replace(
        log,
        name='odd "name" 日本 😀 \x7f',
        format="log-folder",
        measurements=replace(log.measurements, label_gate=50.0),
        positions=Positions(np.arange(3.0), rng.standard_normal((3, 2)), covariance),
        known_landmarks=Landmarks(
            np.arange(60), rng.standard_normal((60, 2)), np.tile(0.1 * np.eye(2), (60, 1, 1))
        ),
        known_measurements=log.measurements,
        scans=Scans(
            time_s=np.arange(2.0),
            angle_rad=np.arange(3.0) / 7,
            range_m=np.array(((1, np.nan, 3), (4, 5, 6))) / 3,
            intensity=np.ones((2, 3)),
            mount=Mount(0.3, -0.1, 0.2),
            beam_s=1e-5,
        ),
        clouds=Clouds(
            np.arange(2.0),
            np.array((0, 2, 3)),
            np.array(((1, 2, 3), (np.nan, np.nan, np.nan), (4, 5, 6))) / 3,
            np.arange(3.0) / 7,
        ),
        truth=replace(log.truth, surfaces=Surfaces(rng.standard_normal((4, 4)))),
    )


def assert_same(first: object, second: object) -> None:
    """Equal to the bit, records by field."""
    if isinstance(first, np.ndarray):
        assert isinstance(second, np.ndarray)
        assert first.dtype == second.dtype
        assert np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    elif hasattr(first, "__dataclass_fields__"):
        assert type(first) is type(second)
        for f in fields(first):  # type: ignore[arg-type]
            assert_same(getattr(first, f.name), getattr(second, f.name))
    else:
        assert first == second


def velocity_log() -> Log:
    log = simulated(loop_s=5.0)
    time = log.odometry.time_s
    odometry = VelocityOdometry(time, np.sin(time), np.cos(time) / 3, OdometryNoise(0.1, 0.2))
    return replace(log, odometry=odometry, format="log-folder")


@pytest.mark.parametrize("kind", ["full", "velocity", "victoria-park"])
def test_round_trip_is_exact(kind: str, tmp_path: Path) -> None:
    make: dict[str, Callable[[], Log]] = {
        "full": full_log,
        "velocity": velocity_log,
        "victoria-park": lambda: replace(open_log("victoria-park"), format="log-folder"),
    }
    log = make[kind]()
    write_log_folder(log, tmp_path / "log")
    again = read_log_folder(tmp_path / "log")
    assert_same(log, again)
    assert log_hash(log) == log_hash(again)


@pytest.mark.parametrize("kind", ["", "known_"])
def test_measurements_by_an_earlier_name_are_refused(tmp_path: Path, kind: str) -> None:
    """What stands beside today's file is not looked at."""
    log, folder = full_log(), tmp_path / "log"
    write_log_folder(log, folder)
    earlier, today = folder / f"{kind}sightings.csv", folder / f"{kind}measurements.csv"
    earlier.write_text("")
    assert_same(log, read_log_folder(folder))
    today.rename(earlier)
    assert refused("logs", "log", cwd=tmp_path) == (
        f"slamcheck: log/{earlier.name}: is the name of slamcheck 0.1 for a log's measurements, "
        f"which slamcheck 0.2 reads and this release does not; call it {today.name}, and "
        "[sightings] in log.toml [measurements] (see docs/formats.md)"
    )


def test_intensities_are_one_more_column(tmp_path: Path) -> None:
    """A folder without the column is as it was, and so is its log's hash."""
    log = replace(simulated(loop_s=5.0), format="log-folder")
    bright = np.arange(float(len(log.measurements.time_s))) / 7
    bright[2] = np.nan
    lit = replace(log, measurements=replace(log.measurements, intensity=bright))
    for name, one in (("log", log), ("lit", lit)):
        write_log_folder(one, tmp_path / name)
        assert_same(one, read_log_folder(tmp_path / name))
    header = (tmp_path / "log" / "measurements.csv").read_text().splitlines()[0]
    assert header.endswith(",diameter_m")
    path = tmp_path / "lit" / "measurements.csv"
    assert path.read_text().splitlines()[0] == header + ",intensity"
    assert log_hash(log) != log_hash(lit)
    path.write_text(path.read_text().replace(",intensity", ",colour", 1))
    with pytest.raises(InputError, match=r"expected the header .*diameter_m$"):
        read_log_folder(tmp_path / "lit")


@pytest.mark.parametrize(("relative", "equal"), [(4e-16, True), (1e-8, False)])
def test_a_hash_is_the_same_on_all_processors(relative: float, equal: bool) -> None:
    """Last bits do not count, which another processor's sine and arctangent round otherwise."""
    log = simulated(loop_s=5.0)
    bearing = log.measurements.bearing_rad * (1 + relative)
    other = replace(log, measurements=replace(log.measurements, bearing_rad=bearing))
    assert (bearing != log.measurements.bearing_rad).any()
    assert (log_hash(log) == log_hash(other)) is equal


def with_prior(log: Log, pose: list[float], variances: list[float]) -> str:
    prior = replace(log.prior, pose=np.array(pose), covariance=np.diag(variances))
    return log_hash(replace(log, prior=prior))


def test_a_hash_tells_small_numbers_beside_large_ones() -> None:
    """And not a zero from one that is computed, nor 1 from the number below it."""
    log, ones = simulated(loop_s=5.0), [1.0, 1.0, 1.0]
    utm = [333_000.0, 6_250_000.0, 0.0]
    assert with_prior(log, utm, ones) != with_prior(log, [*utm[:2], 0.003], ones)
    assert with_prior(log, utm, ones) == with_prior(log, [*utm[:2], 1e-17], ones)
    assert with_prior(log, utm, ones) == with_prior(log, [*utm[:2], -0.0], ones)
    assert with_prior(log, utm, [1e6, 1e6, 1e-4]) != with_prior(log, utm, [1e6, 1e6, 4e-4])
    assert with_prior(log, [0.3, 0.7, 1.0], ones) == with_prior(
        log, [0.3, 0.7, float(np.nextafter(1.0, 0.0))], ones
    )
    below = np.array([np.nextafter(1.0, 0.0), 0.3, 0.7])
    np.testing.assert_array_equal(_rounded(np.array([1.0, 0.3, 0.7])), _rounded(below))


@pytest.mark.parametrize("number", [5e-324, 1e-310, 1e308, np.inf, np.nan])
def test_any_number_is_rounded(number: float) -> None:
    """Without a warning, which is an error here."""
    found = _rounded(np.array([0.0, number, 1.0]))
    assert found[0] == 0.0
    assert _rounded(np.zeros((0, 3))).shape == (0, 3)


def test_writing_replaces_nothing(tmp_path: Path) -> None:
    """Neither somebody's files nor a log, which may be the only copy of its data."""
    folder = tmp_path / "log"
    folder.mkdir()
    write_log_folder(simulated(seed=1, loop_s=5.0), folder)
    with pytest.raises(InputError, match=r"already holds log\.toml; give a new folder"):
        write_log_folder(simulated(seed=2, loop_s=5.0), folder)
    assert_same(read_log_folder(folder).measurements, simulated(seed=1, loop_s=5.0).measurements)
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


FAULTS = {
    "toml": ("log.toml", "version = 1", "version = ", "not valid TOML"),
    "version": ("log.toml", "version = 1", "version = 2", "log.toml: version: input should be 1"),
    "misspelt": ("log.toml", "[prior]", "[prior]\npoze = 1", "log.toml: prior.poze: extra inputs"),
    "ragged prior": ("log.toml", "[0.0, 1e-10, 0.0]", "[0.0]", "prior.covariance.1"),
    "kind": ("log.toml", 'kind = "steering"', 'kind = "sail"', "odometry: input tag 'sail'"),
    "wheelbase": ("log.toml", "wheelbase_m = 2.83", "wheelbase_m = 0", "wheelbase_m is 0"),
    "prior": ("log.toml", "covariance = [[1e-10", "covariance = [[-1.0", "not positive definite"),
    "header": ("measurements.csv", "range_m", "r", "measurements.csv:1: expected the header"),
    "value": ("measurements.csv", "0.15,", "a,", "measurements.csv:2: sigma_range_m is 'a'"),
    "id": ("measurements.csv", ",nan", ".5,nan", "expected a whole number below 2^53"),
    "time": ("odometry.csv", "\n0.05,", "\n0.0,", "odometry.csv"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_damaged_folders(name: str, tmp_path: Path) -> None:
    file, old, new, message = FAULTS[name]
    write_log_folder(simulated(loop_s=5.0), tmp_path / "log")
    path = tmp_path / "log" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert_refused(tmp_path / "log", message, "log-folder")


def test_scans_are_never_unpickled(tmp_path: Path) -> None:
    write_log_folder(full_log(), tmp_path / "log")
    hostile = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "log" / "scans.npz", time_s=hostile, allow_pickle=True)
    with pytest.raises(InputError, match=r"scans\.npz: time_s is not an array of numbers"):
        read_log_folder(tmp_path / "log")


def test_missing_streams(tmp_path: Path) -> None:
    write_log_folder(simulated(loop_s=5.0), tmp_path / "log")
    (tmp_path / "log" / "measurements.csv").unlink()
    with pytest.raises(InputError, match=r"measurements\.csv: no such file"):
        read_log_folder(tmp_path / "log")


def test_what_a_stream_remembers_beside_its_records_is_no_part_of_the_hash() -> None:
    """A cached property was: the hash depended on what had been asked of the log before."""
    log = simulated()
    before = log_hash(log)
    vars(log.measurements)["remembered"] = True
    assert log_hash(log) == before
