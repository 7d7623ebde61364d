"""Scan landmarks fused while driving: told to the smoother, and right in every filter."""

from collections.abc import Callable
from functools import cache, partial
from types import ModuleType

import pytest

from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.extensions.own_matching.extension import OwnMatchingFinding
from comparisons.extensions.scan_landmarks.extension import (
    ScanLandmarksExtension,
    ScanLandmarksFinding,
)
from comparisons.extensions.scan_landmarks.source import LogScans, ScanSlamSource
from comparisons.jobs.run import REQUIRED, Comparison, Modified, compare_prepared
from comparisons.pipeline.prepare import prepare
from comparisons.settings import run_config
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.state import LocalMap
from ekf_reference.filters.compressed import CompressedState, LocalAreas
from ekf_reference.scan_landmarks.merging import FusingOptions, merge_landmarks
from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
from ekf_reference.scan_landmarks.template_extraction import SingleSegments
from tests.helpers import Array, Source, assert_followed, compared
from tests.scenarios import scenario

CARELESS = ScanSlamOptions(
    extraction=SingleSegments(every=1, tried=6, ahead_m=0.0, apart_m=-100.0, explained=2.0)
)
"""Initialises landmarks where there are some: duplicates, and many of them."""


log = partial(scenario, "scan-loop-fine", seed=3, seconds=9.0)


def source() -> ScanSlamSource:
    return ScanSlamSource(LogScans(log()), CARELESS, fusing=FusingOptions())


def small(ekf: Ekf) -> None:
    ekf.state = CompressedState(log().prior.pose, log().prior.covariance, LocalAreas(4.0, 10.0))


@cache
def by_filter(name: str) -> Comparison:
    modify: Callable[[Ekf], None] = small if name == "compressed" else lambda ekf: None
    return compared(log(), Modified(modify), Source(source), filter=name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full", "compressed", "misono-full"])
def test_the_smoother_is_told_of_the_fused(name: str) -> None:
    c = by_filter(name)
    merges = c.ekf.pose_landmarks.merges
    assert len(merges.first) > 3
    assert len(c.agreement.pose_landmarks) == c.ekf.pose_landmarks.count - len(merges.first)
    assert_followed(c, 1e-6)
    assert c.verdict.outcome == "agree"


@pytest.mark.slow
def test_what_the_smoother_is_not_told_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def halved(
        self: PoseLandmarkRecorder,
        ekf: Ekf,
        epoch: int,
        first: int,
        second: int,
        z: Array,
        covariance: Array,
    ) -> LocalMap:
        known = merge_landmarks(ekf, first, second, z, 0.25 * covariance)
        self._merges.append((epoch, first, second, z, covariance))
        return known

    monkeypatch.setattr(PoseLandmarkRecorder, "fuse", halved)
    broken = compared(log(), Source(source), filter="full")
    assert [cause.gap for cause in broken.verdict.causes] == ["model"]


@pytest.mark.slow
def test_it_is_an_option_and_counted(open3d_library: ModuleType) -> None:
    """The whole job, and the smoother's own matcher beside it.

    That one has templates of one scan each: fused ones are of two, and leave gaps in the numbers.
    """
    config = run_config(landmarks="both", merge_landmarks=True, smoother_matcher="generalised-icp")
    prepared = prepare(log(), config, required=REQUIRED)
    for one in prepared.extensions:
        if isinstance(one, ScanLandmarksExtension):
            one.options = CARELESS
    found = compare_prepared(prepared)
    slam, own = found.find(ScanLandmarksFinding).result, found.find(OwnMatchingFinding).own
    assert slam.fused == len(found.ekf.pose_landmarks.merges.first) >= 2
    initialised = len(slam.landmarks) + slam.fused
    assert (
        sum(row.measurements for row in slam.landmarks) == slam.measurements["used"] + initialised
    )
    assert own.reasons["initialised"] == initialised
    assert own.ekf.landmarks == len(slam.landmarks)
