"""Dense maps that hang on scan landmarks, in the jobs (Nieto 2005, section 6.2)."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import EkfChoices
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.errors import InputError
from comparisons.extensions.dense_maps.source import DenseOptions
from comparisons.extensions.scan_landmarks.source import (
    ScanSlamSources,
    slam_options,
    usual_options,
)
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.pipeline.compare import Comparison, compare_estimators
from comparisons.pipeline.dense_map import DenseMapping, map_log
from comparisons.report.map_folder import regions_csv
from comparisons.report.map_result import build_map_result
from ekf_reference.layout import ORIENTED, POINT
from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
from tests.helpers import first_seconds

OPTIONS = DenseOptions(("occupancy",))


@cache
def log() -> Log:
    return first_seconds(open_log("scan-slam-maps"), 8.0)


@cache
def with_map() -> Comparison:
    return compare_estimators(log(), landmarks="scans", dense=OPTIONS)


@cache
def mapped() -> DenseMapping:
    return map_log(log(), options=OPTIONS, landmarks="scans")


def test_the_filter_does_not_feel_the_map() -> None:
    sources = ScanSlamSources.of(log(), "scans", usual_options(mapped=True))
    assert sources is not None
    timeline = build_timeline(sources.log, None, sources.scans.time_s)
    alone = run_ekf(sources.log, timeline, EkfChoices().settle(sources.log), source=sources())
    ours = with_map().ekf
    for a, b in (
        (alone.departed, ours.departed),
        (alone.estimate.oriented, ours.estimate.oriented),
        (alone.estimate.joint_covariance, ours.estimate.joint_covariance),
    ):
        assert np.array_equal(a, b)


def test_regions_hang_on_scan_landmarks_and_agree_with_the_smoother() -> None:
    c = with_map()
    assert c.dense is not None
    assert c.dense_check is not None
    assert c.dense.kinds == (ORIENTED,)
    assert len(c.dense.dense.regions.base) > 0
    assert np.array_equal(c.dense.landmark, c.ekf.estimate.oriented[:, :2])
    assert np.array_equal(c.dense.landmarks_of(c.smoothed), c.smoothed.oriented[:, :2])
    assert c.dense_check.median_m < 0.3
    assert c.verdict.outcome == "agree"


def test_map_and_run_keep_the_same_map() -> None:
    dense, same = with_map().dense, mapped().dense
    assert dense is not None
    assert np.array_equal(dense.dense.regions.base, same.dense.regions.base)
    assert dense.dense.tally == same.dense.tally


def test_it_is_told_by_the_scan_landmarks_names() -> None:
    result = build_map_result(mapped(), 0.0)
    assert result.scan_landmarks == len(mapped().ekf.estimate.oriented)
    median_m = result.surface_errors["occupancy"].median_m
    assert median_m is not None
    assert median_m < 0.4
    rows = regions_csv(mapped()).splitlines()[1:]
    assert len(rows) == result.regions
    names = {name for row in rows for corner in row.split(",")[1:4] for name in corner.split("+")}
    assert names <= {f"s{slot}" for slot in range(result.scan_landmarks)}
    assert len(names) > 2


def test_a_map_to_enrich_templates_from_hangs_on_the_same_landmarks() -> None:
    enriched = ScanSlamSources.of(log(), "both", ScanSlamOptions(enrich_m=1.0))
    bare = ScanSlamSources.of(log(), "scans")
    assert enriched is not None
    assert bare is not None
    kept = enriched().map_of
    assert kept is not None
    assert kept.run().kinds == (POINT, ORIENTED)
    assert bare().map_of is None


def test_what_cannot_be_asked_for_is_said_in_a_line() -> None:
    with pytest.raises(InputError, match="--templates is 'rich', expected bare or enriched"):
        slam_options(None, "rich", "scans")
    with pytest.raises(InputError, match="--pieces is 'all', expected joined or single"):
        slam_options("all", "bare", "scans")
    with pytest.raises(InputError, match="--pieces single goes with --landmarks scans or both"):
        slam_options("single", "bare", "points")
    with pytest.raises(InputError, match="goes with --landmarks scans or both"):
        slam_options(None, "enriched", "points")
    with pytest.raises(InputError, match="landmarks 'walls' are unknown"):
        map_log(log(), landmarks="walls")
    with pytest.raises(InputError, match="holds no sightings of landmarks"):
        map_log(log(), landmarks="both")
