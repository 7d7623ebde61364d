"""Planted defects: each turns the right gap red and leaves the other green."""

from __future__ import annotations

import pytest

from comparisons.adapters.defects.registry import REGISTRY
from comparisons.checks.covariance_gap import ROUNDING
from comparisons.logs.log import Log
from comparisons.pipeline.compare import Modified
from tests.helpers import compared, simulated

GAPS = {
    "cross-covariance dropped at augmentation": "algebra",
    "cross-covariance dropped at prediction": "algebra",
    "gain not transposed": "algebra",
    "bearing Jacobian as printed": "model",
    "innovation not wrapped": "model",
    "sigma squared twice": "model",
    "steering sign": "model",
    "no heading column": "model",
}
PLANTS = {defect.name: defect.plant for defect in REGISTRY}
NAMED_FIRST = {
    "bearing Jacobian as printed": ("the innovation", "measurement updates"),
    "innovation not wrapped": ("the innovation", "measurement updates"),
    "sigma squared twice": ("the noise covariance", "measurement updates"),
    "steering sign": ("the predicted pose", "predictions"),
    "no heading column": ("the Jacobian with respect to heading", "measurement updates"),
}


@pytest.fixture(scope="module")
def log() -> Log:
    """Long enough for the heading to pass pi, so that an unwrapped innovation shows."""
    return simulated(seed=4, loop_s=60.0)


def test_the_sound_filter_is_green(log: Log) -> None:
    comparison = compared(log)
    assert comparison.verdict.outcome == "agree"
    assert comparison.agreement.algebra.within(1e-8)
    assert comparison.agreement.model.within(1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", GAPS)
def test_a_defect_turns_its_gap_red_and_only_that(name: str, log: Log) -> None:
    gap = GAPS[name]
    comparison = compared(log, Modified(PLANTS[name]))
    agreement = comparison.agreement
    red, green = (
        (agreement.algebra, agreement.model)
        if gap == "algebra"
        else (agreement.model, agreement.algebra)
    )
    assert max(red.sigma, red.covariance) > 1e3 * ROUNDING
    assert green.within(ROUNDING), f"{green}"
    assert comparison.verdict.outcome == "disagree"
    assert [cause.gap for cause in comparison.verdict.causes] == [gap]
    if gap == "model":
        quantity, relation = NAMED_FIRST[name]
        first = comparison.verdict.causes[0].evidence.split("; ")[1]
        how = "is missing" if name == "no heading column" else "differs"
        assert first.startswith(f"{quantity} {how}")
        assert first.endswith(relation)
