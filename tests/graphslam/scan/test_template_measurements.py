"""Templates seen anew along a drive, by a matcher that starts from the smoother's own estimate."""

from functools import cache
from types import ModuleType

import numpy as np
import pytest

from graphslam.problem import SlamProblem
from graphslam.scan import planar
from graphslam.scan.matchers import SurfaceMatcher
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.open3d_matchers import GeneralisedMatcher
from graphslam.scan.template_matchers import Template, TemplateMatchers, lever_m
from graphslam.scan.template_measurements import (
    GATED,
    INITIALISED,
    USED,
    TemplateMeasurements,
    TemplateOptions,
    measure_templates,
)
from graphslam.smoother import smooth
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import box, scan
from tests.graphslam.worlds import chain

STEPS = 24
SIGMA_M = 0.02
MOTION = np.array((0.12, 0.02, 0.03))
SPREAD = np.diag((0.02, 0.02, 0.01)) ** 2
BOX = box(3.5, 3.0, 2.5, 2.5)
YARD = np.vstack((box(0, 0, 16, 11), BOX, box(-4, -3, 3, 1.5, -0.3)))
"""The first box shows two faces, the other one."""


@cache
def truth() -> Array:
    poses = [np.array((-1.5, 0.3, 0.1))]
    for _ in range(STEPS):
        poses.append(planar.compose(poses[-1], MOTION))
    return np.array(poses)


def clouds(segment: Array, sigma_m: float, seed: int = 0) -> dict[int, Array]:
    rng = np.random.default_rng(seed)
    return {k: scan(rng, segment, pose, sigma_m) for k, pose in enumerate(truth())}


def problem(seed: int = 1, scale: float = 1.0) -> SlamProblem:
    """Odometry with noise; scale: of the noise, not of what is said of it."""
    noise = np.random.default_rng(seed).multivariate_normal(np.zeros(3), SPREAD, STEPS)
    return chain(
        MOTION + scale * noise,
        np.tile(SPREAD, (STEPS, 1, 1)),
        prior_pose=truth()[0],
        prior_covariance=np.diag((0.01, 0.01, 0.001)) ** 2,
    )


def template(cloud: Array, pose: int, middle: tuple[float, float], reach_m: float) -> Template:
    """Returns of a scan around a place of the world; the axis is turned, which must not matter."""
    centre = planar.between(truth()[pose], np.array((*middle, 0.0)))[:2]
    near = cloud[np.hypot(*(cloud[:, :2] - centre).T) < reach_m]
    place = np.append(near[:, :2].mean(axis=0), 0.7)
    return Template(pose, place, planar.moved(planar.between(place, np.zeros(3)), near))


def seen(
    seen_clouds: dict[int, Array], given: SlamProblem, shared_m: float = 0.0
) -> TemplateMeasurements:
    first = seen_clouds[0]
    templates = {
        0: template(first, 0, (2.7, 2.2), 1.6),
        1: template(first, 0, (-4.0, -3.0), 1.8),
        2: template(first, 0, (0.0, 5.5), 1.5),  # a piece of the wall
        3: template(seen_clouds[7], 7, (8.0, -5.5), 2.0),  # a corner
    }
    matchers = TemplateMatchers(KissIcpOptions.for_noise(SIGMA_M), GeneralisedMatcher)
    options = TemplateOptions(shared_m=shared_m)
    return measure_templates(given, templates, seen_clouds, matchers, options)


def errors(found: TemplateMeasurements) -> tuple[Array, Array]:
    """Of later measurements (n, 3), in the axes, and their covariances."""
    ones = found.alignments
    at = dict[int, Array]()
    wrong, spread = [], []
    for pose, number, z, covariance in zip(
        ones.pose.tolist(), ones.landmark.tolist(), ones.measured, ones.covariance, strict=True
    ):
        if number not in at:
            at[number] = planar.compose(truth()[pose], z)
            continue
        true = planar.between(truth()[pose], at[number])
        wrong.append(planar.wrapped(planar.between(true, z)))
        spread.append(covariance)
    return np.array(wrong), np.array(spread)


def test_without_noise_templates_are_where_they_are(open3d_library: ModuleType) -> None:
    found = seen(clouds(YARD, 0.0), problem(scale=0.0))
    assert found.reasons[INITIALISED] == 4
    assert found.reasons[USED] > 2 * STEPS
    assert np.abs(errors(found)[0]).max() < 0.02  # surfaces between returns are not quite the same


def test_with_noise_the_covariance_is_honest_and_the_drive_is_found(
    open3d_library: ModuleType,
) -> None:
    normalised, before, after = [], 0.0, 0.0
    for seed in range(2):
        given = problem(seed)
        found = seen(clouds(YARD, SIGMA_M, seed), given, SIGMA_M)
        wrong, spread = errors(found)
        normalised += np.einsum("ni,nij,nj->n", wrong, np.linalg.inv(spread), wrong).tolist()
        factors = SlamProblem(**{**vars(given), "pose_landmarks": found.factors})
        result = smooth(factors, {})
        assert result.optimality.verified
        reckoned = [given.prior_pose]
        for motion in given.increment:
            reckoned.append(planar.compose(reckoned[-1], motion))
        after += np.square(result.poses[:, :2] - truth()[:, :2]).sum()
        before += np.square(np.array(reckoned)[:, :2] - truth()[:, :2]).sum()
    assert len(normalised) > 100
    assert 0.2 < np.mean(normalised) / 3.0 < 2.0  # template and scan are both noisy
    assert after < 0.3 * before


def test_along_a_wall_nothing_is_told(open3d_library: ModuleType) -> None:
    found = seen(clouds(YARD, SIGMA_M), problem())
    of_wall = found.alignments.landmark == 2
    size = np.linalg.eigvalsh(found.alignments.covariance[of_wall][1:])
    assert len(size) > 5
    assert (size[:, -1] > 50.0**2).all()
    assert (size[:, 1] < 0.2**2).all()
    birth = np.linalg.eigvalsh(found.alignments.covariance[of_wall][0])
    assert birth[-1] < 0.1**2  # of all axes that fit it is the one where the wall was taken


def test_factors_are_wider_by_what_alignments_share(open3d_library: ModuleType) -> None:
    shared_m = 0.1
    found = seen(clouds(YARD, SIGMA_M), problem(), shared_m)
    wider = found.factors.covariance - found.alignments.covariance
    initialised = np.unique(found.factors.landmark, return_index=True)[1]
    assert not wider[initialised].any()
    later = np.delete(np.arange(len(wider)), initialised)
    np.testing.assert_allclose(wider[later, 0, 0], shared_m**2, rtol=1e-6)
    assert (wider[later, 2, 2] > 0.0).all()
    np.testing.assert_array_equal(found.factors.measured, found.alignments.measured)


def test_what_was_moved_away_is_gated(open3d_library: ModuleType) -> None:
    """A box that stands 0.4 m farther from the fourth scan on no longer is the landmark."""
    still, gone = (
        clouds(YARD, SIGMA_M),
        clouds(np.vstack((YARD[:4], BOX + 0.28, YARD[8:])), SIGMA_M),
    )
    mixed = {k: (still if k < 4 else gone)[k] for k in still}
    found = seen(mixed, problem())
    ones = found.alignments
    assert not ((ones.landmark == 0) & (ones.pose > 8)).any()
    assert found.reasons[GATED] > 5
    assert ((seen(still, problem()).alignments.landmark == 0).sum()) > STEPS // 2  # not so here


def test_scans_that_cannot_be_used_are_passed_over(open3d_library: ModuleType) -> None:
    some = clouds(YARD, SIGMA_M)
    some[5], some[6] = np.zeros((0, 3)), some[6][:10]
    del some[9]
    found = seen(some, problem())
    assert not np.isin(found.alignments.pose, (5, 6, 9)).any()
    assert found.reasons[USED] > STEPS


def test_a_template_without_surfaces_begins_as_vaguely_as_it_is_told(
    open3d_library: ModuleType,
) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(-1.0, 1.0, (12, 2)), np.zeros(12)))
    matchers = TemplateMatchers(KissIcpOptions.for_noise(SIGMA_M), SurfaceMatcher)
    spread = matchers.initialised(Template(0, np.zeros(3), points), points[:1], 0.05)
    np.testing.assert_allclose(
        np.sqrt(np.diag(spread)), (0.05, 0.05, 0.05 / lever_m(points)), rtol=1e-9
    )


@pytest.mark.parametrize("sigma_m", [0.02, 0.1])
def test_options_follow_the_noise(sigma_m: float) -> None:
    settings = KissIcpOptions.for_noise(sigma_m)
    options = TemplateOptions.suited(settings, sigma_m)
    assert options.shared_m == sigma_m
    assert options.most_residual_m >= 0.4 * settings.refinement.reach_m
