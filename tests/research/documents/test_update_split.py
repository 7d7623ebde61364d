"""Updates in parts (Guivant 2002, section 4.2) through a run's settings."""

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.config import EkfConfig, RunConfig
from comparisons.jobs.run import compare
from comparisons.settings import configure
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.measurement_update import UpdateSplitter
from ekf_reference.core.trace import Trace
from ekf_reference.models.position import PositionFixes
from research.documents.guivant import ONE, SPLITS, runs
from tests.helpers import assert_followed, simulated

GIVEN = ["ekf.split_turn_rad=0.002", "ekf.split_move_m=0.05", "ekf.split_shrink=0.5"]


@pytest.mark.parametrize(
    "name", ["full", "compressed", "compressed-suboptimal", "misono", "misono-full"]
)
def test_every_filter_splits_as_configured(name: str) -> None:
    log = simulated(seed=1, loop_s=20.0)
    config = configure(RunConfig, settings=[*GIVEN, f"ekf.filter={name}"])
    ekf = build_ekf(log, settle(config.ekf, log), Trace())
    assert ekf.splitter == ekf.fixes.splitter == UpdateSplitter(0.002, 0.05, 0.5)
    plain = build_ekf(log, settle(EkfConfig.of(filter=name), log), Trace())
    assert plain.splitter == UpdateSplitter()
    assert plain.fixes.splitter == PositionFixes().splitter


@pytest.mark.parametrize("name", ["compressed", "misono-full"])
def test_a_run_in_parts_is_followed_by_both_frozen_smoothers(name: str) -> None:
    log = simulated(seed=1, loop_s=20.0)
    c = compare(log, configure(RunConfig, settings=[*GIVEN, f"ekf.filter={name}"]))
    weight = c.ekf.trace.measurements[POINT].weight
    assert np.mean(weight < 1.0) > 0.5
    assert_followed(c, 1e-8)


def test_finer_splittings_make_more_parts() -> None:
    log = simulated(seed=1, loop_s=20.0)
    assert list(runs(log)) == list(SPLITS)
    parts = []
    for bounds in SPLITS.values():
        c = compare(log, RunConfig(ekf=EkfConfig.of(**bounds)))
        number = c.ekf.trace.measurements[POINT].number
        parts.append(len(number) / len(np.unique(number)))
    assert parts[list(SPLITS).index(ONE)] == 1.0
    assert parts[2] > max(parts[0], parts[1])
    assert parts[3] > 1.0
