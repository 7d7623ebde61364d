"""The driver of filters."""

from __future__ import annotations

import numpy as np

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_loop import NoObserver, run_filter_loop
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.experiments.reproduction.watched_run import watched_run
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import Trace
from tests.helpers import simulated


class Meddler(NoObserver):
    """Reads the whole mean at every epoch, which brings passive landmarks up to date."""

    def on_update(self, ekf: Ekf) -> None:
        """Read."""
        ekf.state.mean.sum()


def test_driving_a_compressed_filter_asks_for_no_global_updates() -> None:
    """There are as many as areas are left, not as many as epochs; a careless reader is told."""
    log = simulated(loop_s=60.0)
    timeline, choices = build_timeline(log), settle(EkfConfig(filter="compressed-suboptimal"), log)
    updates, _ = run_ekf(log, timeline, choices).spared
    beside = FilterSetup(observers=[Meddler()])
    meddled, _ = run_ekf(log, timeline, choices, setup=beside).spared
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
