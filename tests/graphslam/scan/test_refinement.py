"""The judge of all matches: its rows, its result, and how sure it is of it."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from graphslam.scan import planar, refinement
from graphslam.scan.refinement import RefinementOptions, refine
from graphslam.scan.registration import ScanError
from graphslam.scan.surfaces import Patches, SurfaceMap
from tests.graphslam.numerics import Array, central_difference, relative_error
from tests.graphslam.scan.shapes import COURT, LONG, box, hall_in_space, scan, seen_from

FINE = RefinementOptions(iterations=50, floor_m=1e-9)


class FixedPairs:
    """A target that pairs every point with the same patch, wherever it is laid."""

    dimension = 2

    def __init__(self, rng: np.random.Generator, centre: Array) -> None:
        turn = rng.uniform(0.0, np.pi, len(centre))
        flat = rng.random(len(centre)) < 0.7
        normal = np.column_stack((np.cos(turn), np.sin(turn)))
        self.patch = Patches(centre, normal, flat, np.ones(len(centre), dtype=bool))

    def patches(self, places: Array) -> Patches:
        return self.patch


def rows(source: Array, target: Any, motion: Array) -> tuple[Array, Array]:
    """Jacobian (R, 3) and errors (R,) that the refinement makes of pairs."""
    made: list[tuple[Array, Array]] = []

    def keep(jacobian: Array, error: Array, *_: object) -> None:
        made.append((jacobian, error))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refinement, "_System", keep)
        refinement._linearise(source, target, motion, RefinementOptions(reach_m=1e3))
    return made[0]


def errors(source: Array, target: Any, motion: Array) -> Array:
    return rows(source, target, motion)[1]


def test_rows_are_the_derivatives_of_the_errors() -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        source, motion = rng.uniform(-9.0, 9.0, (40, 2)), rng.uniform(-3.0, 3.0, 3)
        target = FixedPairs(rng, rng.uniform(-9.0, 9.0, (40, 2)))
        jacobian, error = rows(source, target, motion)
        assert np.abs(error).max() > 1.0
        numeric = central_difference(partial(errors, source, target), motion)
        # The rows say how points move; errors are what is left to go.
        assert relative_error(jacobian, -numeric) < 1e-7
        about_origin = rows(source, target, motion - (*motion[:2], 0.0))[0]
        assert relative_error(about_origin, -numeric) < 1e-7
        assert relative_error(jacobian * (1.0, 1.0, -1.0), -numeric) > 0.1


def test_the_cost_is_least_at_the_result() -> None:
    """With the weights of the result, its own motion is where all gradients vanish."""
    rng = np.random.default_rng(1)
    true = np.array((0.4, -0.3, 0.7))
    source = rng.uniform(-9.0, 9.0, (80, 2))
    target: Any = FixedPairs(rng, planar.moved(true, source) + rng.normal(0.0, 0.05, (80, 2)))
    options = RefinementOptions(reach_m=10.0, iterations=200)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refinement, "_CONVERGED", 1e-12)
        found = refine(source, target, np.zeros(3), options)

    def cost(motion: Array, scale: float) -> Array:
        error = rows(source, target, motion)[1]
        return np.array([np.log1p((error / (2.385 * scale)) ** 2).sum()])

    error = rows(source, target, found.motion)[1]
    scale = 1.4826 * float(np.median(np.abs(error)))
    slope = central_difference(lambda m: cost(m, scale), found.motion)[0]
    beside = central_difference(lambda m: cost(m, scale), found.motion + (1e-3, 0.0, 0.0))[0]
    assert np.abs(slope).max() < 1e-5 * np.abs(beside).max()
    assert found.overlap == 1.0
    assert found.inliers == 80


def walls(spacing_m: float) -> Array:
    """(N, 3) points along the walls of COURT, without its corners, which patches would round."""
    parts = []
    for x1, y1, x2, y2 in COURT.tolist():
        count = int(np.hypot(x2 - x1, y2 - y1) / spacing_m)
        part = np.linspace(0.0, 1.0, count)[:, None]
        parts.append(np.array((x1, y1)) + part * (x2 - x1, y2 - y1))
    flat = np.vstack(parts)
    return np.column_stack((flat, np.zeros(len(flat))))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_known_motion_is_recovered_without_noise(dimension: int) -> None:
    true = np.array((0.05, -0.08, 0.03))
    cloud = walls(0.05) if dimension == 2 else hall_in_space(np.random.default_rng(0))
    target = SurfaceMap(cloud)
    assert target.dimension == dimension
    source = seen_from(true, cloud)[:, :dimension]
    found = refine(source, target, np.zeros(3), FINE)
    assert relative_error(found.motion, true) < 0.01
    assert found.overlap > 0.8
    assert found.open_directions == 0
    assert found.residual_m < 0.01


CALIBRATION = 1.1
"""On the variance, found with seed 100, against an exact map: of what Cauchy weights hide."""
TRIALS = 300


def trials(seed: int) -> tuple[Array, Array]:
    """Squared errors (N,): as stated, and with the covariance in the target's axes."""
    rng = np.random.default_rng(seed)
    near = np.vstack((LONG, box(3.0, 0.0, 0.5, 0.5, 0.4)))
    cloud = np.vstack([
        np.column_stack((np.linspace(x1, x2, 400), np.linspace(y1, y2, 400), np.zeros(400)))
        for x1, y1, x2, y2 in near.tolist()
    ])  # fmt: skip
    target = SurfaceMap(cloud)
    options = RefinementOptions(calibration=CALIBRATION, iterations=20)
    right: list[float] = []
    wrong: list[float] = []
    for _ in range(TRIALS):
        true = np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(-np.pi, np.pi))
        source = scan(rng, near, true, 0.02)[:, :2]
        found = refine(source, target, true + rng.normal(size=3) * (0.05, 0.05, 0.01), options)
        error = planar.between(found.motion, true)
        turn = np.eye(3)
        turn[:2, :2] = planar.matrix(true)[:2, :2]
        for squared, spread in (
            (right, found.covariance),
            (wrong, turn @ found.covariance @ turn.T),
        ):
            squared.append(float(error @ np.linalg.solve(spread, error)))
    return np.array(right), np.array(wrong)


@pytest.mark.slow
def test_the_covariance_is_that_of_the_errors_in_the_source_s_frame() -> None:
    right, wrong = trials(3)
    low, high = chi2.ppf((0.025, 0.975), 3 * TRIALS) / TRIALS
    assert low < right.mean() < high
    assert not low < wrong.mean() < high
    assert not low < 0.8 * right.mean() < high
    assert not low < 1.25 * right.mean() < high


def test_enough_points_must_have_a_surface_near() -> None:
    """On both sides of the share that is asked for, and of the number."""
    cloud = walls(0.05)
    target, source = SurfaceMap(cloud), cloud[::5, :2]
    away = np.full((len(source), 2), 50.0) + source
    options = RefinementOptions(least_overlap=0.5)
    more = np.vstack((source, away[: len(source) - 20]))
    found = refine(more, target, np.zeros(3), options)
    assert 0.5 < found.overlap < 0.52
    assert found.inliers == len(source)
    fewer = np.vstack((source, away, away[:10] + 5.0))
    with pytest.raises(ScanError, match=r"only 49% of the points .*, expected 50%"):
        refine(fewer, target, np.zeros(3), options)
    few = np.vstack((source[:9], away[:5]))
    with pytest.raises(ScanError, match=r"only 9 of 14 points have a surface near, expected 10"):
        refine(few, target, np.zeros(3), options)
    assert refine(np.vstack((source[:10], away[:5])), target, np.zeros(3), options).inliers == 10
