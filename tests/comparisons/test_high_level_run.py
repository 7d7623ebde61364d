"""High level landmarks in a whole run: found, kept, told to the smoother, and worth having."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import EkfChoices
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.cli.app import app
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.models import HighLevelResult
from comparisons.extensions.dense_maps.source import DenseOptions
from comparisons.extensions.high_level.source import SEARCHED, HighLevelOptions, HighLevelSource
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.pipeline.compare import Comparison, compare_estimators
from comparisons.report.result import build_result
from ekf_reference.dense.high_level import SearchOptions
from tests.helpers import Array, first_seconds

SEEDS = (1, 3)


@cache
def log(seed: int) -> Log:
    """A loop, and what was seen first once more."""
    return first_seconds(open_log("occupancy-loop", choices=SimulationChoices(seed, 2)), 108.0)


def driven(seed: int, source: HighLevelSource | None = None) -> EkfRun:
    choices = EkfChoices().settle(log(seed))
    return run_ekf(log(seed), build_timeline(log(seed)), choices, source=source)


@cache
def with_them(seed: int) -> Comparison:
    return compare_estimators(log(seed), high_level=HighLevelOptions())


def error_m(run: EkfRun, seed: int) -> float:
    """Of the vehicle, root mean square."""
    poses = log(seed).truth.poses
    assert poses is not None
    apart = run.departed[:, :2] - poses.at(run.estimate.time_s)[:, :2]
    return float(np.sqrt(np.square(apart).sum(axis=1).mean()))


def bits(run: EkfRun) -> list[Array]:
    e = run.estimate
    return [run.departed, e.pose_covariance, e.landmark, e.joint_covariance]


@pytest.mark.parametrize("seed", SEEDS)
def test_at_least_four_are_found_and_kept_and_the_estimates_agree(seed: int) -> None:
    found = with_them(seed)
    made = found.high_level
    assert made is not None
    assert np.count_nonzero(made.slot >= 0) >= 4
    assert len(found.ekf.estimate.oriented) == np.count_nonzero(made.slot >= 0)
    assert made.looks["seen"] > 30
    assert found.agreement.algebra.within(1e-6)
    assert found.agreement.model.within(1e-6)
    result = build_result(found, 0.0).high_level
    assert result is not None
    assert result.kept <= result.found == len(made.slot)


def test_the_vehicle_is_nearer_to_the_truth_with_them() -> None:
    """Paired; ten seeds in benchmarks/high_level.py."""
    pairs = [(error_m(driven(s), s), error_m(with_them(s).ekf, s)) for s in SEEDS]
    without, having = np.mean(pairs, axis=0)
    assert having < without


def test_they_stand_where_something_stands() -> None:
    """Every kept landmark's rectangle holds a part of a true object, moved with the map or not."""
    made, truth = with_them(1).high_level, log(1).truth.surfaces
    assert made is not None
    assert truth is not None
    middle = 0.5 * (truth.segment[:, :2] + truth.segment[:, 2:])
    near = [np.linalg.norm(middle - place[:2], axis=1).min() for place in made.place]
    assert max(near) < 9.0


def test_where_none_are_accepted_the_filter_is_the_same_to_the_bit() -> None:
    """Looking for them changes nothing; taking them does."""
    nothing = HighLevelSource(log(1), HighLevelOptions(search=SearchOptions(least=10**6)))
    searched, without = driven(1, nothing), driven(1)
    assert nothing.run().searches > 3
    assert nothing.run().poor == nothing.run().candidates > 0
    for ours, theirs in zip(bits(searched), bits(without), strict=True):
        assert np.array_equal(ours, theirs)
    assert not np.array_equal(bits(with_them(1).ekf)[0], bits(without)[0])


def test_blank_scans_show_no_landmark_and_leave_the_filter_alone() -> None:
    """To the bit; with its returns the same drive has landmarks."""
    short = first_seconds(log(1), 45.0)
    assert short.scans is not None
    blank = replace(short.scans, range_m=np.full_like(short.scans.range_m, np.nan))
    choices, timeline = EkfChoices().settle(short), build_timeline(short)
    sources = [HighLevelSource(replace(short, scans=s)) for s in (blank, short.scans)]
    runs = [run_ekf(short, timeline, choices, source=source) for source in (*sources, None)]
    found = [len(source.run().slot) for source in sources]
    assert found[0] == 0 < found[1]
    assert sources[0].run().searches == sources[1].run().searches > 1
    for ours, theirs in zip(bits(runs[0]), bits(runs[2]), strict=True):
        assert np.array_equal(ours, theirs)


def test_one_dense_map_serves_the_search_and_the_report_and_changes_no_bit() -> None:
    """And one with other cells does not serve it: then there are two, and again no bit changes."""
    beside = DenseOptions(("points",))
    short = first_seconds(log(1), 32.0)
    alone = compare_estimators(short, high_level=HighLevelOptions())
    both = compare_estimators(short, dense=beside, high_level=HighLevelOptions())
    other = replace(beside, resolution_m=0.4)
    two = compare_estimators(short, dense=other, high_level=HighLevelOptions())
    for one in (both, two):
        assert one.dense is not None
        assert list(one.dense.layers) == ["points"]
        for ours, theirs in zip(bits(one.ekf), bits(alone.ekf), strict=True):
            assert np.array_equal(ours, theirs)
        assert one.high_level is not None
        assert alone.high_level is not None
        assert dict(one.high_level.looks) == dict(alone.high_level.looks)
    assert both.dense is not None
    assert set(both.dense.dense.layers) == {"points", *SEARCHED}
    assert two.dense is not None
    assert set(two.dense.dense.layers) == {"points"}


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ((0.0, 7.0, 9, 20.0), "cell"),
        ((0.5, np.nan, 9, 20.0), "pair"),
        ((0.5, 7.0, 0, 20.0), "least"),
        ((0.5, 7.0, 9, -1.0), "every"),
    ],
)
def test_settings_that_cannot_be_are_refused(
    given: tuple[float, float, int, float], name: str
) -> None:
    with pytest.raises(InputError, match=f"--high-level-{name} is .*, expected"):
        HighLevelOptions.of(*given)


def test_usual_settings_are_those_of_the_options_and_others_arrive() -> None:
    assert HighLevelOptions.of(0.2, 12.0, 200, 20.0) == HighLevelOptions()
    nieto = HighLevelOptions.of(0.5, 7.0, 50, 60.0)  # section 6.5
    assert (nieto.kept.resolution_m, nieto.kept.d_min_m, nieto.search.cell_m) == (0.5, 0.5, 0.5)
    assert (nieto.search.pair_m, nieto.search.least, nieto.every_s) == (7.0, 50, 60.0)


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from comparisons.logs.log_folder import write_log_folder

    write_log_folder(first_seconds(log(1), 45.0), tmp_path / "log")
    run = ["run", str(tmp_path / "log"), "--out", str(tmp_path / "out"), "--high-level"]
    with pytest.raises(SystemExit) as wrong:
        app([*run, "yes"], standalone_mode=False)
    assert wrong.value.code == 2
    assert "expected off or on" in capsys.readouterr().err
    with pytest.raises(SystemExit) as wrong:
        app([*run, "on", "--high-level-pair", "0"], standalone_mode=False)
    assert wrong.value.code == 2
    assert "--high-level-pair is 0.0, expected 1 to 100" in capsys.readouterr().err
    with pytest.raises(SystemExit) as done:
        app([*run, "on", "--high-level-least", "190"], standalone_mode=False)
    assert done.value.code == 0
    assert "high level" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["high_level"]["searches"] == 2
    page = (tmp_path / "out" / "report.html").read_text()
    assert "high level" in page


def test_results_of_before_corners_were_counted_are_read() -> None:
    """Of a run side by side with an older one."""
    told = {"searches": 3, "candidates": 2, "poor": 1, "found": 1, "kept": 1, "looks": {"seen": 4}}
    assert HighLevelResult.model_validate(told).corners is None
