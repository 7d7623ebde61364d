"""Returns that alignments share: the measured covariance, its bound, and what leaving it costs."""

from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from ekf_reference.core.geometry import Array, wrap_angle
from ekf_reference.scan_landmarks.scan_slam import (
    PERSISTENCE,
    with_persistence,
    with_shared_returns,
)
from ekf_reference.scan_matching.alignment_covariance import ScanAlignment, scan_align
from ekf_reference.scan_matching.scan_shape import of_scan
from tests.ekf_reference.scan_matching.scenes import BEAMS, COURT, THESIS, guess_of, ranges

PRIOR = np.diag((0.1, 0.1, 0.02)) ** 2
POSES = np.array(((0.0, 0.0, 0.0), (1.0, 0.5, 0.1), (-1.0, 0.8, -0.1)))
"""Of a scan and of two earlier ones, which are its templates."""


@dataclass(frozen=True)
class Part:
    """What `with_shared_returns` needs of an alignment."""

    by_second: Array
    covariance: Array
    first_share: float = 0.0


def parts(count: int, returns: int, seed: int, used: float = 0.6) -> list[ScanAlignment]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        by_second = rng.normal(size=(3, returns)) * (rng.random(returns) < used)
        found.append(Part(by_second, by_second @ by_second.T))
    return cast(list[ScanAlignment], found)


def stacked(alignments: list[ScanAlignment]) -> Array:
    """(3 m, 3 m) the true joint covariance of returns of unit noise."""
    by_return = np.vstack([one.by_second for one in alignments])
    return np.asarray(by_return @ by_return.T)


def bounds(noise: Array, joint: Array) -> bool:
    """Whether blocks (m, 3, 3), taken for independent, claim nowhere more than there is."""
    block = np.zeros_like(joint)
    for k, one in enumerate(noise):
        block[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = one
    return bool(np.linalg.eigvalsh(block - joint)[0] >= -1e-9 * np.linalg.eigvalsh(joint)[-1])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_blocks_bound_the_joint_covariance(count: int) -> None:
    for seed in range(20):
        several = parts(count, 40, seed)
        alone = np.array([one.covariance for one in several])
        joint = stacked(several)
        assert bounds(with_shared_returns(several, alone), joint)
        # Taken for independent as they are, several claim too much; one does not.
        assert bounds(alone, joint) == (count == 1)


def test_one_alignment_made_several_times_says_what_it_says_once() -> None:
    one = parts(1, 30, 3, used=1.0) * 4
    noise = with_shared_returns(one, np.array([a.covariance for a in one]))
    information = np.linalg.inv(noise).sum(axis=0)
    np.testing.assert_allclose(np.linalg.inv(information), one[0].covariance, rtol=1e-12)


def test_alignments_without_a_return_in_common_stay_as_they_are() -> None:
    several = parts(2, 20, 1, used=1.0)
    several[0].by_second[:, 10:], several[1].by_second[:, :10] = 0.0, 0.0
    alone = np.array([one.by_second @ one.by_second.T for one in several])
    np.testing.assert_array_equal(with_shared_returns(several, alone), alone)


def test_the_templates_share_of_the_noise_persists() -> None:
    covariance = np.diag((1.0, 2.0, 3.0))
    for share, factor in ((0.0, 1.0), (0.5, 0.5 + 0.5 * PERSISTENCE), (1.0, PERSISTENCE)):
        part = cast(ScanAlignment, Part(np.zeros((3, 1)), covariance, share))
        np.testing.assert_allclose(with_persistence(part), factor * covariance, rtol=1e-14)


def test_errors_through_common_returns_are_as_large_as_said() -> None:
    """The mean error of two alignments of one scan, whose noise is drawn anew each time."""
    rng = np.random.default_rng(5)
    error, said, alone = [], [], []
    for _ in range(60):
        scan, *templates = (
            of_scan(BEAMS, ranges(rng, COURT, pose, THESIS), THESIS) for pose in POSES
        )
        both, wrong = [], np.zeros(3)
        for template, pose in zip(templates, POSES[1:], strict=True):
            found = scan_align(template, scan, guess_of(rng, pose, PRIOR), PRIOR)
            away = found.pose - pose
            wrong += 0.5 * np.append(away[:2], wrap_angle(away[2]))
            both.append(found)
        joint = both[0].by_second @ both[1].by_second.T
        own = both[0].covariance + both[1].covariance
        error.append(wrong)
        said.append(0.25 * (own + joint + joint.T))
        alone.append(0.25 * own)
    fits, independent = (
        float(np.mean([e @ np.linalg.solve(p, e) for e, p in zip(error, each, strict=True)])) / 3.0
        for each in (said, alone)
    )
    assert 0.7 < fits < 1.3  # chi-square, 180 degrees of freedom: 0.80 to 1.22 at 95 %
    assert independent > 1.2 * fits
