"""Covariances of single variables from a Bayes tree, beside the inverse of the information."""

import weakref
from collections.abc import Iterator

import gtsam
import numpy as np
import pytest

from graphslam import clique_covariances
from graphslam.arrays import Array
from graphslam.clique_covariances import variable_covariances
from graphslam.graph_builder import POSE_KEY
from graphslam.marginals import eliminate
from graphslam.smoother import smooth
from tests.graphslam import worlds
from tests.graphslam.numerics import relative_error


@pytest.fixture(scope="module")
def linear() -> gtsam.GaussianFactorGraph:
    """A loop with points and pose landmarks, linearised at its optimum."""
    result = smooth(worlds.with_frames(worlds.loop(1, poses=120), 2).problem, {})
    return result.graph.linearize(result.values)


def errors(linear: gtsam.GaussianFactorGraph) -> Iterator[float]:
    """The relative error of each variable's covariance against the dense inverse."""
    keys = gtsam.Ordering(list(linear.keyVector()))
    jacobian, _ = linear.jacobian(keys)
    root = np.linalg.inv(np.linalg.qr(jacobian, mode="r"))
    dense = root @ root.T
    covariances, first = variable_covariances(eliminate(linear)), 0
    for key in linear.keyVector():
        last = first + len(covariances[key])
        yield relative_error(covariances[key], dense[first:last, first:last])
        first = last
    assert first == len(dense)
    assert len(covariances) == len(linear.keyVector())


def test_each_variable_has_its_block_of_the_inverse(linear: gtsam.GaussianFactorGraph) -> None:
    assert max(errors(linear)) < 1e-9


def test_what_a_clique_shares_counts(
    linear: gtsam.GaussianFactorGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each clique as if its parent's variables were known exactly: far too certain."""
    joint = clique_covariances._joint

    def alone(
        conditional: gtsam.GaussianConditional,
        inverse: Array,
        parent: clique_covariances._Joint | None,
    ) -> clique_covariances._Joint:
        known = parent and parent._replace(covariance=np.zeros_like(parent.covariance))
        return joint(conditional, inverse, known)

    monkeypatch.setattr(clique_covariances, "_joint", alone)
    assert max(errors(linear)) > 0.1


def test_parts_without_a_factor_between_them() -> None:
    """A forest: each tree has a root of its own."""
    graph = gtsam.GaussianFactorGraph()
    for key, sigma in enumerate((0.5, 2.0)):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
        graph.add(gtsam.JacobianFactor(POSE_KEY + key, np.eye(3), np.zeros(3), noise))
    covariances = variable_covariances(eliminate(graph))
    assert np.array_equal(covariances[POSE_KEY], 0.25 * np.eye(3))
    assert np.array_equal(covariances[POSE_KEY + 1], 4.0 * np.eye(3))


def test_few_joints_are_held_at_once(
    linear: gtsam.GaussianFactorGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clique's joint covariance goes with its last child."""
    joint, made, most = clique_covariances._joint, list[weakref.ref[Array]](), 0

    def counted(
        conditional: gtsam.GaussianConditional,
        inverse: Array,
        parent: clique_covariances._Joint | None,
    ) -> clique_covariances._Joint:
        nonlocal most
        result = joint(conditional, inverse, parent)
        made.append(weakref.ref(result.covariance))
        most = max(most, sum(reference() is not None for reference in made))
        return result

    monkeypatch.setattr(clique_covariances, "_joint", counted)
    variable_covariances(eliminate(linear))
    assert most < 0.25 * len(made)
