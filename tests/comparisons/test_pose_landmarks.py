"""Landmarks with a direction where estimates are compared, written and read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comparisons.checks.agreement import Gaussian, compare
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import read_estimate, write_estimate
from ekf_reference.core.layout import Layout
from tests.helpers import random_covariance


def estimate() -> Estimate:
    rng = np.random.default_rng(0)
    pose, covariance = rng.standard_normal((4, 3)), random_covariance(rng, 13)
    return Estimate(
        time_s=np.arange(4.0),
        pose=pose,
        pose_covariance=np.tile(covariance[:3, :3], (4, 1, 1)),
        landmark_id=np.array([7, 9]),
        landmark=rng.standard_normal((2, 2)),
        joint_covariance=covariance,
        information="filtered",
        provenance={},
        pose_landmark_id=np.array([3, 5]),
        pose_landmarks=rng.uniform(-10.0, 10.0, (2, 3)),
    )


def test_an_estimate_survives_its_folder(tmp_path: Path) -> None:
    before = estimate()
    write_estimate(before, tmp_path)
    assert (tmp_path / "scan_landmarks.csv").read_text().startswith("id,x_m,y_m,heading_rad\n3,")
    after = read_estimate(tmp_path)
    for name in (
        "landmark_id",
        "landmark",
        "pose_landmark_id",
        "pose_landmarks",
        "joint_covariance",
    ):
        assert np.array_equal(getattr(after, name), getattr(before, name)), name
    assert len(before.joint_mean) == len(before.joint_covariance)
    assert np.array_equal(after.landmark_covariances()[1], before.joint_covariance[5:7, 5:7])
    given = read_external(tmp_path)
    assert given.joint_covariance is not None
    assert np.array_equal(given.joint_covariance, before.joint_covariance[:7, :7])


def test_without_scan_landmarks_there_is_no_such_file(tmp_path: Path) -> None:
    whole = estimate()
    plain = replace(
        whole,
        joint_covariance=whole.joint_covariance[:7, :7],
        pose_landmark_id=np.zeros(0, dtype=np.int64),
        pose_landmarks=np.zeros((0, 3)),
    )
    write_estimate(plain, tmp_path)
    assert not (tmp_path / "scan_landmarks.csv").exists()
    assert len(read_estimate(tmp_path).pose_landmarks) == 0


def test_a_file_without_its_covariance_is_told(tmp_path: Path) -> None:
    write_estimate(estimate(), tmp_path)
    (tmp_path / "scan_landmarks.csv").unlink()
    with pytest.raises(InputError, match=r"shapes .*\(13, 13\), expected .*\(7, 7\)"):
        read_estimate(tmp_path)
    with pytest.raises(InputError, match=r"expected \(7, 7\)"):
        read_external(tmp_path)


def test_landmarks_with_a_direction_are_blocks_of_three() -> None:
    rng = np.random.default_rng(1)
    covariance = random_covariance(rng, 13)
    e = Gaussian(rng.standard_normal(13), covariance, Layout.packed(3, 2, 2))
    turned = replace(e, mean=e.mean + 2.0 * np.pi * (np.eye(13)[9] - np.eye(13)[12]))
    same = compare(e, turned, e, turned)
    assert len(same.landmarks) == 2
    assert len(same.pose_landmarks) == 2
    assert max(g.sigma for g in (same.algebra, same.model, same.linearisation)) < 1e-12
    off = replace(e, mean=e.mean + 0.5 * np.eye(13)[12])
    found = compare(off, e, e, e)
    assert found.pose_landmarks[1].distance > 0.01
    assert found.pose_landmarks[1].difference_m == 0.0
    assert found.pose_landmarks[0].distance == 0.0
    assert max(block.distance for block in found.landmarks) == 0.0
    own = covariance[10:, 10:]
    d = np.array([0.0, 0.0, 0.5])
    assert found.pose_landmarks[1].distance == pytest.approx(
        np.sqrt(d @ np.linalg.solve(own, d) / 3.0)
    )
    shifted = compare(replace(e, mean=e.mean + 3.0 * np.eye(13)[7]), e, e, e)
    assert shifted.landmark_difference_rms_m == pytest.approx(1.5)


def test_different_kinds_are_not_compared() -> None:
    e = Gaussian(np.zeros(9), np.eye(9), Layout.packed(3, 3))
    with pytest.raises(ValueError, match="3 point landmarks compared with 0"):
        compare(e, e, e, replace(e, layout=Layout.packed(3, 0, 2)))
