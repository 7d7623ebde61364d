"""Low-variance resampling, and the ancestors of the particles of a cloud."""

import numpy as np
import pytest

from ekf_reference.core.geometry import Array, Index
from ekf_reference.fastslam.history import CloudHistory
from ekf_reference.fastslam.resampling import (
    effective_sample_size,
    log_mean_exp,
    normalised,
    systematic_parents,
)

DRAWS = 4000


def copies(weight: Array, draw: object) -> Array:
    generator = np.random.default_rng(8)
    n = len(weight)
    found = [np.bincount(draw(weight, generator), minlength=n) for _ in range(DRAWS)]  # type: ignore[operator]
    return np.array(found)


def multinomial(weight: Array, generator: np.random.Generator) -> Index:
    return generator.choice(len(weight), len(weight), p=weight)


def first_pointer_at_zero(weight: Array, generator: np.random.Generator) -> Index:
    pointers = np.arange(len(weight)) / len(weight)
    return np.searchsorted(np.cumsum(weight), pointers, side="right")


def unbiased(found: Array, weight: Array) -> bool:
    """Mean copies N w within 5 sigma of the largest variance that systematic resampling has."""
    expected = len(weight) * weight
    part = expected - np.floor(expected)
    sigma = np.sqrt(part * (1.0 - part) / DRAWS)
    return bool((np.abs(found.mean(axis=0) - expected) <= 5.0 * sigma + 1e-12).all())


def low_variance(found: Array, weight: Array) -> bool:
    expected = len(weight) * weight
    return bool(((found >= np.floor(expected)) & (found <= np.ceil(expected))).all())


def test_copies_are_unbiased_and_of_low_variance() -> None:
    weight = normalised(np.random.default_rng(1).normal(0.0, 1.5, 12))
    found = copies(weight, systematic_parents)
    assert unbiased(found, weight)
    assert low_variance(found, weight)
    assert not low_variance(copies(weight, multinomial), weight)
    assert not unbiased(copies(weight, first_pointer_at_zero), weight)


def test_survivors_keep_their_places() -> None:
    weight = normalised(np.random.default_rng(1).normal(0.0, 2.0, 50))
    parents = systematic_parents(weight, np.random.default_rng(2))
    survivors = np.unique(parents)
    np.testing.assert_array_equal(parents[survivors], survivors)


def test_equal_weights_keep_all_and_one_weight_takes_all() -> None:
    generator = np.random.default_rng(0)
    np.testing.assert_array_equal(systematic_parents(np.full(9, 1 / 9), generator), np.arange(9))
    np.testing.assert_array_equal(systematic_parents(np.eye(5)[3], generator), np.full(5, 3))


def test_weights_without_overflow() -> None:
    log_weight = np.array([-1e4, -1e4 + np.log(3.0)])
    np.testing.assert_allclose(normalised(log_weight), (0.25, 0.75))
    assert log_mean_exp(log_weight) == pytest.approx(-1e4 + np.log(2.0))
    assert effective_sample_size(np.full(8, 0.125)) == pytest.approx(8.0)
    assert effective_sample_size(np.eye(4)[0]) == 1.0


def test_effective_ancestors_are_those_of_the_traced_paths() -> None:
    generator, history, n = np.random.default_rng(0), CloudHistory(), 12
    weight = np.full(n, 1.0 / n)
    for _ in range(6):
        history.add(generator.standard_normal((n, 3)), weight)
        history.inherit(generator.integers(0, n, n))
    history.add(generator.standard_normal((n, 3)), weight)
    weight = generator.dirichlet(np.ones(n))
    first = history.ancestors()[0]
    of_origin = np.array([weight[first == k].sum() for k in range(n)])
    expected = 1.0 / float(of_origin @ of_origin)
    assert history.effective_ancestors(weight) == pytest.approx(expected, rel=1e-12)


def test_before_resampling_every_particle_is_its_own_ancestor() -> None:
    assert CloudHistory().effective_ancestors(np.full(8, 0.125)) == pytest.approx(8.0)
