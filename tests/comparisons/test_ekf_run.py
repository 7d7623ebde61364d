"""The driver of filters, with the compressed filter on real logs and a boundless prior."""

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_loop import FilterObservers, run_filter_loop
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.jobs.run import Comparison, Modified
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import Trace
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from research.documents.drives import watched_run
from tests.ekf_reference.filters.test_compressed import NoTheta
from tests.helpers import compared, present, simulated


class Meddler(FilterObservers):
    """Reads the whole mean at every epoch, which brings passive landmarks up to date."""

    def on_update(self, ekf: Ekf) -> None:
        """Read."""
        ekf.state.mean.sum()


def test_driving_a_compressed_filter_asks_for_no_global_updates() -> None:
    """There are as many as areas are left, not as many as epochs; a careless reader is told."""
    log = simulated(loop_s=60.0)
    timeline, choices = build_timeline(log), settle(EkfConfig(filter="compressed-suboptimal"), log)
    updates = present(run_ekf(log, timeline, choices).compression).global_updates
    beside = FilterSetup(observers=[Meddler()])
    read = run_ekf(log, timeline, choices, setup=beside)
    meddled = present(read.compression).global_updates
    assert 0 < updates < 0.1 * len(timeline.epoch_time_s)
    assert meddled > 0.5 * len(timeline.epoch_time_s)


def test_stops_tell_what_was_seen_and_a_fault_is_the_last() -> None:
    log = simulated(loop_s=20.0)
    timeline, choices = build_timeline(log), settle(EkfConfig(), log)
    run = run_ekf(log, timeline, choices)
    stops = list(run_filter_loop(build_ekf(log, choices, Trace()), log, timeline))
    assert np.array_equal(
        np.concatenate([stop.landmark_indices for stop in stops]), run.landmark_index
    )
    assert np.array_equal([stop.arrived for stop in stops], run.arrived)
    broken = build_ekf(log, choices, Trace())
    stops = []
    for stop in run_filter_loop(broken, log, timeline):
        stops.append(stop)
        if len(stops) == 5:
            broken.state._covariance[0, 0] = np.nan
    assert 5 < len(stops) < len(timeline.epoch_time_s)
    assert [stop.fault is None for stop in stops] == [True] * (len(stops) - 1) + [False]


def test_looking_on_is_the_same_drive() -> None:
    log = simulated(loop_s=20.0)
    run = run_ekf(log, build_timeline(log), settle(EkfConfig(), log))
    last = list(watched_run(log))[-1][1]
    assert np.array_equal(last.state.landmarks, run.estimate.landmark)


def test_the_configuration_sets_what_it_spares() -> None:
    """c1 of the suboptimal filter; the exact one spares nothing whatever is given."""
    log = simulated(seed=1, loop_s=2.0)
    for name, given, expected in (
        ("compressed-suboptimal", None, 1e-4),
        ("compressed-suboptimal", 0.01, 0.01),
        ("compressed", 0.01, 0.0),
    ):
        choices = EkfConfig.of(filter=name, association="known", least_gain=given)
        state = build_ekf(log, choices, Trace()).state
        assert isinstance(state, CompressedState)
        assert state.areas.least_gain == expected


@pytest.mark.slow
def test_a_mean_that_is_forgotten_is_no_conservatism() -> None:
    """The suboptimal filter may spare covariance, not the correction of the mean (theta)."""
    log = simulated(seed=3, loops=2)

    def plant(ekf: Ekf) -> None:
        ekf.state = NoTheta(log.prior.pose, log.prior.covariance, LocalAreas(8.0, 12.0, 1e-4))

    choices = EkfConfig(filter="compressed-suboptimal", association="known")
    assert compared(log, ekf=choices).verdict.outcome == "agree"
    broken = compared(log, Modified(plant), ekf=choices)
    assert [cause.gap for cause in broken.verdict.causes] == ["algebra"]


def initialised_boundless(variance: float) -> Comparison:
    def plant(ekf: Ekf) -> None:
        ekf.boundless_variance = variance

    return compared(simulated(seed=1, loop_s=30.0), Modified(plant))


def test_a_small_prior_is_an_error_that_shows() -> None:
    """With P_LL* of 1 m^2 the filter claims knowledge it has not; the model gap finds it."""
    c = initialised_boundless(1.0)
    assert c.agreement.algebra.within(1e-6)
    assert c.agreement.model.covariance > 1e-3
    assert [cause.gap for cause in c.verdict.causes] == ["model"]
