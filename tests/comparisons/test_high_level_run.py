"""High level landmarks in a whole run: found, kept, and told to filter and smoother."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import NoPoseLandmarkSource, PoseLandmarkSource
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig, RunConfig
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.extension import DenseMapsFinding
from comparisons.extensions.high_level.config import HighLevelConfig
from comparisons.extensions.high_level.extension import HighLevel, HighLevelFinding
from comparisons.extensions.high_level.source import SEARCHED, HighLevelOptions, HighLevelSource
from comparisons.figures import stored
from comparisons.jobs.run import Comparison
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.report.run import RunReport
from comparisons.settings import configure, run_config, run_options
from ekf_reference.scan_landmarks.high_level import SearchOptions
from tests.commands import works
from tests.helpers import Array, assert_followed, compared, first_seconds

SEEDS = (1, 3)


@cache
def log(seed: int) -> Log:
    """A loop, and what was seen first once more."""
    return first_seconds(open_log("occupancy-loop", choices=SimulationChoices(seed, 2)), 108.0)


def driven(seed: int, source: HighLevelSource | None = None) -> EkfRun:
    choices = settle(EkfConfig(), log(seed))
    setup = FilterSetup(source=source or NoPoseLandmarkSource())
    return run_ekf(log(seed), build_timeline(log(seed)), choices, setup=setup)


@cache
def with_them(seed: int) -> Comparison:
    return compared(log(seed), high_level=True)


def bits(run: EkfRun) -> list[Array]:
    e = run.estimate
    return [run.departed, e.pose_covariance, e.landmark, e.joint_covariance]


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_at_least_three_are_found_and_kept_and_the_estimates_agree(seed: int) -> None:
    found = with_them(seed)
    made = found.find(HighLevelFinding).made
    assert np.count_nonzero(made.landmark_index >= 0) >= 3
    assert len(found.ekf.estimate.pose_landmarks) == np.count_nonzero(made.landmark_index >= 0)
    assert made.looks["seen"] > 20
    assert_followed(found, 1e-6)
    assert (RunReport.build(found).model_extra or {})["high_level"] == stored(made)
    assert made.kept <= made.found == len(made.landmark_index)


@pytest.mark.slow
def test_the_filter_is_told_what_the_alignments_were(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every z of them, and R in the landmark's frame; no gate tells an R that is too small."""
    source, kept = HighLevelSource(log(1)), list[Any]()
    look = source.landmarks.look

    def looking(*given: Any) -> list[Any]:
        seen = look(*given)
        kept.extend(seen)
        return seen

    monkeypatch.setattr(source.landmarks, "look", looking)
    told = driven(1, source).pose_landmarks
    assert len(kept) > 5
    assert np.array_equal(told.measured, [one.z for one in kept])
    known = np.linalg.det([one.covariance for one in kept])  # the same in any frame
    assert np.allclose(np.linalg.det(told.covariance), known, rtol=1e-6, atol=0.0)


@pytest.mark.slow
def test_they_stand_where_something_stands() -> None:
    """Every kept landmark's rectangle holds a part of a true object, moved with the map or not."""
    made, truth = with_them(1).find(HighLevelFinding).made, log(1).truth.surfaces
    assert truth is not None
    middle = 0.5 * (truth.segment[:, :2] + truth.segment[:, 2:])
    near = [np.linalg.norm(middle - place[:2], axis=1).min() for place in made.place]
    assert max(near) < 9.0


@pytest.mark.slow
def test_where_none_are_accepted_the_filter_is_the_same_to_the_bit() -> None:
    """Looking for them changes nothing; taking them does."""
    nothing = HighLevelSource(log(1), HighLevelOptions(search=SearchOptions(least=10**6)))
    searched, without = driven(1, nothing), driven(1)
    assert nothing.run().searches > 3
    assert nothing.run().poor == nothing.run().candidates > 0
    for ours, theirs in zip(bits(searched), bits(without), strict=True):
        assert np.array_equal(ours, theirs)
    assert not np.array_equal(bits(with_them(1).ekf)[0], bits(without)[0])


@pytest.mark.slow
def test_blank_scans_show_no_landmark_and_leave_the_filter_alone() -> None:
    """To the bit; with its returns the same drive has landmarks."""
    short = first_seconds(log(1), 45.0)
    assert short.scans is not None
    blank = replace(short.scans, range_m=np.full_like(short.scans.range_m, np.nan))
    choices, timeline = settle(EkfConfig(), short), build_timeline(short)
    sources = [HighLevelSource(replace(short, scans=s)) for s in (blank, short.scans)]
    seeing: list[PoseLandmarkSource] = [*sources, NoPoseLandmarkSource()]
    setups = [FilterSetup(source=source) for source in seeing]
    runs = [run_ekf(short, timeline, choices, setup=setup) for setup in setups]
    found = [len(source.run().landmark_index) for source in sources]
    assert found[0] == 0 < found[1]
    assert sources[0].run().searches == sources[1].run().searches > 1
    for ours, theirs in zip(bits(runs[0]), bits(runs[2]), strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.slow
def test_one_dense_map_serves_the_search_and_the_report_and_changes_no_bit() -> None:
    """And one with other cells does not serve it: then there are two, and again no bit changes."""
    short = first_seconds(log(1), 32.0)
    alone = compared(short, high_level=True)
    both = compared(short, dense=["points"], high_level=True)
    two = compared(short, dense=["points"], resolution=0.4, high_level=True)
    for one in (both, two):
        assert list(one.find(DenseMapsFinding).dense.layers) == ["points"]
        for ours, theirs in zip(bits(one.ekf), bits(alone.ekf), strict=True):
            assert np.array_equal(ours, theirs)
        looks = [dict(c.find(HighLevelFinding).made.looks) for c in (one, alone)]
        assert looks[0] == looks[1]
    kept = [set(c.find(DenseMapsFinding).dense.dense.layers) for c in (both, two)]
    assert kept == [{"points", *SEARCHED}, {"points"}]


def test_usual_settings_are_those_of_the_options_and_others_arrive() -> None:
    usual = HighLevelConfig(cell_m=0.2, pair_m=12.0, least=200, every_s=20.0)
    assert usual == HighLevelConfig()
    assert HighLevelOptions.of(usual) == HighLevelOptions()
    values = {"cell_m": 0.5, "pair_m": 7.0, "least": 50, "every_s": 60.0}  # section 6.5
    config = RunConfig.of(extensions={"high_level": values}).extensions["high_level"]
    assert isinstance(config, HighLevelConfig)
    nieto = HighLevelOptions.of(config)
    assert (nieto.kept.resolution_m, nieto.kept.d_min_m, nieto.search.cell_m) == (0.5, 0.5, 0.5)
    assert (nieto.search.pair_m, nieto.search.least, nieto.every_s) == (7.0, 50, 60.0)


def test_the_preset_reaches_the_map_that_is_searched() -> None:
    def searched(preset: str) -> DenseMapsConfig:
        config = run_config(high_level=True, preset=preset)
        found = config.extensions["high_level"].build(config)
        assert isinstance(found, HighLevel)
        return found.options.kept

    assert searched("nieto-2005").known_apart_m == 0.0  # N 3.5, its first condition
    assert searched("recommended") == HighLevelOptions().kept  # broken: the same for both
    assert searched("recommended").bounds.known_apart_m > 0.0


def test_settings_of_dense_maps_reach_the_map_that_is_searched() -> None:
    config = configure(
        RunConfig,
        flags=run_options({"high_level": True, "dense": ["points"], "dynamic": True}),
        settings=["dense_maps.known_apart_m=0.2"],
    )
    found = config.extensions["high_level"].build(config)
    assert isinstance(found, HighLevel)
    assert (found.options.kept.known_apart_m, found.options.kept.detect_motion) == (0.2, False)
    dense = config.extensions["dense_maps"]
    assert isinstance(dense, DenseMapsConfig)
    assert found.options.served_by(dense)


@pytest.mark.slow
def test_the_command_line(tmp_path: Path) -> None:
    from comparisons.logs.log_folder import write_log_folder

    write_log_folder(first_seconds(log(1), 45.0), tmp_path / "log")
    run = ("run", "log", "--out", "out", "--high-level", "--set")
    assert "High level landmarks\n" in works(*run, "high_level.least=190", "-v", cwd=tmp_path)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["high_level"]["searches"] == 2
    page = (tmp_path / "out" / "report.html").read_text()
    assert "high level" in page
