"""Pose graphs whose numbers mean something else than their format says."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from graphslam.misread_edges import misread_edges
from graphslam.optimum import chi_square_test
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth
from tests.graphslam.g2o_files import rounds
from tests.graphslam.numerics import Array


def root(covariance: Array) -> Array:
    """What is read where the root of an information, upper triangle, stands for it."""
    upper = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
    return np.asarray(np.linalg.inv(np.triu(upper) + np.triu(upper, 1).transpose(0, 2, 1)))


def inverse(covariance: Array) -> Array:
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def inverted(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    return replace(problem, loop_closures=replace(closed, first=closed.second, second=closed.first))


def odometry_as_covariance(problem: SlamProblem) -> SlamProblem:
    return replace(problem, increment_covariance=inverse(problem.increment_covariance))


def closures_as_root(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    return replace(problem, loop_closures=replace(closed, covariance=root(closed.covariance)))


def all_as_covariance(problem: SlamProblem) -> SlamProblem:
    closed = problem.loop_closures
    changed = replace(closed, covariance=inverse(closed.covariance))
    return replace(odometry_as_covariance(problem), loop_closures=changed)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (inverted, "the loop closures fit when inverted"),
        (
            odometry_as_covariance,
            "the odometry's edges fit when .* times the loop closures.* is the covariance",
        ),
        (all_as_covariance, "all edges between poses fit when .* is the covariance"),
        (closures_as_root, "the loop closures fit when .* is a square root of it"),
    ],
)
def test_what_was_meant_is_found(spoil: Callable[[SlamProblem], SlamProblem], words: str) -> None:
    problem = rounds()
    right = smooth(problem, {})
    assert right.optimality.chi_square.reading == "plausible"
    spoilt = spoil(problem)
    found = misread_edges(spoilt, smooth(spoilt, {}).optimality.chi_square)
    assert found is not None
    assert pytest.approx(2.0 * right.error, rel=1e-6) == found.chi_square.chi2
    assert re.match(words, found.words)


@pytest.mark.parametrize("factor", [1.0, 0.01, 30.0])
def test_noise_of_another_size_is_not_explained(factor: float) -> None:
    """A chi-square far out, and no other reading that fits; broken: one that takes the nearest."""
    problem = rounds()
    closed = problem.loop_closures
    scaled = replace(
        problem,
        increment_covariance=problem.increment_covariance / factor,
        loop_closures=replace(closed, covariance=closed.covariance / factor),
    )
    assert misread_edges(scaled, smooth(scaled, {}).optimality.chi_square) is None


def test_graphs_without_closures_have_one_reading() -> None:
    problem = rounds()
    bare = replace(problem, loop_closures=type(problem.loop_closures)())
    assert misread_edges(bare, chi_square_test(1e9, 36)) is None
