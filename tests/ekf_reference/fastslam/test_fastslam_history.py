"""Ancestors of the particles of a cloud."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_reference.fastslam.history import CloudHistory


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
    assert history.copy().effective_ancestors(weight) == history.effective_ancestors(weight)


def test_before_resampling_every_particle_is_its_own_ancestor() -> None:
    assert CloudHistory().effective_ancestors(np.full(8, 0.125)) == pytest.approx(8.0)
