"""Dense maps that anchored to scan landmarks, in the jobs (Nieto 2005, section 6.2)."""

from functools import cache, partial

import numpy as np
import pytest

from comparisons.config import MapConfig
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.extension import DenseMapsFinding
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.extensions.dense_maps.report import MapReport, regions_csv
from comparisons.jobs.run import Comparison
from ekf_reference.core.landmark_types import POSE
from tests.helpers import compared, present
from tests.scenarios import scenario

log = partial(scenario, "scan-slam-maps", seconds=8.0)


@cache
def with_map() -> Comparison:
    return compared(log(), landmarks="scans", dense=["occupancy"])


@cache
def mapped() -> DenseMapping:
    return map_log(log(), asked("scans"))


def asked(landmarks: str) -> MapConfig:
    dense = {"layers": ["occupancy"]}
    return MapConfig.of(
        extensions={"dense_maps": dense, "scan_landmarks": {"landmarks": landmarks}}
    )


@pytest.mark.slow
def test_regions_hang_on_scan_landmarks_and_agree_with_the_smoother() -> None:
    c = with_map()
    found = c.find(DenseMapsFinding)
    dense, agreement = found.dense, found.agreement
    assert dense.kinds == (POSE,)
    assert len(dense.dense.regions.base) > 0
    assert np.array_equal(dense.landmark, c.ekf.estimate.pose_landmarks[:, :2])
    assert np.array_equal(dense.landmarks_of(c.smoothed), c.smoothed.pose_landmarks[:, :2])
    assert present(agreement).median_m < 0.3
    assert c.verdict.outcome == "agree"


@pytest.mark.slow
def test_map_and_run_keep_the_same_map() -> None:
    dense, same = with_map().find(DenseMapsFinding).dense, mapped().dense
    assert np.array_equal(dense.dense.regions.base, same.dense.regions.base)
    assert dense.dense.tally == same.dense.tally


@pytest.mark.slow
def test_it_is_told_by_the_scan_landmarks_names() -> None:
    result = MapReport.build(mapped())
    assert result.scan_landmarks == len(mapped().ekf.estimate.pose_landmarks)
    median_m = present(result.surface_errors["occupancy"].median_m)
    assert median_m < 0.4
    rows = regions_csv(mapped()).splitlines()[1:]
    assert len(rows) == result.regions
    names = {name for row in rows for corner in row.split(",")[1:4] for name in corner.split("+")}
    assert names <= {f"s{landmark_index}" for landmark_index in range(result.scan_landmarks)}
    assert len(names) > 2


def test_points_are_needed_for_a_map_on_both() -> None:
    with pytest.raises(InputError, match="holds no measurements of landmarks"):
        map_log(log(), asked("both"))
