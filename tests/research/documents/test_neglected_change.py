"""What dense regions neglect, on simulated drives that close a loop (Nieto 2005, section 3.6)."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from comparisons.errors import InputError
from comparisons.logs.log import Log, Truth
from comparisons.logs.simulate.scan_drive import dense_slam, occupancy, simulate
from tests.ekf_reference.dense.passive_states import StaleCross
from tests.helpers import simulated
from tests.research.documents import neglected_change as check
from tests.research.documents.neglected_change import NeglectedChange, correlation, neglected_change

SEEDS = range(4)
SICK = (0.02, math.radians(0.1))
DRIVES = ("scan-loop", "occupancy-loop", "landmarks")


def drive(name: str, seed: int) -> Log:
    if name == "landmarks":
        return simulated(seed, extra_s=10.0)
    experiment = dense_slam() if name == "scan-loop" else occupancy()
    return simulate(np.random.default_rng(seed), experiment)


@cache
def changes(name: str, seed: int, sigma: tuple[float, float] = SICK) -> NeglectedChange:
    return neglected_change(drive(name, seed), sigma, np.random.default_rng(100 + seed))


def pooled(name: str, sigma: tuple[float, float] = SICK) -> NeglectedChange:
    each = [vars(changes(name, seed, sigma)).values() for seed in SEEDS]
    return NeglectedChange(*(np.concatenate(column) for column in zip(*each, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_equation_3_16_predicts_what_a_filter_with_the_points_observes(name: str) -> None:
    for seed in SEEDS:
        found = changes(name, seed)
        size = [np.linalg.norm(x, axis=1) for x in (found.predicted, found.observed)]
        assert len(found.time_s) > 10
        assert found.agreement > 0.99
        assert np.corrcoef(*size)[0, 1] > 0.98
        assert size[1].max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_against_the_truth_it_explains_what_later_scans_can_know(name: str) -> None:
    """Some 0.7 with exact beams, unbiased: the rest of the error no later scan tells."""
    found = pooled(name)
    assert 0.55 < found.explained < 0.85
    assert 0.5 < found.expected < 0.8
    assert 0.8 < found.slope < 1.25
    left = found.error - found.predicted
    assert np.square(left).sum() < 0.75 * np.square(found.error).sum()


@pytest.mark.slow
def test_the_noise_of_a_single_beam_hides_it() -> None:
    """With Table 4.1's sigmas; a dense map averages over many beams."""
    assert pooled("occupancy-loop", (0.10, math.radians(1.0))).explained < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_the_error_layer_bounds_the_change_beforehand(name: str) -> None:
    found = pooled(name)
    assert (found.in_sigmas < 2.0).mean() > 0.95
    assert 0.4 < np.median(found.in_sigmas) < 1.0


@pytest.mark.slow
def test_the_agreement_rejects_a_stale_covariance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "PassiveStates", StaleCross)
    broken = neglected_change(drive("landmarks", 0), SICK, np.random.default_rng(100))
    assert broken.agreement < 0.8


@pytest.mark.slow
def test_nothing_changes_in_a_drive_without_noise() -> None:
    log = simulated(0, max_range_m=25.0, extra_s=10.0, exact=True)
    found = neglected_change(log, SICK, np.random.default_rng(0))
    assert np.abs(found.predicted).max() < 1e-3 * np.abs(changes("landmarks", 0).predicted).max()


def test_correlation_is_of_directed_changes() -> None:
    change = np.random.default_rng(0).standard_normal((50, 2))
    assert np.isclose(correlation(change, 2.0 * change), 1.0)
    assert np.isclose(correlation(change, -change), -1.0)
    assert abs(correlation(change, np.column_stack((change[:, 1], -change[:, 0])))) < 1e-12


def test_it_needs_truth() -> None:
    log = simulated(0, loop_s=10.0)
    with pytest.raises(InputError, match="true landmarks"):
        neglected_change(replace(log, truth=Truth()), SICK, np.random.default_rng(0))
    with pytest.raises(InputError, match="no region came into view"):
        neglected_change(simulated(0, loop_s=2.0), SICK, np.random.default_rng(0))
