"""Dynamic regions of whole drives (Nieto 2005, section 6.3.3), and a filter that keeps off them."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import assess
from comparisons.config import EkfConfig, MapConfig
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.report import MapResult
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.simulate.dynamic_worlds import LANES_M, Displaced
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dynamic_lanes,
    dynamic_places,
    simulate,
)
from comparisons.logs.simulate.scan_worlds import Mover, Moving
from ekf_reference.dense.dynamic import Differencing, DynamicLayer
from research.documents.nieto_motion import middles, score_dynamic
from tests.commands import works
from tests.helpers import compared, present

LOOKING = DenseMapsConfig(layers=(), detect_motion=True)


def shortened(experiment: ScanExperiment, seconds: float) -> ScanExperiment:
    return replace(experiment, drive=replace(experiment.drive, loop_s=seconds))


def mapped(
    experiment: ScanExperiment, seed: int = 0, preset: str = "recommended"
) -> tuple[DenseMapping, DynamicLayer]:
    log = simulate(np.random.default_rng(seed), experiment)
    mapping = map_log(log, MapConfig.of(preset=preset, extensions={"dynamic": {}}))
    return mapping, present(mapping.dense.dense.dynamic)


@pytest.mark.parametrize(
    ("preset", "rule"),
    [
        ("recommended", Differencing()),
        (
            "nieto-2005",
            Differencing(look_s=1.0, absence_s=150.0, threshold=0.5, slow_threshold=0.5),
        ),
    ],
)
def test_the_preset_reaches_the_rule_of_what_moves(preset: str, rule: Differencing) -> None:
    """Section 6.3.3: every second, cells whose occupancy differs by more than 0.5."""
    _, layer = mapped(shortened(dynamic_lanes(), 1.0), preset=preset)
    assert layer.rule == rule


@pytest.mark.slow
def test_both_lanes_are_found() -> None:
    """Against the ground that the vehicles' bodies covered, of all that was ever seen."""
    experiment = dynamic_lanes()
    mapping, layer = mapped(experiment)
    duration_s = mapping.log.duration_s
    score = score_dynamic(layer, mapping.placed, experiment.world.movers, duration_s)
    assert score.precision > 0.9
    assert score.recall > 0.9
    assert sorted(score.middle[:, 1]) == pytest.approx(sorted(LANES_M), abs=0.3)


def changed_places(movers: Iterable[Moving]) -> Array:
    """(P, 2) [m] where displaced ones stood and stand."""
    places = [
        place
        for mover in movers
        if isinstance(mover, Displaced)
        for place in (mover.before, mover.after)
        if place is not None
    ]
    return np.array(places, dtype=float).reshape(-1, 2)


@pytest.mark.slow
def test_exactly_the_three_changed_places_are_found() -> None:
    experiment = dynamic_places()
    mapping, layer = mapped(experiment)
    middle = middles(layer.points(mapping.placed))
    assert len(middle) == 3
    changed = changed_places(experiment.world.movers)
    apart = np.linalg.norm(middle[:, None] - changed[None], axis=2)
    assert sorted(apart.argmin(axis=0).tolist()) == [0, 1, 2]
    assert apart.min(axis=0).max() < 1.3  # only the sides that were seen
    assert layer.counters.slow > 50


@pytest.mark.slow
@pytest.mark.parametrize("experiment", [shortened(dynamic_lanes(), 10.0), dynamic_places()])
def test_where_nothing_moves_nothing_is_found(experiment: ScanExperiment) -> None:
    still = replace(experiment, world=replace(experiment.world, movers=()))
    mapping, layer = mapped(still)
    assert layer.counters.compared > 200
    assert not len(layer.points(mapping.placed))
    assert not mapping.ekf.unused["dynamic"]


def run(log: Log, filter_name: str = "full", *, guarded: bool) -> EkfRun:
    setup = FilterSetup()
    if guarded:
        setup.guard = watcher = DenseWatcher(log, LOOKING)
        setup.observers.append(watcher)
    config = settle(EkfConfig.model_validate({"filter": filter_name}), log)
    return run_ekf(log, build_timeline(log), config, setup=setup)


@pytest.fixture(scope="module")
def carried() -> list[Log]:
    experiment = shortened(dynamic_lanes(carried=True), 12.0)
    return [simulate(np.random.default_rng(seed), experiment) for seed in range(3)]


@pytest.mark.slow
def test_a_landmark_on_a_vehicle_is_removed_and_the_error_is_smaller(carried: list[Log]) -> None:
    for log in carried:
        moving = int(log.measurements.landmark.max())
        without, within = run(log, guarded=False), run(log, guarded=True)
        assert moving in within.estimate.landmark_id[within.deactivated]
        assert len(within.deactivated) <= 3
        assert within.unused["dynamic"] > 20
        assert not without.unused["dynamic"]
        bad, good = (assess(r.estimate, log, labelled=True) for r in (without, within))
        assert bad is not None
        assert good is not None
        assert (good.ate_m or 9.0) < 0.5 * (bad.ate_m or 0.0)
        assert (good.landmark_rmse_m or 9.0) < 0.5 * (bad.landmark_rmse_m or 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("filter_name", ["full", "compressed"])
def test_a_landmark_that_was_taken_away_leaves_the_map(filter_name: str) -> None:
    """Nieto 2005, Fig. 6.20, where it stood on a car that has left."""
    log = simulate(np.random.default_rng(0), dynamic_places(carried=True))
    done = run(log, filter_name, guarded=True)
    assert done.estimate.landmark_id[done.deactivated].tolist() == [log.measurements.landmark.max()]


@pytest.fixture(scope="module")
def comparison(carried: list[Log]) -> Comparison:
    """What was measured of moving things before they were found out raises chi-square."""
    return compared(carried[1], dynamic=True, accept_misfit=True)


@pytest.mark.slow
def test_the_frozen_smoothers_stay_exact(comparison: Comparison) -> None:
    gaps = comparison.agreement.algebra, comparison.agreement.model
    assert max(g.sigma for g in gaps) < 1e-8
    assert max(g.covariance for g in gaps) < 1e-8
    assert comparison.verdict.outcome == "agree"
    assert any("--accept-misfit" in remark for remark in comparison.verdict.remarks)
    reported = " ".join(comparison.verdict.remarks)
    assert " dynamic" in reported
    assert "something moves in" in reported
    assert "are deactivated because something moves" in reported


def all_moving() -> ScanExperiment:
    """Every landmark rides on something, each its own way."""
    experiment = shortened(dynamic_lanes(), 6.0)
    turn = 2.4 * np.arange(10.0)
    start = np.column_stack((9.0 + 6.0 * np.cos(turn), 5.0 * np.sin(turn)))
    end = start + 6.0 * np.column_stack((np.cos(1.7 * turn), np.sin(1.7 * turn)))
    movers = tuple(
        Mover(start=(a[0], a[1]), end=(b[0], b[1]), speed_mps=1.5, diameter_m=0.8)
        for a, b in zip(start, end, strict=True)
    )
    nothing = np.zeros((0, 2))
    world = replace(
        experiment.world,
        landmark=nothing,
        outline=(),
        outline_height_m=np.zeros(0),
        pole=np.zeros((0, 3)),
        pole_height_m=np.zeros(0),
        movers=movers,
        carrier=tuple(range(10)),
    )
    return replace(experiment, world=world)


@pytest.mark.slow
def test_a_scene_that_is_all_moving_is_said_to_be_beyond_it() -> None:
    """As dense.dynamic documents: it takes landmarks that stand still."""
    log = simulate(np.random.default_rng(0), all_moving())
    comparison = compared(log, dynamic=True)
    assert comparison.ekf.breakdown is None
    assert comparison.verdict.outcome != "agree"
    assert any("hardly be detected" in remark for remark in comparison.verdict.remarks)


@pytest.mark.slow
def test_scan_landmarks_of_a_scene_that_is_all_moving_are_hardly_ever_used() -> None:
    """As the README says: the pose stays the odometry's. Were all that stands still, they are."""
    moving = all_moving()
    movers = tuple(replace(m, speed_mps=0.0) for m in moving.world.movers)  # type: ignore[type-var]
    still = replace(moving, world=replace(moving.world, movers=movers))
    found = [
        compared(simulate(np.random.default_rng(0), e), landmarks="scans") for e in (moving, still)
    ]
    assert [c.ekf.breakdown for c in found] == [None, None]
    assert found[1].verdict.outcome == "agree"
    assessed = found[0].accuracy
    ours, wheels = (a.ate_m for a in (assessed.ekf, assessed.dead_reckoning) if a)
    assert ours == pytest.approx(wheels, abs=0.05)
    reasons = [c.find(ScanLandmarksFinding).source.found.reasons for c in found]
    share = [r["used"] / sum(r.values()) for r in reasons]
    assert share[0] < 0.2
    assert share[1] > 0.9


@pytest.mark.slow
def test_the_commands_write_and_tell(tmp_path: Path) -> None:
    printed = works("map", "dynamic-places", "-v", "--dynamic", "--out", "map", cwd=tmp_path)
    folder = tmp_path / "map"
    result = MapResult.model_validate_json((folder / "map.json").read_text())
    assert present(result.dynamic).places == 3
    assert "Moving objects\n  places  " in printed
    for name in ("dynamic.png", "dynamic-map.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    assert len((folder / "dynamic.pgw").read_text().splitlines()) == 6
    arguments = ("run", "dynamic-lanes", "--dynamic", "--accept-misfit", "--out", "run")
    works(*arguments, cwd=tmp_path)
    ekf = json.loads((tmp_path / "run" / "result.json").read_text())["ekf"]
    assert ekf["dynamic"] > 100
    assert ekf["deactivated"] >= 1
