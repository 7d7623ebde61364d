"""Misono's filter, as published and with all of its Jacobian, as the comparison sees it."""

from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import (
    build_association,
    build_ekf,
    d_min_exceeds_way,
    longest_sample_m,
)
from comparisons.config import EkfConfig
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from comparisons.rounding import ROUNDING
from comparisons.settings import run_config
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour
from ekf_reference.core.trace import Trace
from tests.helpers import assert_followed, compared, simulated


@pytest.fixture(scope="module")
def log() -> Log:
    return simulated(seed=3, loop_s=60.0)


@pytest.fixture(scope="module")
def published(log: Log) -> Comparison:
    return compared(log, filter="misono")


@pytest.mark.parametrize("seed", [0, 1])
def test_the_full_jacobian_has_no_gap(seed: int) -> None:
    comparison = compared(simulated(seed, loop_s=40.0), filter="misono-full")
    assert_followed(comparison, 1e-8)
    assert comparison.verdict.outcome == "agree"


def test_the_report_names_the_missing_columns(published: Comparison) -> None:
    """As published: right algebra, and a model whose Jacobian knows no heading."""
    assert published.agreement.algebra.within(ROUNDING)
    assert published.agreement.model.sigma > 0.1
    [cause] = published.verdict.causes
    assert cause.gap == "model"
    assert "the Jacobian with respect to heading is missing in" in cause.evidence
    assert "measurement updates" in cause.evidence
    assert "the Jacobian with respect to heading" in cause.hint


def test_a_waypoint_run_with_positions_has_no_gap() -> None:
    log = simulate(np.random.default_rng(2), WaypointRun(most_s=60.0))
    for name in ("misono-full", "misono"):
        comparison = compared(log, filter=name, gps="on")
        assert len(comparison.ekf.fix_number) > 3
        assert comparison.agreement.algebra.within(ROUNDING)
        assert comparison.agreement.model.within(ROUNDING) is (name == "misono-full")


@pytest.mark.parametrize(("name", "gated"), [("misono", False), ("misono-full", True)])
def test_the_published_filter_has_no_gate(log: Log, name: str, gated: bool) -> None:
    log = replace(log, measurements=replace(log.measurements, label_gate=50.0))
    ekf = build_ekf(log, EkfConfig(filter=name, association="known"), Trace())
    assert isinstance(ekf.association, KnownAssociation)
    assert np.isfinite([ekf.association.gate, ekf.fixes.gate]).tolist() == [gated, gated]


def test_eq_17_reaches_farther_than_one_sample(log: Log) -> None:
    """Misono 2007, section 3.4: d_min is larger than the way of one sampling time."""
    choices = EkfConfig(filter="misono", association="euclidean")
    for displacement, d_min_m in ((0.1, 1.0), (1.5, 3.0)):
        way = RelativePoses(np.ones(1), np.array([[displacement, 0.0, 0.0]]), np.eye(3)[None])
        rule = build_association(replace(log, odometry=way), choices)
        assert isinstance(rule, EuclideanNeighbour)
        assert rule.d_min_m == d_min_m
    assert longest_sample_m(log) < 1.0
    assert d_min_exceeds_way()


def test_the_preset_takes_eq_17() -> None:
    chosen = run_config(preset="misono-2007", filter="misono")
    assert chosen.ekf.association == "euclidean"
    assert run_config(preset="misono-2007").ekf.association is None
    assert run_config(preset="nieto-2005", filter="misono").ekf.association is None
