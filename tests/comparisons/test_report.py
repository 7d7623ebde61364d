import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.atomic import LIST, _write_list, check_replaceable, folder_name, fresh_folder
from comparisons.checks.gaps import GapsFinding
from comparisons.config import CheckConfig, MapConfig, RunConfig
from comparisons.errors import InputError
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import open_log
from comparisons.logs.hashing import log_hash
from comparisons.logs.log import Positions
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.pipeline.clock import Clock
from comparisons.report.destination import check_free, default_folder
from comparisons.report.folder import write_job_folder
from comparisons.report.marks import ellipses
from comparisons.report.models import Result
from comparisons.report.rows import seconds_rows
from comparisons.report.run import RunReport
from comparisons.settings import configure, run_config
from tests.helpers import altered, compared, present, random_covariance, simulated


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compared(simulated(seed=2, loop_s=20.0))


def test_ellipses_lie_at_their_sigmas() -> None:
    """Every point of a 3-sigma ellipse is at Mahalanobis distance 3."""
    rng = np.random.default_rng(0)
    covariance = np.array([random_covariance(rng, 2) for _ in range(4)])
    centre = rng.standard_normal((4, 2))
    offset = ellipses(centre, covariance, 3.0) - centre[:, None]
    distance = np.einsum("lpi,lij,lpj->lp", offset, np.linalg.inv(covariance), offset)
    assert np.allclose(distance, 9.0)


@pytest.mark.parametrize("stream", ["prior", "odometry", "measurements", "positions"])
def test_the_hash_sees_every_stream(stream: str) -> None:
    log = simulated(loop_s=5.0)
    changed = {
        "prior": replace(log, prior=replace(log.prior, time_s=-1e-9)),
        "odometry": replace(log, odometry=replace(log.odometry, time_s=log.odometry.time_s + 1e-9)),
        "positions": replace(
            log, positions=Positions(np.zeros(1), np.zeros((1, 2)), np.eye(2)[None])
        ),
        "measurements": replace(
            log, measurements=replace(log.measurements, range_m=log.measurements.range_m + 1e-9)
        ),
    }[stream]
    assert log_hash(changed) != log_hash(log)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["acfr_car_park", "victoria_park"])
def test_a_converted_log_keeps_its_hash(name: str, shared_data: Path, tmp_path: Path) -> None:
    log = open_log(str(shared_data / name))
    write_log_folder(log, tmp_path / "log")
    assert log_hash(read_log_folder(tmp_path / "log")) == log_hash(log)


def test_figures_that_do_not_exist_are_null(comparison: Comparison) -> None:
    gaps = GapsFinding(replace(comparison.agreement, algebra_gap_covariance=float("inf")))
    broken = altered(comparison, "known.findings", {**comparison.findings, "agreement": gaps})
    text = RunReport.build(broken).model_dump_json()
    assert '"algebra_gap_covariance":null' in text
    assert "Infinity" not in text


def test_other_peoples_folders_are_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path / "mine")
    for target in (Path(), Path(".."), Path("../mine")):
        with pytest.raises(InputError, match="is the current folder or holds it"):
            check_replaceable(target, "result.json")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "elsewhere")
    with fresh_folder(link) as work:
        (work / "x").write_text("")
    assert link.is_symlink()
    assert (tmp_path / "elsewhere" / "x").exists()


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("victoria-park", "victoria-park"),
        ("x/../../escaped", "x-..-..-escaped"),
        ("..", "log"),
        ("a\0b\x1b]0;t", "a-b--0-t"),
        ("日本", "log"),
        ("n" * 300, "n" * 80),
    ],
)
def test_a_logs_name_is_no_path(name: str, folder: str) -> None:
    assert folder_name(name) == folder
    assert "/" not in folder_name(name)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, ""),
        ({"figures": ["pdf"], "trace": True}, ""),
        ({"seed": 7, "noise_scale": 0.5}, "-seed-7-noise-scale-0.5"),
        ({"seed": 0, "filter": "full"}, ""),
        ({"association": "jcbb", "gps": "half"}, "-association-jcbb-gps-half"),
        ({"motion": "scan"}, "-motion-scan"),
        (
            {"landmarks": "scans", "template_extraction": "per-segment"},
            "-landmarks-scans-template-extraction-per-segment",
        ),
        ({"attributes": "on"}, "-attributes-on"),
        ({"dense": ["points", "sog"], "resolution": 0.4}, "-dense-points-sog-resolution-0.4"),
        ({"smoother_association": "ekf"}, "-smoother-association-ekf"),
        ({"preset": "nieto-2005"}, "-preset-nieto-2005"),
    ],
)
def test_a_folder_is_named_by_what_was_asked_for(options: dict[str, object], words: str) -> None:
    config = run_config(**options)
    assert default_folder(config, "my log").name == f"slamcheck-my-log{words}"
    again = RunConfig.of(**config.model_dump())
    assert default_folder(again, "my log").name == f"slamcheck-my-log{words}"


def test_other_jobs_folders_are_named_too() -> None:
    check = configure(CheckConfig, settings=["estimate=over/there/mine", "require=like"])
    assert default_folder(check, "x").name == "slamcheck-check-x-estimate-mine-require-like"
    base = {"extensions": {"dense_maps": {"layers": ["occupancy"]}}}
    plain = configure(MapConfig, over=base)
    assert default_folder(plain, "x", base).name == "slamcheck-map-x"
    mapped = configure(MapConfig, over=base, settings=["dense_maps.d_min_m=0.1"])
    assert default_folder(mapped, "x", base).name == "slamcheck-map-x-d-min-m-0.1"
    long = [configure(RunConfig, settings=["fail_on=truth,association,consistency", "log.loops=3",
                                           "smoother.robust=gnc", f"log.seed={seed}"])
            for seed in (1, 2)]  # fmt: skip
    names = [default_folder(one, "x").name for one in long]
    assert names[0] != names[1]
    assert all(len(name) <= len("slamcheck-x-") + 60 for name in names)


def test_a_folder_of_another_run_is_refused(comparison: Comparison, tmp_path: Path) -> None:
    """Settings, log and job decide; pictures and where the log lies do not."""
    folder = tmp_path / "run"
    config = run_config(seed=1).at_log("0" * 64)
    write_job_folder(replace(RunReport.of(comparison).folder(), config=config), folder)
    same = run_config(seed=1, figures=["pdf"]).at_log("0" * 64, "elsewhere")
    check_free(folder, same)
    others = {
        "with other settings .log.seed 1 there, 2 here": run_config(seed=2).at_log("1" * 64),
        "run of an earlier version of this log": run_config(seed=1).at_log("1" * 64),
        ".ekf.filter full there, compressed here": run_config(seed=1, filter="compressed").at_log(
            "0" * 64
        ),
        "of slamcheck 'run'": configure(CheckConfig, settings=["log.seed=1"]).at_log("0" * 64),
    }
    for words, other in others.items():
        with pytest.raises(InputError, match=f"holds a .*{words}.*--replace") as caught:
            check_free(folder, other)
        assert "\n" not in str(caught.value)
        check_free(folder, other, replace=True)
    path = folder / "config.toml"
    path.write_text(path.read_text().replace("[ekf]", "[kalman]"))
    with pytest.raises(InputError, match=r"config\.toml, which is not as it was written"):
        check_free(folder, same, replace=True)
    (folder / LIST).unlink()
    _write_list(folder)
    with pytest.raises(InputError, match="holds a run of another version of slamcheck"):
        check_free(folder, same)
    (folder / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=r"already holds mine\.txt"):
        check_free(folder, same, replace=True)


def test_processor_time_stands_beside_wall_time(comparison: Comparison) -> None:
    """A stage that waits takes none, and adds up; results from before have none."""
    clock = Clock()
    for _ in range(2):
        with clock.stage("waiting"):
            time.sleep(0.1)
    spent = clock.after()
    assert spent["seconds"]["waiting"] >= 0.2
    assert spent["cpu_s"]["waiting"] < 0.1
    result = RunReport.build(comparison, clock)
    assert list(present(result.cpu_s)) == list(result.seconds)
    old = json.loads(result.model_dump_json(by_alias=True))
    del old["cpu_s"]
    assert Result.model_validate(old).cpu_s is None
    assert {row.group for row in seconds_rows(old["seconds"], None)} == {"Wall time"}
