"""A study's folder repeats the study, and says what does not fit."""

import json
import os
import tomllib
from pathlib import Path
from typing import get_args

import pytest

from comparisons.experiments.montecarlo.config import FilterName, MonteCarloConfig, is_config
from comparisons.experiments.montecarlo.runs import FILTERS
from comparisons.experiments.montecarlo.study import read_study
from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from tests.commands import refused, works
from tests.comparisons.montecarlo.test_command import contents
from tests.comparisons.montecarlo.worlds import shortened


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """The circle, much shorter."""
    return shortened(tmp_path, 30).rename(tmp_path / "mine.toml")


@pytest.fixture
def finished(scenario: Path) -> Path:
    """A study's folder."""
    out = scenario.parent / "a"
    study = (str(scenario), "--runs", "4", "--filters", "riekf,ekf")
    works("montecarlo", *study, "--out", str(out), cwd=scenario.parent)
    return out


def assert_refused(*arguments: str, reported: tuple[str, ...], out: Path) -> None:
    said = refused("montecarlo", *arguments, "--out", str(out), cwd=out.parent)
    assert all(one in said for one in reported), said
    assert not out.exists()


@pytest.mark.slow
def test_a_study_is_repeated_from_its_folder(
    finished: Path, scenario: Path, tmp_path: Path
) -> None:
    config = str(finished / "config.toml")
    works("montecarlo", config, "--out", "b", cwd=tmp_path)
    assert contents(tmp_path / "b") == contents(finished)
    result = json.loads((finished / "montecarlo.json").read_text())
    written = tomllib.loads((finished / "config.toml").read_text())
    assert result["config"] == written == {
        "job": "montecarlo",
        "scenario": str(scenario.resolve()),
        "runs": 4,
        "filters": ["riekf", "ekf"],
        "commands": {},
        "sha256": read_scenario(str(scenario)).sha256,
    }  # fmt: skip
    assert list(result["filters"]) == ["riekf", "ekf"]
    more = ("--runs", "5", "--filters", "oc", "--out", "c")
    works("montecarlo", config, *more, cwd=tmp_path)
    result = json.loads((tmp_path / "c" / "montecarlo.json").read_text())
    assert (result["config"]["runs"], result["config"]["filters"]) == (5, ["oc"])


@pytest.mark.slow
def test_a_scenario_that_has_changed_is_refused(
    finished: Path, scenario: Path, tmp_path: Path
) -> None:
    config, text = str(finished / "config.toml"), scenario.read_text()
    scenario.write_text(text.replace("sigma_share = 0.1", "sigma_share = 0.2"))
    reported = (f"{scenario}: has changed since", "give --allow-changed-scenario")
    assert_refused(config, reported=reported, out=tmp_path / "b")
    works("montecarlo", config, "--allow-changed-scenario", "--out", "b", cwd=tmp_path)
    found, kept = (json.loads((tmp_path / x / "montecarlo.json").read_text()) for x in "ba")
    assert found["filters"] != kept["filters"]
    assert found["config"]["sha256"] == read_scenario(str(scenario)).sha256
    assert found["config"]["sha256"] != kept["config"]["sha256"]


def test_words_do_not_change_a_scenario(scenario: Path) -> None:
    study = read_study(MonteCarloConfig(scenario=str(scenario)))
    scenario.write_text(scenario.read_text().replace("Huang 2010", "a paper"))
    assert read_study(study.config).config == study.config


@pytest.mark.slow
def test_what_is_wrong_is_named_in_one_line(finished: Path, tmp_path: Path) -> None:
    text, mine, out = (finished / "config.toml").read_text(), tmp_path / "my.toml", tmp_path / "b"
    for change, reported in (
        (('"riekf"', '"ukf"'), ("filters.0 is 'ukf'", "'ekf', 'fej', 'oc', 'riekf' or 'ideal'")),
        (("runs = 4", "run = 4"), ("run: is unknown", "job, scenario, runs, filters, sha256")),
        (("runs = 4", "runs = 0"), ("runs is 0", "greater than or equal to 1")),
        (("runs = 4", "cls = 4"), ("cls: is unknown",)),
        (("runs = 4", "log = 4"), ("log: is unknown", "job, scenario, runs, filters, sha256")),
        (("montecarlo", "solve"), ("a configuration of slamcheck solve, not of montecarlo",)),
    ):
        assert change[0] in text
        mine.write_text(text.replace(*change, 1))
        assert_refused(str(mine), reported=(f"{mine}: ", *reported), out=out)
    assert_refused("--filters", "ekf,ukf", reported=("filters.1 is 'ukf'", "'ekf', 'fej'"), out=out)
    assert_refused(
        "--filters", ",", reported=("filters: empty, expected some of ekf, fej",), out=out
    )


def test_a_study_is_named_by_its_scenario_wherever_it_lies(scenario: Path) -> None:
    bare = scenario.with_suffix("")
    bare.write_text(scenario.read_text())
    assert [read_study(MonteCarloConfig(scenario=s)).name for s in map(str, (scenario, bare))] == [
        "mine",
        "mine",
    ]
    bundled = read_study(MonteCarloConfig())
    assert (bundled.name, bundled.config.scenario) == ("circle", "circle")


def test_a_path_that_no_settings_can_hold_is_refused_before_the_work(
    scenario: Path, tmp_path: Path
) -> None:
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("the file system has no such names")
    place = folder / "mine.toml"
    place.write_text(scenario.read_text())
    assert_refused(str(place), reported=("its full name is not UTF-8",), out=tmp_path / "b")


def test_settings_and_scenarios_are_told_apart(scenario: Path) -> None:
    assert not is_config(str(scenario))
    assert not is_config("circle")
    assert not {"job", "scenario"} & set(Scenario.model_fields)


def test_the_filters_are_those_that_there_are() -> None:
    assert get_args(FilterName) == tuple(FILTERS)


def test_the_command_prints_settings_that_can_be_used(tmp_path: Path) -> None:
    printed = works("config", "montecarlo", cwd=tmp_path)
    assert "# ekf | fej | oc | riekf | ideal\n" in printed
    assert MonteCarloConfig.of(**tomllib.loads(printed)) == MonteCarloConfig()
    schema = works("config", "montecarlo", "--schema", cwd=tmp_path)
    assert json.loads(schema)["title"] == "MonteCarloConfig"
    (tmp_path / "my.toml").write_text(printed)
    assert is_config(str(tmp_path / "my.toml"))
