"""Two estimates beside each other without a log: differences, and their NEES."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slamcheck
from comparisons.checks.pair_of_estimates import compare_pair
from comparisons.estimates.external import ExternalEstimate

COUNT, LANDMARKS = 4000, 500


def estimate(rng: np.random.Generator, scale: float = 1.0) -> ExternalEstimate:
    """Of a vehicle and landmarks at the origin, with errors as stated times a scale."""
    pose, place = np.diag((0.1, 0.2, 0.05)) ** 2, np.diag((0.3, 0.1)) ** 2
    return ExternalEstimate(
        time_s=np.linspace(0.0, 400.0, COUNT),
        pose=scale * rng.multivariate_normal(np.zeros(3), pose, COUNT),
        pose_covariance=np.tile(pose, (COUNT, 1, 1)),
        landmark_id=np.arange(LANDMARKS),
        landmark=scale * rng.multivariate_normal(np.zeros(2), place, LANDMARKS),
        landmark_covariance=np.tile(place, (LANDMARKS, 1, 1)),
    )


@pytest.mark.parametrize(("scale", "nees"), [(1.0, 1.0), (2.0, 4.0)])
def test_independent_estimates_differ_by_the_sum_of_their_covariances(
    scale: float, nees: float
) -> None:
    """Errors twice as large as stated have four times the NEES."""
    rng = np.random.default_rng(0)
    found = slamcheck.compare_estimates(estimate(rng, scale), estimate(rng, scale))
    assert found.nees_mean == pytest.approx(3.0 * nees, rel=0.06)
    assert found.landmark_nees.mean() == pytest.approx(2.0 * nees, rel=0.15)
    assert found.rms_m == pytest.approx(scale * np.sqrt(2 * (0.01 + 0.04)), rel=0.05)
    assert found.landmark[:2] == ("0", "1")
    assert repr(found).startswith("<EstimateComparison: 4,000 poses 0.")
    assert "\n" not in repr(found)


def test_a_filter_differs_from_its_smoother_by_the_difference() -> None:
    rng = np.random.default_rng(1)
    smoother = estimate(rng)
    assert smoother.pose_covariance is not None
    more = rng.multivariate_normal(np.zeros(3), 3.0 * smoother.pose_covariance[0], COUNT)
    filtered = replace(
        smoother, pose=smoother.pose + more, pose_covariance=4.0 * smoother.pose_covariance
    )
    found = compare_pair(filtered, smoother, "filter-smoother")
    assert found.nees_mean == pytest.approx(3.0, rel=0.06)
    assert compare_pair(filtered, smoother).nees_mean < 2.0
    assert np.isnan(compare_pair(smoother, filtered, "filter-smoother").nees).all()


def test_labels_wrapped_headings_and_other_times(tmp_path: Path) -> None:
    one = ExternalEstimate(
        time_s=np.array([0.0, 1.0, 2.0]),
        pose=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.1], [2.0, 0.0, 3.2]]),
        landmark_id=np.array([0, 1]),
        landmark=np.array([[1.0, 1.0], [2.0, 2.0]]),
        labels={0: "oak", 1: "elm"},
    )
    other = replace(
        one,
        time_s=np.array([1.0, 2.0, 3.0]),
        pose=one.pose + 2 * np.pi,
        labels={0: "elm", 1: "ash"},
    )
    found = slamcheck.compare_estimates(one, other)
    assert found.time_s.tolist() == [1.0, 2.0]
    assert found.difference[0, 2] == pytest.approx(3.1)
    assert found.landmark == ("elm",)
    assert found.landmark_difference.tolist() == [[1.0, 1.0]]
    assert np.isnan(found.nees_mean)
    (tmp_path / "a.tum").write_text("0 1 2 0 0 0 0 1\n1 2 2 0 0 0 0 1\n")
    assert slamcheck.compare_estimates(str(tmp_path / "a.tum"), one).rms_m > 0.0
    with pytest.raises(slamcheck.InputError, match=r"share no time: one is from 0\.000 to 2"):
        slamcheck.compare_estimates(one, replace(one, time_s=one.time_s + 50.0))
    assert list(found.to_pandas("landmarks").columns) == ["label", "dx_m", "dy_m", "nees"]
