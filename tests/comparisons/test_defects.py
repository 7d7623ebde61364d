"""Planted defects: every one is caught, and named; a sound filter is not."""

from __future__ import annotations

import pytest

from comparisons.compare import compare_estimators
from comparisons.defects.catalogue import CATALOGUE, named_first, run_defect
from comparisons.defects.defect import Defect
from comparisons.defects.logs import LOGS, open_case
from tests.helpers import simulated

SEEDS = 12


def test_the_catalogue_is_broad_and_without_copies() -> None:
    assert len(CATALOGUE) >= 20
    assert len({defect.name for defect in CATALOGUE}) == len(CATALOGUE)
    assert {defect.log for defect in CATALOGUE} == set(LOGS)


@pytest.mark.parametrize("defect", CATALOGUE, ids=lambda defect: defect.name)
def test_a_defect_is_caught_and_named_first(defect: Defect) -> None:
    verdict = run_defect(defect).verdict
    assert verdict.outcome == "disagree"
    assert named_first(defect, verdict), f"{verdict.causes[0]}"


@pytest.mark.parametrize("name", LOGS)
def test_a_sound_filter_passes_the_logs_that_show_defects(name: str) -> None:
    verdict = compare_estimators(*open_case(name, seed=4)).verdict
    assert verdict.outcome == "agree", f"{verdict.causes}"
    assert not verdict.causes


@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_sound_filter_is_not_flagged(seed: int) -> None:
    verdict = compare_estimators(simulated(seed=seed, loop_s=30.0, noise_scale=0.3)).verdict
    assert verdict.outcome == "agree", f"{verdict.causes}"


def test_a_log_that_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="expected one of loop"):
        open_case("night", seed=0)
