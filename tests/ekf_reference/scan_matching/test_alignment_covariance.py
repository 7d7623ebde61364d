"""Covariances of alignments against their errors."""

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_reference.core.geometry import Array
from ekf_reference.dense.scan import ScanSensor
from ekf_reference.scan_matching.alignment_covariance import (
    CovarianceOptions,
    quadratic_form,
    scan_align,
)
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians
from tests.ekf_reference.ray_casting import Solids
from tests.ekf_reference.scan_matching.scenes import (
    BEAMS,
    CORRIDOR,
    COURT,
    DRUM,
    ELL,
    LASER,
    THESIS,
    WALL,
    YARD,
    guess_of,
    pair,
)

PRIOR = np.diag((0.2, 0.2, 0.05)) ** 2
UNIT = np.array((1.0, 1.0, 0.1))


def test_5_17_gives_a_gaussians_covariance_exactly() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    covariance = root @ root.T + 0.1 * np.eye(3)
    for count in (6, 20):
        apart = rng.normal(size=(count, 3)) * (1.0, 1e-3, 30.0)
        drop = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(covariance), apart)
        np.testing.assert_allclose(
            np.linalg.inv(quadratic_form(apart, drop)), covariance, rtol=1e-6, atol=1e-9
        )
    with pytest.raises(ValueError, match="at least 6"):
        quadratic_form(apart[:5], drop[:5])


class Trials:
    """Errors (N, 3), covariances and curvatures (N, 3, 3), open directions (N,)."""

    def __init__(self, scenes: list[Solids], count: int, seed: int, *sensors: ScanSensor) -> None:
        rng = np.random.default_rng(seed)
        error, covariance, curvature, free, heading = [], [], [], [], []
        for k in range(count):
            two = pair(rng, scenes[k % len(scenes)], sensors[k % len(sensors)])
            found = scan_align(two.first, two.second, guess_of(rng, two.motion, PRIOR), PRIOR)
            error.append(found.pose - two.motion)
            covariance.append(found.covariance)
            curvature.append(found.curvature)
            free.append(found.open_directions)
            heading.append(two.motion[2])
        self.error, self.covariance = np.array(error), np.array(covariance)
        self.curvature, self.free = np.array(curvature), np.array(free)
        self.heading = np.array(heading)

    def nees(self, covariance: Array) -> float:
        whitened = np.linalg.solve(covariance, self.error[:, :, None])[:, :, 0]
        return float(np.einsum("ni,ni->n", self.error, whitened).mean())

    def parts(self) -> tuple[Array, Array]:
        """NEES (N,) in the fixed subspace, and errors over sigmas along what is open."""
        fixed, wide = [], []
        for e, c, free in zip(self.error, self.covariance, self.free, strict=True):
            size, axes = np.linalg.eigh(c / np.outer(UNIT, UNIT))
            z = (axes.T @ (e / UNIT)) / np.sqrt(size)
            fixed.append(np.square(z[: 3 - free]).sum())
            wide.extend(np.abs(z[3 - free :]).tolist())
        return np.array(fixed), np.array(wide)


def within_band(value: float, degrees: int, count: int) -> bool:
    """Two-sided 95 % of an average of chi-squares."""
    low, high = chi2.ppf((0.025, 0.975), degrees * count) / count
    return bool(low < value < high)


@pytest.fixture(scope="module")
def shaped() -> Trials:
    """Of 2 cm and 0.1 degrees, and of Nieto 2005, Table 5.1: 10 cm and 1 degree."""
    return Trials([ELL, COURT, YARD], 200, 11, LASER, THESIS)


def test_nees_over_200_pairs_is_in_the_band(shaped: Trials) -> None:
    assert (shaped.free == 0).mean() > 0.95
    assert within_band(shaped.nees(shaped.covariance), 3, 200)


@pytest.mark.slow
def test_the_band_rejects_broken_covariances(shaped: Trials) -> None:
    """The curvature of Lambda as it is (5.16), half, twice, and turned the wrong way."""
    unscaled: Array = np.linalg.inv(shaped.curvature).astype(float)
    assert shaped.nees(unscaled) < 0.3
    for factor in (0.5, 2.0):
        assert not within_band(shaped.nees(factor * shaped.covariance), 3, 200)
    turned = []
    for c in shaped.covariance:
        # As if the frames' axes had been exchanged: a quarter of a turn.
        turn = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
        turned.append(turn @ c @ turn.T)
    assert not within_band(shaped.nees(np.array(turned)), 3, 200)


def test_r_by_curvature_is_p_of_5_16_where_all_directions_are_fixed() -> None:
    """And positive definite, no less wide along a wall, where a direction is not."""
    rng, belief = np.random.default_rng(12), CovarianceOptions(form="curvature")
    for scene, free in ((YARD, 0), (WALL, 1)):
        two = pair(rng, scene, LASER)
        guess = guess_of(rng, two.motion, PRIOR)
        ours, fitted = (
            scan_align(two.first, two.second, guess, PRIOR, belief=one)
            for one in (CovarianceOptions(), belief)
        )
        assert ours.open_directions == fitted.open_directions == free
        np.testing.assert_array_equal(fitted.pose, ours.pose)
        assert not fitted.by_second.any()
        if free:
            by_noise, by_shape = (
                float(np.linalg.eigvalsh(one.covariance)[-1]) for one in (ours, fitted)
            )
            assert by_shape == pytest.approx(by_noise, rel=1e-2)
        else:
            np.testing.assert_allclose(
                fitted.covariance @ fitted.curvature, np.eye(3), rtol=1e-9, atol=1e-9
            )
            # broken: the sandwich is another matrix, and far smaller
            assert np.trace(ours.covariance) < 0.5 * np.trace(fitted.covariance)


@pytest.fixture(scope="module")
def flat() -> Trials:
    return Trials([CORRIDOR, WALL], 60, 13, LASER)


@pytest.mark.slow
def test_what_a_wall_does_not_fix_is_wide(flat: Trials) -> None:
    """Along it the sigma is above the prior's and covers the error; across, NEES is in the band."""
    assert (flat.free >= 1).all()
    assert (flat.free == 1).mean() > 0.95
    fixed, wide = flat.parts()
    assert wide.max() < 0.3
    assert np.sqrt(np.linalg.eigvalsh(flat.covariance)[:, -1]).min() > 10.0 * 0.2
    once = flat.free == 1
    assert within_band(float(fixed[once].mean()), 2, int(once.sum()))
    # What the correlation's own curvature says of the wide direction is too little.
    own = np.linalg.eigvalsh(flat.curvature)[:, 0]
    assert np.median(own) > 1.0 / (10.0 * 0.2) ** 2


def test_a_round_tower_leaves_the_turn_about_it_open() -> None:
    trials = Trials([DRUM], 24, 14, LASER)
    assert (trials.free >= 1).all()
    fixed, wide = trials.parts()
    assert wide.max() < 0.3
    # The valley is curved, and the prior moves far along it: wider than the errors, not narrower.
    assert fixed.mean() < 2.0


def test_what_is_open_stays_as_guessed() -> None:
    rng = np.random.default_rng(15)
    two = pair(rng, WALL)
    guess = two.motion + (0.05, 0.4, 0.0)
    found = scan_align(two.first, two.second, guess, PRIOR)
    axis = np.linalg.eigh(found.covariance)[1][:, -1]
    assert abs(axis @ (found.pose - guess)) < 0.03


def test_without_a_meeting_the_guess_comes_back_with_all_open() -> None:
    two = pair(np.random.default_rng(16), ELL)
    blank = of_scan(BEAMS, np.full(len(BEAMS), np.nan), LASER)
    guess = np.array((1.0, -1.0, 0.3))
    found = scan_align(two.first, blank, guess, PRIOR)
    np.testing.assert_allclose(found.pose, guess, atol=1e-12)
    assert found.open_directions == 3
    assert (np.linalg.eigvalsh(found.covariance - 25.0 * PRIOR) > 0.0).all()


def test_wrong_maxima_have_covariances_too() -> None:
    """From guesses far off, where Lambda may be nothing a sample away."""
    rng = np.random.default_rng(17)
    for _ in range(6):
        two = pair(rng, YARD)
        guess = two.motion + rng.uniform(-1.0, 1.0, 3) * (6.0, 6.0, 2.0)
        found = scan_align(two.first, two.second, guess, PRIOR)
        assert np.isfinite(found.pose).all()
        assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


def test_the_last_digit_decides_nothing() -> None:
    """Means and guess off by 1e-12 of themselves: as many open directions, all else to 1e-8."""
    rng = np.random.default_rng(18)

    def off(one: SumOfGaussians) -> SumOfGaussians:
        mean = one.mean * (1.0 + 1e-12 * rng.standard_normal(one.mean.shape))
        return SumOfGaussians(mean, one.covariance, one.weight, one.boundary)

    for k in range(12):
        scene = (ELL, COURT, YARD, CORRIDOR)[k % 4]
        two = pair(rng, scene, (LASER, THESIS)[k % 2])
        guess = guess_of(rng, two.motion, PRIOR)
        found = scan_align(two.first, two.second, guess, PRIOR)
        again = scan_align(off(two.first), off(two.second), guess * (1.0 + 1e-12), PRIOR)
        assert again.open_directions == found.open_directions
        np.testing.assert_allclose(again.pose, found.pose, atol=1e-8)
        np.testing.assert_allclose(again.covariance, found.covariance, rtol=1e-6, atol=1e-8)
