"""The energy test of FastSLAM's clouds against the smoother's posterior."""

import numpy as np
import pytest
from scipy.special import erf
from scipy.stats import kstest

from comparisons.arrays import Array
from comparisons.extensions.fastslam.check import (
    LEVEL,
    SIMULATIONS,
    CloudCheck,
    check_clouds,
    energy,
    permuted,
    simulated,
)
from comparisons.extensions.fastslam.stretches import StretchClouds, standardised_moments

CLOUDS, STRETCHES, DIMENSION = 16, 6, 9


def stretch(
    generator: np.random.Generator,
    *,
    shift: float = 0.0,
    spread: float = 1.0,
    scatter: float = 0.3,
    exact: float | None = None,
) -> StretchClouds:
    """Draws of variance `spread` around `shift`; the clouds' means scatter by `scatter` sigma.

    exact: standard deviation of the exact posterior, where that is known.
    """
    at = np.zeros(DIMENSION)
    at[1] = shift
    return StretchClouds(
        begin_s=10.0,
        end_s=15.0,
        depleted=False,
        draw=at + np.sqrt(spread) * generator.standard_normal((CLOUDS, DIMENSION)),
        mean=at + scatter * generator.standard_normal((CLOUDS, DIMENSION)),
        moments=np.zeros((CLOUDS, 2, 3)),
        exact=lambda rng: None if exact is None else exact * rng.standard_normal((96, DIMENSION)),
    )


def checked(seed: int = 0, **kind: float | None) -> CloudCheck:
    generator = np.random.default_rng(seed)
    return check_clouds([stretch(generator, **kind) for _ in range(STRETCHES)])  # type: ignore[arg-type]


@pytest.mark.parametrize("dimension", [3, 100, 101, 300])
def test_the_energy_is_that_of_the_definition(dimension: int) -> None:
    generator = np.random.default_rng(dimension)
    draw = 1.3 * generator.standard_normal((12, dimension)) + 0.2
    normal = generator.standard_normal((20_000, dimension))
    to_normal = np.mean([np.linalg.norm(u - normal, axis=1).mean() for u in draw])
    half = len(normal) // 2
    within = np.linalg.norm(normal[:half] - normal[half:], axis=1).mean()
    among = np.mean([np.linalg.norm(u - draw, axis=1).mean() for u in draw])
    assert float(energy(draw)) == pytest.approx(12 * (2 * to_normal - within - among), abs=0.2)


def test_the_energy_in_three_dimensions_is_that_of_the_closed_form() -> None:
    draw = np.random.default_rng(1).standard_normal((7, 3)) * 2.0
    r = np.linalg.norm(draw, axis=1)
    to_normal = np.sqrt(2 / np.pi) * np.exp(-r * r / 2) + (r + 1 / r) * erf(r / np.sqrt(2))
    among = np.linalg.norm(draw[:, None] - draw, axis=2).mean()
    expected = 7 * (2 * to_normal.mean() - 4 / np.sqrt(np.pi) - among)
    assert float(energy(draw)) == pytest.approx(expected, rel=1e-10)


def test_p_is_uniform_where_the_posteriors_are_one() -> None:
    generator = np.random.default_rng(2)
    null = sum(simulated(CLOUDS, d, generator) for d in (3, 9))
    p = []
    for _ in range(400):
        own = sum(float(energy(generator.standard_normal((CLOUDS, d)))) for d in (3, 9))
        p.append((1 + np.count_nonzero(null >= own)) / (SIMULATIONS + 1))
    assert kstest(p, "uniform").pvalue > 0.01
    broken = [float(energy(1.15 * generator.standard_normal((CLOUDS, 9)))) for _ in range(400)]
    nine = simulated(CLOUDS, 9, generator)
    assert kstest([np.mean(nine >= one) for one in broken], "uniform").pvalue < 1e-6


def test_the_energy_finds_what_the_usage_page_says() -> None:
    """12 stretches of 16 clouds and 8 landmarks, as of the simulated loop."""
    generator = np.random.default_rng(6)
    pool = simulated(16, 19, generator)
    null = np.sum([generator.permutation(pool) for _ in range(12)], axis=0)
    limit, found = np.sort(null)[-2], []
    for shift, spread in ((0.8, 1.0), (0.5, 1.0), (0.0, 1.3)):
        draw = np.sqrt(spread) * generator.standard_normal((100, 12, 16, 19))
        draw[..., 0] += shift
        found.append(float(np.mean(energy(draw).sum(axis=1) >= limit)))
    assert found[0] > 0.9
    assert 0.1 < found[1] < 0.6
    assert found[2] > 0.6


def test_agreement_disagreement_and_no_verdict() -> None:
    same, shifted = checked(), checked(shift=1.0)
    assert same.agrees is True
    assert same.p > LEVEL
    assert shifted.agrees is False
    assert shifted.squared_shift > shifted.largest_shift
    assert shifted.worst.shift == pytest.approx(1.0, abs=0.3)
    assert checked(shift=1.0, scatter=3.0).agrees is None  # clouds too small to tell


@pytest.mark.parametrize("spread", [0.6, 1.8])
def test_a_wrong_covariance_disagrees_though_the_means_agree(spread: float) -> None:
    found = checked(spread=spread)
    assert found.agrees is False
    assert found.squared_shift < found.largest_shift
    assert found.spread == pytest.approx(spread, rel=0.15)


def moments(draw: str) -> Array:
    generator = np.random.default_rng(2)
    found = []
    for _ in range(CLOUDS):
        pose = generator.standard_normal((400, 3))
        if draw == "skew":
            pose[:, 0] = generator.exponential(size=400)
        if draw == "modes":
            pose[:, 2] += 8.0 * (generator.random(400) < 0.5)
        found.append(standardised_moments(pose, np.full(400, 1 / 400)))
    return np.array(found)


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        ("gauss", []),
        ("skew", ["east from 10.0 to 15.0 s is skew"]),
        ("modes", ["heading from 10.0 to 15.0 s is flat"]),
    ],
)
def test_shapes_that_are_not_gaussian_are_named(draw: str, words: list[str]) -> None:
    one = stretch(np.random.default_rng(0))
    found = check_clouds([StretchClouds(**{**vars(one), "moments": moments(draw)})])
    assert len(found.shape) == len(words)
    assert all(one.startswith(word) for one, word in zip(found.shape, words, strict=True))
    assert found.agrees is True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exact", "agrees"), [(None, False), (1.0, False), (1.5, True), (2.5, False)]
)
def test_clouds_like_the_exact_posterior_agree_where_its_gaussian_does_not(
    exact: float | None, agrees: bool
) -> None:
    found = checked(spread=1.5**2, exact=exact)
    assert found.p <= LEVEL
    assert found.exact is not None
    assert found.exact.stretches == (0 if exact is None else STRETCHES)
    assert found.exact.explains is agrees
    assert found.agrees is agrees
    assert (found.exact.gaussian <= LEVEL) is (exact in {1.5, 2.5})


def test_the_exact_posterior_is_not_sought_where_the_gaussian_will_do() -> None:
    assert checked(exact=3.0).exact is None


def test_p_between_draws_is_uniform_where_they_are_of_one_distribution() -> None:
    generator = np.random.default_rng(3)
    p: list[float] = []
    broken: list[float] = []
    for _ in range(120):
        first, second = generator.standard_normal((12, 5)), generator.standard_normal((40, 5))
        for found, draw in ((p, first), (broken, first + 0.3)):
            own, chance = permuted(draw, second, generator)
            found.append((1 + np.count_nonzero(chance >= own)) / (SIMULATIONS + 1))
    assert kstest(p, "uniform").pvalue > 0.01
    assert kstest(broken, "uniform").pvalue < 1e-6


def test_the_energy_between_draws_is_that_of_the_definition() -> None:
    generator = np.random.default_rng(4)
    first, second = generator.standard_normal((5, 3)), generator.standard_normal((8, 3)) + 1.0
    mean = [
        np.linalg.norm(a[:, None] - b, axis=2).mean()
        for a, b in ((first, second), (first, first), (second, second))
    ]
    expected = 40 / 13 * (2 * mean[0] - mean[1] - mean[2])
    assert permuted(first, second, generator)[0] == pytest.approx(expected, rel=1e-12)
