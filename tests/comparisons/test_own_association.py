"""The smoother's own association of real logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.smoother_association import OwnAssociator
from comparisons.adapters.smoother_input import position_rows
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.association import compare_partitions, score_association
from comparisons.config import EkfConfig
from comparisons.logs.bundled import open_log


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "precision", "recall"), [(1, 0.95, 0.93), (2, 0.99, 0.98), (3, 0.98, 0.95)]
)
def test_mrclam_with_its_labels_hidden(
    shared_data: Path, robot: int, precision: float, recall: float
) -> None:
    log = open_log(str(shared_data / "mrclam" / "MRCLAM_Dataset6"), robot=robot)
    timeline = build_timeline(log)
    found = OwnAssociator(log, timeline, position_rows(timeline, None)).associate()
    clusters = score_association(found.landmark_index, found.landmarks, log)
    assert clusters is not None
    assert clusters.clusters is not None
    assert clusters.clusters.precision > precision
    assert clusters.clusters.recall > recall


@pytest.mark.slow
def test_raw_detections_as_the_filter_sees_them(shared_data: Path) -> None:
    """The first five minutes of Victoria Park: most pairs as in the filter's association."""
    log = open_log(str(shared_data / "victoria_park"))
    whole = build_timeline(log)
    timeline = whole.prefix(int(np.searchsorted(whole.epoch_time_s, 300.0)))
    run = run_ekf(log, timeline, settle(EkfConfig(filter="compressed"), log))
    found = OwnAssociator(log, timeline, position_rows(timeline, None)).associate()
    agreement = compare_partitions(run.landmark_index, found.landmark_index)
    assert agreement.agreement > 0.9
    assert 0.8 < found.problem.landmark_count / len(run.estimate.landmark) < 1.25
