"""The smoother with its own matcher of scan landmarks, beside the one that has the filter's."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2, f

from comparisons.estimates.estimate import Estimate
from comparisons.extensions.own_matching.check import (
    check_own_matching,
    common_shift,
    compare_frames,
)
from comparisons.extensions.own_matching.extension import OwnMatchingFinding, matching_differences
from comparisons.extensions.scan_landmarks.extension import ScanLandmarksFinding
from comparisons.figures import stored
from comparisons.jobs.run import Comparison
from comparisons.report.run import RunReport
from ekf_reference.scan_matching.alignment_covariance import ScanAlignment, scan_align
from ekf_reference.scan_matching.sog import SumOfGaussians
from graphslam.graph_builder import to_tangent
from graphslam.optimum import ChiSquareTest, Optimality, Stationarity
from graphslam.problem import PoseLandmarkMeasurements
from tests.helpers import Array, compared, first_seconds, present, written
from tests.scenarios import scenario

Index = NDArray[np.intp]

TURNED = (0.0, 0.0, np.deg2rad(2.0))
MOVED_M = 0.5


log = partial(scenario, "scan-slam", seed=3, seconds=14.0)


def run() -> Comparison:
    return compared(
        log(),
        landmarks="scans",
        template_extraction="per-segment",
        smoother_matcher="generalised-icp",
    )


matched = cache(run)


def planted(
    monkeypatch: pytest.MonkeyPatch,
    shift: tuple[float, ...],
    chosen: Callable[[SumOfGaussians], bool],
) -> Comparison:
    """A run whose SOG matcher adds a shift to z of templates with chosen shapes."""

    def wrong(first: SumOfGaussians, *rest: Any) -> ScanAlignment:
        found = scan_align(first, *rest)
        return replace(found, pose=found.pose + shift) if chosen(first) else found

    monkeypatch.setattr("ekf_reference.scan_landmarks.templates.scan_align", wrong)
    return run()


def best_seen() -> tuple[int, Array]:
    """The landmark that both saw the most, and which way (2,) its alignments are the surest."""
    own = matched().find(OwnMatchingFinding).own
    landmark_index = max(own.landmarks, key=lambda one: one.common).id
    rows = np.flatnonzero(own.alignments.landmark == landmark_index)[1:]
    turn = to_tangent(own.alignments.measured[rows, 2])
    seen = np.linalg.inv(turn.transpose(0, 2, 1) @ own.alignments.covariance[rows] @ turn)
    return landmark_index, np.linalg.eigh(seen.mean(axis=0)[:2, :2])[1][:, -1]


@cache
def joined() -> Comparison:
    """With templates of several segments, of which half may be out of view."""
    return compared(log(), landmarks="scans", smoother_matcher="generalised-icp")


@pytest.mark.slow
@pytest.mark.parametrize(("made", "limit"), [(matched, 0.5), (joined, 1.0)])
def test_a_sound_matcher_is_confirmed(
    made: Callable[[], Comparison], limit: float, open3d_library: ModuleType
) -> None:
    """Sharing template and scan they differ by much less than both covariances."""
    own = made().find(OwnMatchingFinding).own
    assert made().verdict.outcome == "agree"
    assert own.agrees
    assert own.verified
    assert own.common > 0.7 * own.filter
    assert np.mean(own.squared) / 3.0 < limit
    assert present(present(own.accuracy).ate_m) < 0.5


@pytest.mark.slow
def test_no_alignment_of_the_filter_is_used(
    monkeypatch: pytest.MonkeyPatch, open3d_library: ModuleType
) -> None:
    """A heading that is 2 degrees off: S follows it, S'' does not, and it is named."""
    c = planted(monkeypatch, TURNED, lambda shape: True)
    own = c.find(OwnMatchingFinding).own
    assert all(cause.gap == "matching" for cause in c.verdict.causes)  # S sees nothing
    assert c.verdict.outcome == "disagree"
    assert own.shifted
    assert np.rad2deg(own.shift_rad) == pytest.approx(2.0, abs=0.8)
    assert np.hypot(*own.shift_m) < 0.05
    assert "all alignments of the filter are shifted by" in c.verdict.causes[0].evidence
    assert "heading" in c.verdict.causes[0].hint


@pytest.mark.slow
def test_an_offset_of_one_landmark_is_named(
    monkeypatch: pytest.MonkeyPatch, open3d_library: ModuleType
) -> None:
    which, way = best_seen()
    shift = (*(MOVED_M * way).tolist(), 0.0)
    its = matched().find(ScanLandmarksFinding).source.found.template[which].shape.mean
    c = planted(monkeypatch, shift, lambda shape: np.array_equal(shape.mean, its))
    own = c.find(OwnMatchingFinding).own
    assert [cause.gap for cause in c.verdict.causes] == ["matching"]
    assert not own.shifted
    (worst,) = own.contradicting
    assert worst.id == which
    assert np.array(worst.shift_m) @ way == pytest.approx(MOVED_M, rel=0.3)
    assert f"scan landmark {worst.id} differ by 0." in c.verdict.causes[0].evidence
    table = matching_differences(own)
    assert table.count("contradicts") == 1


@pytest.mark.slow
def test_it_is_reported(tmp_path: Path, open3d_library: ModuleType) -> None:
    c = matched()
    result, own = RunReport.build(c), c.find(OwnMatchingFinding).own
    assert (result.model_extra or {})["own_matching"] == stored(own)
    assert own.agrees
    assert own.reasons["initialised"] == len(c.ekf.estimate.pose_landmarks)
    assert own.reasons["used"] == own.own
    assert sum(row.common for row in own.landmarks) == own.common
    page = (written(c, tmp_path / "out") / "report.html").read_text()
    assert "Alignments of two matchers" in page
    assert 'id="matching"' in page
    assert "smoother, own matcher trajectory" in page
    assert (tmp_path / "out" / "own-matcher" / "scan_landmarks.csv").exists()


@pytest.mark.slow
def test_a_blank_scan_is_no_alignment(open3d_library: ModuleType) -> None:
    short = first_seconds(log(), 5.0)
    assert short.scans is not None
    blank = short.scans.range_m.copy()
    blank[7] = np.nan  # no return
    blank[12, 3:] = np.nan  # too few
    blanked = replace(short, scans=replace(short.scans, range_m=blank))
    c = compared(blanked, landmarks="scans", smoother_matcher="generalised-icp")
    own = c.find(OwnMatchingFinding).own
    seen = c.ekf.timeline.epoch_time_s[own.alignments.pose]
    assert len(np.unique(seen)) > 10
    assert not np.isin(seen, short.scans.time_s[[7, 12]]).any()


def differences(
    rng: np.random.Generator, shift: Array, landmarks: int
) -> tuple[Index, Array, Array]:
    """Those of one landmark alike but for little, as shared noise makes them."""
    landmark_index: Index = np.repeat(np.arange(landmarks), 12)
    of_landmark = 0.04 * rng.standard_normal((landmarks, 3))
    own = of_landmark[landmark_index] + 0.01 * rng.standard_normal((len(landmark_index), 3))
    return landmark_index, own + shift, np.tile(np.eye(3) / 0.1**2, (len(landmark_index), 1, 1))


@pytest.mark.parametrize("landmarks", [3, 8])
def test_a_common_shift_is_found_and_no_other(landmarks: int) -> None:
    """However few landmarks tell the scatter: for three, chi-square's limit is too low."""

    def reported(seed: int, moved: float) -> tuple[Array, float, int]:
        rng = np.random.default_rng(seed)
        return common_shift(*differences(rng, np.array((0.0, 0.0, moved)), landmarks))

    none = [reported(seed, 0.0) for seed in range(300)]
    assert {freedom for *_, freedom in none} == {3 * (landmarks - 1)}
    limit = 3.0 * f.ppf(0.999, 3, 3 * (landmarks - 1))
    squared = np.array([value for _, value, _ in none])
    assert np.mean(squared > limit) <= 0.01
    assert (np.mean(squared > chi2.ppf(0.999, 3)) > 0.015) == (landmarks == 3)
    shift, found, _ = reported(0, 0.5)
    assert found > limit
    np.testing.assert_allclose(shift, (0.0, 0.0, 0.5), atol=0.07)


def test_two_landmarks_have_nothing_in_common() -> None:
    landmark_index, d, information = differences(np.random.default_rng(0), np.full(3, 0.5), 8)
    assert common_shift(landmark_index % 2, d, information)[1:] == (0.0, 0)


def frames(place: Array, sigma: float) -> Estimate:
    size = 3 + 3 * len(place)
    return Estimate(
        time_s=np.zeros(1),
        pose=np.zeros((1, 3)),
        pose_covariance=np.eye(3)[None],
        landmark_id=np.zeros(0, dtype=np.int64),
        landmark=np.zeros((0, 2)),
        joint_covariance=sigma**2 * np.eye(size),
        information="smoothed",
        provenance={},
        pose_landmark_id=np.arange(len(place)),
        pose_landmarks=place,
    )


def test_frames_are_compared_by_both_covariances_and_round_the_circle() -> None:
    a = np.array(((0.0, 0.0, np.pi - 0.01), (5.0, 1.0, 0.0)))
    b = a + ((0.0, 0.0, 0.02 - 2.0 * np.pi), (3.0, 0.0, 0.0))
    pair = compare_frames(frames(a, 0.3), frames(b, 0.4))
    middle = (0.04 + 6.0) / 2.0 / 3**0.5
    assert pair.distance_sigma_median == pytest.approx(middle, rel=1e-9)
    assert pair.outside == 1
    assert pair.rms_m == pytest.approx(3.0 / 2**0.5)
    assert not compare_frames(frames(a[:0], 0.3), frames(b[:0], 0.3)).landmarks


def test_alignments_are_compared_where_both_have_one_and_none_has_begun() -> None:
    def reported(rows: list[tuple[int, int, float]], sigma: float) -> PoseLandmarkMeasurements:
        z = np.array([(x, 0.0, np.pi / 2) for *_, x in rows])
        spread = np.tile(np.diag((sigma, 10.0 * sigma, sigma)) ** 2, (len(rows), 1, 1))
        pose, landmark = (np.array([row[i] for row in rows], dtype=np.intp) for i in (0, 1))
        return PoseLandmarkMeasurements(pose, landmark, z, spread)

    filters_ = reported([(0, 0, 1.0), (1, 0, 2.0), (2, 0, 3.0), (2, 1, 9.0), (3, 0, 4.0)], 0.3)
    own = reported([(0, 0, 7.0), (1, 0, 2.5), (3, 0, 4.0), (2, 1, 9.0), (4, 0, 1.0)], 0.4)
    test = ChiSquareTest(1.0, 1, 0.0, 2.0)
    optimality = Optimality(
        stationarity=Stationarity(0.0, definite=True),
        chi_square=test,
        agreeing=("a", "b"),
        agreed=True,
    )
    some = replace(frames(np.zeros((2, 3)), 1.0), time_s=np.arange(5.0))
    found = check_own_matching((filters_, own), some, some, some, optimality)
    assert (found.filter, found.own, found.common) == (3, 3, 2)
    (one,) = found.landmarks
    assert one.common == 2
    assert one.worst_time_s == 1.0
    # The landmark's own y is the pose's x: turned by a quarter.
    np.testing.assert_allclose(sorted(found.squared), (0.0, (0.5 / 5.0) ** 2), atol=1e-12)
    assert found.agrees
