"""A run's folder can be run again: the same files, byte for byte but for the seconds."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from comparisons.atomic import LIST
from comparisons.logs.log_folder import write_log_folder
from tests.commands import refused, slamcheck, works
from tests.helpers import simulated
from tests.scenarios import scenario

_TIMED = re.compile(r"<h2>Time</h2>.*?</table>|scans per second</td><td>[\d,]+")


def steady(path: Path) -> object:
    """What a file holds, without times."""
    if path.suffix == ".json":
        found = json.loads(path.read_text())
        for name in ("seconds", "cpu_s"):
            found.pop(name, None)
        for key in ("scan_odometry", "odometry"):
            if isinstance(found.get(key), dict):
                found[key].pop("scans_per_second", None)
        return found
    if path.name == LIST:
        return [line.split()[1] for line in path.read_text().splitlines()]
    if path.name == "report.html":
        return _TIMED.sub("", path.read_text())
    return path.read_bytes()


def assert_equal(first: Path, second: Path) -> None:
    names = [
        sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
        for folder in (first, second)
    ]
    assert names[0] == names[1]
    for name in names[0]:
        assert steady(first / name) == steady(second / name), name


def write_scans(folder: Path) -> None:
    write_log_folder(scenario("scan-slam-maps", seed=1, seconds=10.0), folder)


def write_loop(folder: Path) -> None:
    write_log_folder(scenario("scan-loop", seconds=12.0), folder)


CASES: dict[str, tuple[str, Callable[[Path], None] | None]] = {
    "points": ("run simulated-loop --seed 7 --association jcbb --filter compressed --trace", None),
    "associations": ("run simulated-loop --seed 3 --smoother-association own", None),
    "motion": ("run log --motion both", write_loop),
    "dense": ("run log --dense points --dense occupancy --set dense_maps.d_min_m=0.3", write_loop),
    "dynamic": ("run log --dynamic --figures pdf", write_loop),
    "landmarks": ("run log --landmarks scans", write_scans),
    "solve": ("solve simulated-loop --seed 2 --association own --robust huber", None),
    "map": ("map log --layer occupancy --dynamic", write_loop),
    "odometry": ("odometry log --no-loop-closure", write_loop),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if m else []) for n, (_, m) in CASES.items()]
)
def test_a_folder_is_run_again(name: str, tmp_path: Path) -> None:
    command, make = CASES[name]
    if make is not None:
        make(tmp_path / "log")
    job, *arguments = command.split()
    first = slamcheck(job, *arguments, "--out", "a", cwd=tmp_path)
    assert first.returncode in (0, 1, 3), first.stderr
    second = slamcheck(job, "a/config.toml", "--out", "b", cwd=tmp_path)
    assert second.returncode == first.returncode, second.stderr
    assert_equal(tmp_path / "a", tmp_path / "b")


@pytest.mark.slow
def test_a_check_is_run_again(tmp_path: Path) -> None:
    assert slamcheck("run", "simulated-loop", "--out", "own", cwd=tmp_path).returncode == 0
    works("check", "simulated-loop", "--estimate", "own/ekf", "--out", "a", cwd=tmp_path)
    works("check", "a/config.toml", "--out", "b", cwd=tmp_path)
    assert_equal(tmp_path / "a", tmp_path / "b")


@pytest.mark.slow
def test_another_seed_leaves_other_files(tmp_path: Path) -> None:
    """The comparison itself sees a difference."""
    for seed, out in (("1", "a"), ("2", "b")):
        works("solve", "simulated-loop", "--seed", seed, "--out", out, cwd=tmp_path)
    with pytest.raises(AssertionError):
        assert_equal(tmp_path / "a", tmp_path / "b")


@pytest.mark.slow
def test_a_log_that_has_changed_is_refused(tmp_path: Path) -> None:
    write_log_folder(simulated(loop_s=10.0), tmp_path / "log")
    assert slamcheck("run", "log", "--out", "a", cwd=tmp_path).returncode == 0
    write_log_folder(simulated(seed=1, loop_s=10.0), tmp_path / "other")
    (tmp_path / "log" / "measurements.csv").write_bytes(
        (tmp_path / "other" / "measurements.csv").read_bytes()
    )
    said = refused("run", "a/config.toml", "--out", "b", cwd=tmp_path)
    assert "has changed since the configuration was written" in said
    assert not (tmp_path / "b").exists()
    allowed = slamcheck("run", "a/config.toml", "--allow-changed-log", "--out", "b", cwd=tmp_path)
    assert allowed.returncode in (0, 1), allowed.stderr


@pytest.mark.slow
def test_a_configuration_of_another_job_is_refused(tmp_path: Path) -> None:
    assert slamcheck("solve", "simulated-loop", "--out", "a", cwd=tmp_path).returncode == 0
    said = refused("run", "a/config.toml", cwd=tmp_path)
    assert "is a configuration of slamcheck solve, not of run" in said
