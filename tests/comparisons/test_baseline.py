"""Baselines and the pytest plugin, as a gate in continuous integration."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from comparisons.baseline import (
    Baseline,
    build_baseline,
    compare_with,
    read_baseline,
    write_baseline,
    write_junit,
)
from comparisons.errors import InputError
from comparisons.logs.log_folder import write_log_folder
from comparisons.report.models import Result
from comparisons.report.result import build_result, metrics
from comparisons.settings import run_config
from tests.comparisons.test_cli import slamcheck
from tests.helpers import compared, simulated

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def result() -> Result:
    return build_result(compared(simulated(loop_s=20.0)))


@pytest.fixture
def kept(result: Result) -> Baseline:
    return build_baseline([result, result], run_config())


def changed(result: Result, **agreement: float | None) -> Result:
    """The result with other figures of agreement."""
    return result.model_copy(update={"agreement": result.agreement.model_copy(update=agreement)})


def test_the_same_run_holds(result: Result, kept: Baseline) -> None:
    changes = compare_with(kept, result)
    assert len(changes) > 40
    assert all(change.holds for change in changes)
    assert {"agreement.optimism", "accuracy.ekf.ate_m", "smoother.error"} <= set(kept.metrics)


@pytest.mark.parametrize(
    ("name", "factor", "holds"),
    [("optimism", 1.01, True), ("optimism", 1.05, False), ("linearisation_gap_sigma", 2.0, False)],
)
def test_figures_may_move_within_their_tolerance(
    result: Result, kept: Baseline, name: str, factor: float, holds: bool
) -> None:
    value = getattr(result.agreement, name)
    changes = compare_with(kept, changed(result, **{name: factor * value}))
    assert all(change.holds for change in changes) == holds


def test_rounding_may_be_any_rounding_but_no_more(result: Result, kept: Baseline) -> None:
    assert all(c.holds for c in compare_with(kept, changed(result, algebra_gap_sigma=5e-8)))
    broken = [c for c in compare_with(kept, changed(result, algebra_gap_sigma=5e-5)) if not c.holds]
    assert [c.name for c in broken] == ["agreement.algebra_gap_sigma"]


def test_a_figure_that_is_gone_is_no_figure_that_holds(result: Result, kept: Baseline) -> None:
    broken = [c for c in compare_with(kept, changed(result, optimism=None)) if not c.holds]
    assert "none now" in str(broken[0])


def test_a_count_that_older_baselines_lack_may_be_zero(result: Result, kept: Baseline) -> None:
    older = kept.model_copy(
        update={"metrics": {k: v for k, v in kept.metrics.items() if k != "ekf.retired"}}
    )
    assert all(c.holds for c in compare_with(older, result))
    retired = result.model_copy(update={"ekf": result.ekf.model_copy(update={"retired": 1})})
    assert [c.name for c in compare_with(older, retired) if not c.holds] == ["ekf.retired"]


def test_results_of_older_runs_are_read(result: Result) -> None:
    data = result.model_dump()
    for name in ("dynamic", "retired", "attributes"):
        del data["ekf"][name]
    del data["schema"], data["config"]
    older = Result.model_validate(data | {"scan_slam": None, "dense": None})
    assert older.schema_version == 1
    assert older.ekf == result.ekf


def test_repetitions_tell_the_noise_floor(result: Result) -> None:
    assert result.agreement.optimism is not None
    other = changed(result, optimism=1.2 * result.agreement.optimism)
    noisy = build_baseline([result, other], run_config())
    assert noisy.metrics["agreement.optimism"].tolerance == pytest.approx(
        0.6 * result.agreement.optimism
    )
    assert all(c.holds for c in compare_with(noisy, other))


def test_another_log_is_not_compared(kept: Baseline) -> None:
    other = build_result(compared(simulated(seed=1, loop_s=20.0)))
    with pytest.raises(InputError, match="save a new baseline"):
        compare_with(kept, other)


def test_files_round_trip_and_damage_is_named(tmp_path: Path, kept: Baseline) -> None:
    path = tmp_path / "b.json"
    write_baseline(kept, path)
    assert read_baseline(path) == kept
    data = json.loads(path.read_text())
    for damage in ("", "[]", "{}", json.dumps({**data, "strange": 1}), path.read_text()[:400]):
        path.write_text(damage)
        with pytest.raises(InputError, match="not a baseline"):
            read_baseline(path)
    path.write_text(json.dumps({**data, "version": 3}))
    with pytest.raises(InputError, match="version 3"):
        read_baseline(path)


def test_a_file_of_version_1_is_read_with_its_settings(tmp_path: Path, kept: Baseline) -> None:
    data = kept.model_dump()
    del data["config"]
    settings = {"filter": "compressed", "association": "", "gps": "off", "seed": 3, "format": ""}
    path = tmp_path / "b.json"
    path.write_text(json.dumps({**data, "version": 1, "settings": settings}))
    config = read_baseline(path).config_at("simulated-loop")
    assert (config.ekf.filter, config.ekf.association, config.log.seed) == ("compressed", None, 3)
    assert config.log.source == "simulated-loop"


def test_a_junit_report_says_what_broke(tmp_path: Path, result: Result, kept: Baseline) -> None:
    changes = compare_with(kept, changed(result, optimism=9.0))
    write_junit(changes, "a <log>", tmp_path / "report.xml")
    suite = ElementTree.parse(tmp_path / "report.xml").getroot()  # noqa: S314
    assert suite.get("failures") == "1"
    assert len(suite) == len(changes) == int(suite.get("tests", "0"))
    failed = [case for case in suite if len(case)]
    assert [case.get("name") for case in failed] == ["agreement.optimism"]
    assert "tolerance" in str(failed[0][0].get("message"))


def test_names_of_figures_are_those_of_the_result(result: Result) -> None:
    document = result.model_dump()
    for name, value in metrics(result).items():
        place: object = document
        for part in name.split("."):
            assert isinstance(place, dict)
            place = place[part]
        assert place == value


@pytest.mark.slow
def test_the_commands(tmp_path: Path) -> None:
    write_log_folder(simulated(loop_s=20.0), tmp_path / "log")
    saved = slamcheck("baseline", "save", "log", "b.json", cwd=tmp_path)
    assert saved.returncode == 0, saved.stderr
    same = slamcheck("baseline", "compare", "log", "b.json", "--junit", "j.xml", cwd=tmp_path)
    assert same.returncode == 0, same.stderr
    assert (tmp_path / "j.xml").exists()
    data = json.loads((tmp_path / "b.json").read_text())
    data["metrics"]["ekf.landmarks"]["value"] += 1
    (tmp_path / "b.json").write_text(json.dumps(data))
    other = slamcheck("baseline", "compare", "log", "b.json", cwd=tmp_path)
    assert other.returncode == 1
    assert "ekf.landmarks" in other.stdout
    missing = slamcheck("baseline", "compare", "log", "no.json", cwd=tmp_path)
    assert missing.returncode == 2
    assert len(missing.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_gate_of_a_run_with_extensions(tmp_path: Path) -> None:
    """Any option of `run` may be a baseline's; the comparison runs with all of them again."""
    options = ("--filter", "compressed", "--smoother-association", "own", "--robust", "huber")
    log = ("simulated-loop", "--seed", "2")
    saved = slamcheck("baseline", "save", *log, "b.json", *options, "--runs", "1", cwd=tmp_path)
    assert saved.returncode == 0, saved.stderr
    config = json.loads((tmp_path / "b.json").read_text())["config"]
    assert config["extensions"] == {"own_association": {"when": "always"}}
    same = slamcheck("baseline", "compare", "simulated-loop", "b.json", cwd=tmp_path)
    assert same.returncode == 0, same.stdout + same.stderr


@pytest.mark.slow
def test_the_plugin_judges_every_log_of_a_folder(tmp_path: Path) -> None:
    write_log_folder(simulated(loop_s=20.0), tmp_path / "logs" / "short")
    write_log_folder(simulated(seed=1, loop_s=20.0), tmp_path / "logs" / "other")
    (tmp_path / "pytest.ini").write_text("[pytest]\nslam_logs = logs\n")
    (tmp_path / "test_gate.py").write_text(
        "def test_log(slam_log, slam_check):\n"
        "    assert slam_check(slam_log).outcome == 'agree'\n"
        "    assert slam_log.name\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:slamcheck", "-p", "no:cacheprovider",
         "-p", "comparisons.pytest_plugin", "test_gate.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "test_log[other] PASSED" in done.stdout
    assert "test_log[short] PASSED" in done.stdout
