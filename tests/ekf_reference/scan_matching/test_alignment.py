"""Alignments: exact where they can be, found from far, honest where there is nothing to find."""

import math
from functools import partial

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_matching import alignment, search
from ekf_reference.scan_matching.alignment import align, ascend
from ekf_reference.scan_matching.problem import AlignmentOptions, Problem
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.search import Lattice
from ekf_reference.scan_matching.sog import SumOfGaussians
from tests.ekf_reference.scan_matching.scenes import (
    BEAMS,
    COURT,
    ELL,
    LASER,
    YARD,
    box,
    guess_of,
    pair,
    ranges,
    solids,
)

NEAR = np.diag((0.2, 0.2, 0.05)) ** 2
WIDE = np.diag((1.5, 1.5, 0.35)) ** 2


def plain(one: SumOfGaussians) -> SumOfGaussians:
    """Without boundaries."""
    return SumOfGaussians(one.mean, one.covariance, one.weight, np.zeros(len(one), dtype=bool))


def inverse(pose: Array) -> Array:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[:2]
    return np.array((-cos * x - sin * y, sin * x - cos * y, -pose[2]))


@pytest.mark.parametrize("scene", [ELL, COURT, YARD])
def test_a_sum_finds_its_own_copy_exactly(scene: object) -> None:
    one = plain(pair(np.random.default_rng(0), scene).first)  # type: ignore[arg-type]
    true = np.array((0.4, -0.3, 0.2))
    found = align(one, one.transformed(true), true + (0.2, 0.2, -0.05), NEAR)
    assert np.abs(found.pose - true).max() < 1e-6
    assert found.overlap == pytest.approx(1.0)
    assert found.converged


def lattices(seeds: int = 5) -> list[Array]:
    """Of a prior that is round in the plane, moved in its last digits."""
    prior, found = np.diag((3.0, 3.0, 0.5)) ** 2, []
    for seed in range(seeds):
        noise = 1e-13 * np.random.default_rng(seed).standard_normal((3, 3))
        found.append(Lattice.over(np.zeros(3), prior + noise + noise.T, 0.8, 2.0).pose)
    return found


def test_starts_over_a_round_prior_do_not_hang_on_the_last_digit() -> None:
    """All axes of a circle are principal: which ones are taken is a rule, not what eigh returns."""
    first, *others = lattices()
    assert all(np.allclose(first, other, atol=1e-6) for other in others)


def test_starts_by_the_axes_of_eigh_alone_would(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_EQUAL", 0.0)
    first, *others = lattices()
    assert not all(len(first) == len(o) and np.abs(first - o).max() < 0.1 for o in others)


@pytest.mark.parametrize("scene", [ELL, COURT, YARD])
def test_scans_align_from_far(scene: object) -> None:
    """Guesses as wrong as the prior says, 1.5 m and 20 degrees; all within 5 cm and half a degree.

    One stage and one start alone fall into other maxima.
    """
    rng = np.random.default_rng(1)
    error: list[Array] = []
    alone: list[Array] = []
    lone = AlignmentOptions(inflation_m=(0.0,), starts=1, finished=1, spacing_m=100.0)
    for _ in range(8):
        two = pair(rng, scene)  # type: ignore[arg-type]
        guess = guess_of(rng, two.motion, 0.6 * WIDE)
        for options, to in ((None, error), (lone, alone)):
            found = align(two.first, two.second, guess, WIDE, options)
            to.append(np.abs(found.pose - two.motion) / (0.05, 0.05, np.deg2rad(0.5)))
    assert np.max(error) < 1.0
    assert np.median(np.max(alone, axis=1)) > 1.0


def starts_with_axes(count: int) -> tuple[Problem, Array, Array]:
    """A room's problem, poses (K, 3) about its guess, and directions (K, 3, 1) to hold them on."""
    two = pair(np.random.default_rng(8), ELL)
    problem = Problem.of(two.first, two.second, two.motion, NEAR)
    rng = np.random.default_rng(9)
    start = problem.guess + 0.05 * problem.unit * rng.standard_normal((count, 3))
    axis = rng.standard_normal((count, 3, 1))
    return problem, start, axis / np.linalg.norm(axis, axis=1, keepdims=True)


def test_many_ascents_end_where_each_ends_alone() -> None:
    """Free ones all at one maximum; held ones have not moved along what they are held on."""
    problem, start, axis = starts_with_axes(5)
    for held in (None, axis):
        found = ascend(problem, start, 0.0, held=held)
        assert found.converged.all()
        for k in range(5):
            alone = ascend(problem, start[k : k + 1], 0.0, held=None if held is None else held[[k]])
            np.testing.assert_allclose(found.pose[k], alone.pose[0], atol=2e-4)
    assert np.ptp(ascend(problem, start, 0.0).pose, axis=0).max() < 1e-3
    along = np.einsum("ki,ki->k", (found.pose - start) / problem.unit, axis[:, :, 0])
    assert np.abs(along).max() < 1e-12
    assert np.ptp(found.pose, axis=0).max() > 0.02


def test_a_held_ascent_ends_where_nothing_rises_beside_what_is_held(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Broken: the step of a free ascent, without its part along what is held."""
    problem, start, axis = starts_with_axes(8)

    newton = alignment._newton

    def steepest(*, broken: bool) -> float:
        """Slope of ln Lambda at the ends, beside what is held."""
        left = 0.0
        for pose, held in zip(start[:, None], axis[:, None], strict=True):
            free = np.eye(3) - held[0] @ held[0].T
            if broken:
                monkeypatch.setattr(alignment, "_across", lambda slope, bend, held: (slope, bend))
                monkeypatch.setattr(alignment, "_newton", partial(projected, free))
            found = ascend(problem, pose, 0.0, held=held)
            slope = found.pairs.derivatives(found.pose).of_logarithm(problem.unit)[0]
            left = max(left, float(np.abs(slope @ free).max()))
        return left

    def projected(free: Array, *of: Array) -> Array:
        return np.asarray(newton(*of) @ free)

    assert steepest(broken=False) < 1e-6
    assert steepest(broken=True) > 1e-3


def test_an_exact_maximum_does_not_depend_on_the_way_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 20 starts. Broken: with the pairs that were looked up on the way."""
    problem, start, _ = starts_with_axes(20)

    def spread() -> float:
        ends = [ascend(problem, one[None], 0.0).pose[0] for one in start]
        return float(np.ptp(np.array(ends) / problem.unit, axis=0).max())

    assert spread() < 2e-5
    monkeypatch.setattr(alignment, "_FRESH", np.inf)
    assert spread() > 1e-4


def test_exchanged_sums_give_the_inverse() -> None:
    two = pair(np.random.default_rng(2), COURT)
    back = inverse(two.motion)
    one = align(plain(two.first), plain(two.second), two.motion, NEAR)
    other = align(plain(two.second), plain(two.first), back, NEAR)
    np.testing.assert_allclose(other.pose, inverse(one.pose), atol=2e-3)


def test_the_heading_is_the_nearest_to_the_guess() -> None:
    two = pair(np.random.default_rng(3), ELL)
    turn = np.array((0.0, 0.0, 2.0 * np.pi))
    found = align(two.first, two.second, two.motion + turn, NEAR)
    assert np.abs(found.pose - two.motion - turn).max() < 0.05


def test_two_places_that_fit_are_told() -> None:
    """Two boxes alike, 2 m apart: within a wide prior the second fits as well."""
    duplicates = solids(box(8, 1.5, 1.2, 0.8, 20), box(8, -1.5, 1.2, 0.8, 20))
    lone = solids(box(8, 1.5, 1.2, 0.8, 20))
    rng = np.random.default_rng(4)
    scan, template = (
        plain(of_scan(BEAMS, ranges(rng, scene, np.zeros(3), LASER), LASER))
        for scene in (duplicates, lone)
    )
    assert align(template, scan, np.zeros(3), WIDE).runner_up > 0.6
    assert align(template, scan, np.zeros(3), np.diag((0.2, 0.2, 0.05)) ** 2).runner_up < 0.1


def test_what_does_not_meet_says_so() -> None:
    one = pair(np.random.default_rng(5), COURT).first
    blank = of_scan(BEAMS, np.full(len(BEAMS), np.nan), LASER)
    far = one.transformed(np.array((500.0, 0.0, 0.0)))
    guess = np.array((1.0, 2.0, 0.5))
    for first, second in ((one, blank), (blank, one), (blank, blank), (one, far)):
        found = align(first, second, guess, NEAR)
        np.testing.assert_allclose(found.pose, guess, atol=1e-12)
        assert found.overlap == 0.0
        assert not found.converged


@pytest.mark.parametrize(
    ("guess", "covariance", "message"),
    [
        (np.zeros(2), NEAR, "three finite numbers"),
        (np.array((0.0, np.nan, 0.0)), NEAR, "three finite numbers"),
        (np.zeros(3), np.eye(2), "three by three"),
        (np.zeros(3), -NEAR, "negative eigenvalue"),
    ],
)
def test_guesses_that_cannot_be_used(guess: Array, covariance: Array, message: str) -> None:
    one = pair(np.random.default_rng(6), ELL).first
    with pytest.raises(ValueError, match=message):
        align(one, one, guess, covariance)


def test_the_last_stage_is_the_correlation_itself() -> None:
    with pytest.raises(ValueError, match="the last to be 0"):
        AlignmentOptions(inflation_m=(0.5, 0.1))
