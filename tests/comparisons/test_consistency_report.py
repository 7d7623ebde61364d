"""Consistency in a run: its trace, its JSON, its rows and its picture."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import fused_positions, settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.consistency.consistency import Consistency, check_innovations
from comparisons.checks.consistency.finding import (
    consistency_lines,
    consistency_result,
    nees_rows,
)
from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.config import EkfConfig
from comparisons.faults.fault import with_state
from comparisons.jobs.run import Comparison, Modified
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log, Positions
from comparisons.report.figures.run import consistency_figure
from comparisons.report.panels import consistency_panels
from comparisons.report.picture import save
from comparisons.report.run import RunReport
from comparisons.statistics import Band, Normalised
from ekf_reference.core.geometry import Array
from ekf_reference.core.state import KalmanState
from tests.helpers import compared, first_seconds, present, simulated


def with_positions(log: Log, sigma_m: float = 0.2) -> Log:
    """GPS every second, as true as it states."""
    time_s = np.arange(1.0, log.end_s, 1.0)
    noise = sigma_m * np.random.default_rng(0).standard_normal((len(time_s), 2))
    at = present(log.truth.poses).at(time_s)[:, :2] + noise
    covariance = np.tile(sigma_m**2 * np.eye(2), (len(time_s), 1, 1))
    return replace(log, positions=Positions(time_s, at, covariance))


@pytest.fixture(scope="module")
def short() -> Log:
    return with_positions(first_seconds(simulated(seed=2), 20.0))


def test_fixes_fused_in_parts_count_once_with_the_whole_s(short: Log) -> None:
    choices = settle(EkfConfig(filter="full", gps="on"), short)
    positions = fused_positions(short, choices)
    run = run_ekf(short, build_timeline(short, positions), choices, positions)
    found = check_innovations(run)[1]
    assert found.nis[0].count == len(run.fix_number)
    assert found.nis[0].reading == "plausible"


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    log = open_log("simulated-loop", None, 1, SimulationChoices(3, 1, 1.0))
    return compared(with_positions(log), gps="on")


def never(name: str) -> float:
    raise AssertionError(f"{name} in JSON")


def test_result_and_rows(comparison: Comparison) -> None:
    result = RunReport.build(comparison)
    found = json.loads(result.model_dump_json(), parse_constant=never)["consistency"]
    assert found["ekf"]["pose"]["dof"] == 3
    assert found["ekf"]["distances"]["dof"] == 60
    assert [one["sensor"] for one in found["innovations"]] == ["measurements", "positions"]
    assert found["filter_against_smoother"]["epochs"] == len(comparison.ekf.timeline.epoch_time_s)
    groups = {row.group.partition(" (")[0] for row in RunReport.of(comparison).summary().rows}
    assert {"EKF NEES", "Innovations of measurements", "EKF", "Smoother"} < groups
    (line,) = (
        text for label, text in RunReport(comparison, result).summary().lines if label[0] == "c"
    )
    if not result.inconsistent:
        assert re.fullmatch(
            r"per dof, expect 1: NEES pose \S+, map \S+; NIS \S+; vs smoother \S+", line
        )


def test_a_broken_covariance_gives_no_nan() -> None:
    class Ruined(KalmanState):
        def predict(self, pose: Array, jacobian_pose: Array, noise: Array) -> None:
            super().predict(pose, jacobian_pose, noise)
            self._covariance[0, 1] += 1e-3

    c = compared(first_seconds(simulated(seed=2), 10.0), Modified(with_state(Ruined)))
    text = RunReport.build(c).model_dump_json()
    found = json.loads(text, parse_constant=never)["consistency"]
    for part in (found["ekf"]["pose"], found["filter_against_smoother"]):
        assert "asymmetric" in part["unusable"]
        assert sum(part["unusable"].values()) > 3
    consistency_figure(c, consistency_panels(c))


def test_the_picture_is_drawn(comparison: Comparison, tmp_path: Path) -> None:
    save(
        consistency_figure(comparison, consistency_panels(comparison)), tmp_path / "consistency.png"
    )
    assert (tmp_path / "consistency.png").stat().st_size > 50_000


def test_without_truth_the_smoother_is_the_measure(short: Log, tmp_path: Path) -> None:
    blind = replace(short, truth=type(short.truth)())
    c = compared(blind)
    assert c.consistency.ekf is None
    assert c.consistency.smoothed is not None
    save(consistency_figure(c, consistency_panels(c)), tmp_path / "smoother.png")
    robust = compared(blind, robust="huber")
    assert robust.consistency.smoothed is None
    save(consistency_figure(robust, consistency_panels(robust)), tmp_path / "robust.png")


@pytest.mark.parametrize("mean", [2.0, 10.0])
@pytest.mark.parametrize("unusable", [{}, {"not positive definite": 4}])
def test_a_nees_has_its_band_and_what_has_none(unusable: dict[str, int], mean: float) -> None:
    pose = Normalised(
        dof=3,
        count=23,
        mean=mean,
        last=2.0,
        single_band=Band(0.22, 9.35),
        inside=0.5,
        unusable=unusable,
        row=np.arange(23),
        squared=np.full(23, mean),
    )
    *rest, found, share = nees_rows("My", TruthConsistency(pose=pose))
    assert found[:2] == ("My NEES (95 % bands)", "pose, mean (expected 3)")
    assert found[2:] == (f"{mean:.3g}", "0.22 to 9.35", mean == 2.0)
    assert share[1:3] == ("pose: epochs in the band", "50 % of 23")
    assert [(row.quantity, row.value) for row in rest] == [
        (f"pose: NEES not computed, {why}", str(count)) for why, count in unusable.items()
    ]


def test_what_is_outside_stands_before_its_band_and_in_short() -> None:
    """The value that matters is in the first line, which long words would push out of it."""
    found = (
        "NEES of the poses 12 per degree of freedom, limit 5.4",
        "filter-smoother difference 26 per degree of freedom, band 0.24 to 2.3",
        "filter more certain than the smoother at 6185 of 6969 epochs",
    )
    nothing = consistency_result(Consistency(None, None, (), None, gated=False))
    ((label, text),) = consistency_lines(found, nothing)
    assert label == "consistency"
    assert text == (
        "outside, per dof: NEES poses 12 (<= 5.4); vs smoother 26 (0.24 to 2.3); "
        "more certain than smoother at 6185 of 6969 epochs"
    )
