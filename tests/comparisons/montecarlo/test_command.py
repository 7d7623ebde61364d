"""`slamcheck montecarlo`: the same bytes however it is computed, and what it says of faults."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import ChunkFiles
from comparisons.experiments.montecarlo.folder import write_montecarlo
from comparisons.experiments.montecarlo.study import run_study
from comparisons.experiments.montecarlo.workers import spread
from comparisons.experiments.scenarios.scenario import bundled_scenarios, read_scenario
from comparisons.experiments.scenarios.world import build_world, measure
from tests.commands import refused, slamcheck, works
from tests.comparisons.montecarlo.worlds import short, shortened, study_of

ROOT = Path(__file__).resolve().parents[3]
SLAMCHECK = (sys.executable, "-c", "from comparisons.cli.app import main; main()")
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}


def contents(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in folder.rglob("*")
        if p.is_file() and ".slamcheck-" not in p.as_posix()
    }


CHUNKS = {f"chunks/{name}-{i:06d}.npz" for name in ("ekf", "fej") for i in range(2)}


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The circle, shorter."""
    return shortened(tmp_path_factory.mktemp("scenario"), 200)


@pytest.fixture(scope="module")
def finished(scenario: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of two chunks by one process."""
    out = tmp_path_factory.mktemp("study") / "out"
    assert again(scenario, out, "--workers", "1").startswith("NEES: ")
    return out


def asked(scenario: Path, out: Path) -> tuple[str, ...]:
    return ("montecarlo", str(scenario), "--runs", "40", "--filters", "ekf,fej", "--out", str(out))


def again(scenario: Path, out: Path, *more: str) -> str:
    return works(*asked(scenario, out), *more, cwd=scenario.parent)


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(scenario: Path, finished: Path, tmp_path: Path) -> None:
    again(scenario, tmp_path / "two", "--workers", "2")
    assert contents(tmp_path / "two") == contents(finished)
    reports = {"config.toml", "montecarlo.json", "curves.png", "report.html", "runs.csv"}
    assert set(contents(finished)) == {*reports, *CHUNKS}


@pytest.mark.slow
def test_a_killed_run_goes_on(scenario: Path, finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    arguments = (*asked(scenario, out), "--workers", "1")
    job = subprocess.Popen((*SLAMCHECK, *arguments), env=ENVIRONMENT)
    first = out / "chunks" / "ekf-000000.npz"
    while not first.exists() and job.poll() is None:
        time.sleep(0.005)
    job.send_signal(signal.SIGKILL)
    job.wait()
    kept = contents(out)
    assert kept
    assert len(kept) < 6
    half = out / "chunks" / ".slamcheck-01234567-0123456789abcdef" / "new"
    half.mkdir(parents=True)
    (half / "fej-000001.npz").write_bytes(b"half")
    stamp = first.stat().st_mtime_ns
    again(scenario, out)
    assert first.stat().st_mtime_ns == stamp
    assert contents(out) == contents(finished)


@pytest.mark.slow
def test_a_stopped_study_says_what_it_keeps(
    scenario: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what is in the folder: the stop comes before the work's progress is shown."""
    out = tmp_path / "stopped"
    arguments = (*asked(scenario, out), "--workers", "1")

    def stopped(after: int) -> str:
        written: list[object] = []
        write = ChunkFiles.write

        def stops(*what: Any) -> None:
            if len(written) == after:
                raise SystemExit(130)
            write(*what)
            written.append(what)
            if len(written) == after:
                raise SystemExit(130)

        with monkeypatch.context() as patch:
            patch.setattr(ChunkFiles, "write", stops)
            done = slamcheck(*arguments, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (130, "")
        return done.stderr.removeprefix(f"slamcheck: stopped: {out} keeps ")

    assert stopped(0) == "0 of 80 runs; give the same command to go on\n"
    assert stopped(1) == "25 of 80 runs; give the same command to go on\n"
    assert stopped(2) == "65 of 80 runs; give the same command to go on\n"
    again(scenario, out)
    assert contents(out) == contents(finished)


@pytest.mark.slow
def test_damaged_chunks_are_computed_again(scenario: Path, finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "damaged"
    good = contents(finished)
    (out / "chunks").mkdir(parents=True)
    for i, (name, data) in enumerate(sorted(good.items())):
        if name.startswith("chunks/"):
            half = bytearray(data)
            half[len(half) // 2] ^= 255
            (out / name).write_bytes((data[:1000], bytes(half), b"", data)[i % 4])
    assert "computed again: 3" in again(scenario, out)
    assert contents(out) == good


@pytest.mark.slow
def test_fewer_runs_and_other_filters_use_what_is_there(finished: Path, tmp_path: Path) -> None:
    study = study_of(short("circle", 60), 30, "ekf", "oc")
    first = run_study(study, tmp_path)
    assert first.computed == 4
    more = run_study(study_of(study.scenario, 50, "ekf", "fej", "oc"), tmp_path)
    assert more.computed == 2
    fewer = run_study(study, tmp_path)
    assert fewer.computed == 0
    assert fewer.filters["oc"].rmse == first.filters["oc"].rmse


def test_chunks_of_another_scenario_are_refused(tmp_path: Path) -> None:
    """With the one that the folder is of, once it is finished, and a folder that is free."""
    folder, first = tmp_path / "study", study_of(short("circle", 20), 5, "ekf")
    outcome = run_study(first, folder)
    said = f"another scenario; give --out {folder}-2"
    for _ in range(2):
        with pytest.raises(InputError, match=re.escape(said)):
            run_study(study_of(short("circle", 21), 5, "ekf"), folder)
        write_montecarlo(outcome, folder)
        (tmp_path / "study-2").mkdir(exist_ok=True)
        said = f"another scenario ({first.config.scenario}); give --out {folder}-3"


CIRCLE = 'kind = "circle"\nspeed_mps = 0.25\nyaw_rate_radps = 0.025'
SHORT = """kind = "waypoints"
speed_mps = 1.0
lookahead_m = 9.0
points = [[0, 0], [1, 0], [0, 1]]"""
SCENARIO_FAULTS = [
    ("step_s = 1.0", "step_s = -1.0", "step_s is -1.0: input should be greater than or equal to"),
    ("step_s = 1.0", "step_s = 1.0\nstep = 3", "step: is unknown, expected one of description, "),
    ('kind = "circle"', 'kind = "square"', "kind is 'square': expected one of circle, waypoints, "),
    ('kind = "circle"\n', "", "course.kind: is missing"),
    (CIRCLE, SHORT, "all of it lies within lookahead_m"),
    ("speed_mps = 0.25\n", "", "course.speed_mps: is missing"),
    ("[course]", "[course", "not valid TOML"),
    ("sigma_share = 0.1", "", "sigma_m and sigma_share are both 0"),
    ("max_range_m = 5.0", "max_range_m = 0.5", "no landmark is ever within"),
    ("radii_m", "radius_m", "landmarks.radius_m: is unknown, expected one of kind, centre, "),
    ("steps = 200", "steps = 1e99", "steps is 1e[+]99: unable to parse input string as an integer"),
    ("steps = 200", "steps = 0x1" + 4000 * "0", "steps is a whole number of more than 64 bits"),
    ("steps = 200", "steps = 1" + 5000 * "0", "not valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "reported"), SCENARIO_FAULTS)
def test_bad_scenarios(old: str, new: str, reported: str, scenario: Path, tmp_path: Path) -> None:
    text = scenario.read_text()
    assert old in text
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=reported) as fault:
        build_world(read_scenario(str(path)))
    assert "\n" not in str(fault.value)


def test_usage_faults_are_one_line(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "bad.toml").write_text("steps = 0\n")
    for arguments, reported in (
        ((str(tmp_path / "bad.toml"),), "bad.toml: "),
        ((str(scenario), "--out", str(tmp_path)), "already holds bad.toml"),
    ):
        assert reported in refused("montecarlo", *arguments, cwd=tmp_path)
    with pytest.raises(InputError, match="neither a file nor one of"):
        read_scenario("nowhere")
    with pytest.raises(InputError, match=r"filters\.1 is 'ukf': input should be 'ekf', 'fej', "):
        study_of(short("circle", 5), 1, "ekf", "ukf")
    with pytest.raises(InputError, match="filters: ekf is named twice"):
        study_of(short("circle", 5), 1, "ekf", "ekf")
    with pytest.raises(InputError, match="runs is 0: input should be greater than or equal to 1"):
        study_of(short("circle", 5), 0)
    for workers in (0, 10**23):
        with pytest.raises(InputError, match=f"--workers is {workers}"):
            run_study(study_of(short("circle", 5), 1), tmp_path / "w", workers=workers)


def test_without_dask_the_scheduler_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"slamcheck\[dask\]"):
        list(spread(abs, [(1,)], scheduler="tcp://127.0.0.1:1"))


def test_a_dask_cluster_computes_the_same(tmp_path: Path) -> None:
    distributed: ModuleType = pytest.importorskip("distributed")
    study = study_of(short("circle", 60), 30, "ekf", "fej")
    here = run_study(study, tmp_path / "here")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        there = run_study(study, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert there.computed == here.computed == 4
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


@pytest.mark.parametrize("name", bundled_scenarios())
def test_bundled_scenarios(name: str) -> None:
    scenario = read_scenario(name)
    assert scenario.from_paper
    assert scenario.ours
    world = build_world(scenario)
    assert len(world.landmark) >= 20
    data = measure(world, range(2))
    assert data.control.shape == (2, scenario.steps, 2)
    assert np.array_equal(measure(world, range(1, 2)).control[0], data.control[1])
    seen = np.concatenate(world.seen)
    revisited = [np.ptp(np.flatnonzero([i in s for s in world.seen])) for i in np.unique(seen)]
    assert np.median(revisited) > 0.4 * scenario.steps, "the path closes loops"


@pytest.mark.slow
def test_the_circle_shows_what_the_paper_does(tmp_path: Path) -> None:
    """50 runs: the standard EKF is above its band, those with the right null space are not."""
    outcome = run_study(study_of(short("circle", 1000), 50), tmp_path)
    place = {name: f.consistency["pose"].place for name, f in outcome.filters.items()}
    assert place.pop("ekf") == "above"
    assert set(place.values()) == {"inside"}
    rmse = {name: f.rmse["position"] for name, f in outcome.filters.items()}
    assert rmse["ideal"] < rmse["oc"] <= rmse["fej"] < rmse["ekf"]
    worse = [p for p in outcome.pairs if p.first == "ekf" and p.what == "pose_nees"]
    assert len(worse) == 4
    assert all(p.interval[0] > 0 for p in worse)


def test_montecarlo_json(finished: Path) -> None:
    result = json.loads((finished / "montecarlo.json").read_text())
    assert result["runs"] == 40
    assert set(result["filters"]) == {"ekf", "fej"}
    assert len(result["pairs"]) == 4
    assert result["filters"]["fej"]["consistency"]["heading"]["band"][0] < 1
