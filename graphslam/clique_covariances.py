"""Covariances of single variables out of a Bayes tree, from its roots to its leaves.

A clique is R x + S y = d, of its variables x and the y that it shares with its parent. The parent's
covariance holds that of y, C; then Cov(x, y) = -R^-1 S C, and Cov(x) = R^-1 R^-T + G C G^T with
G = R^-1 S, a sum of squares, which loses no digits. gtsam's marginals eliminate a graph for each
variable.
Source: Takahashi, Fagan and Chen (1973), entries of the inverse where the factor is not zero.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import gtsam
import numpy as np

from graphslam.arrays import Array, Index
from graphslam.layout import POINT, POSE_LANDMARK

_FRAME_WIDTH = POSE_LANDMARK.width
"""Numbers of a pose, and of a pose landmark."""


class _Clique(NamedTuple):
    """A clique's conditional, and the number of its parent; of a root -1."""

    conditional: gtsam.GaussianConditional
    parent: int


class _Joint(NamedTuple):
    """Covariance (n, n) of a clique's variables, and the first entry of each by its key."""

    covariance: Array
    first: dict[int, int]


def variable_covariances(tree: gtsam.GaussianBayesTree) -> dict[int, Array]:
    """Return the covariance of each variable alone, by its key.

    Args:
        tree: Of poses, points and pose landmarks, with graph_builder's keys.

    Returns:
        (3, 3) of a pose or pose landmark, (2, 2) of a point, in the tree's own coordinates.

    Raises:
        numpy.linalg.LinAlgError: A variable is without information.
    """
    cliques = _cliques(tree)
    inverses = _inverse_roots([clique.conditional.R() for clique in cliques])
    children = np.bincount([clique.parent + 1 for clique in cliques], minlength=len(cliques) + 1)
    waiting: list[int] = children[1:].tolist()
    joints: dict[int, _Joint] = {}  # of cliques with children to come: few are needed at once
    covariances: dict[int, Array] = {}
    for number, (clique, inverse) in enumerate(zip(cliques, inverses, strict=True)):
        joint = _joint(clique.conditional, inverse, joints.get(clique.parent))
        for key, first in joint.first.items():
            if first >= len(inverse):
                break
            block = slice(first, first + _width(key))
            covariances[key] = joint.covariance[block, block].copy()
        if waiting[number]:
            joints[number] = joint
        if clique.parent >= 0:
            waiting[clique.parent] -= 1
            if not waiting[clique.parent]:
                del joints[clique.parent]
    return covariances


def _cliques(tree: gtsam.GaussianBayesTree) -> list[_Clique]:
    """Return the cliques, each after its parent and a subtree at a time."""
    cliques: list[_Clique] = []
    stack = [(root, -1) for root in tree.roots()]
    while stack:
        clique, parent = stack.pop()
        stack.extend((clique[i], len(cliques)) for i in range(clique.nrChildren()))
        cliques.append(_Clique(clique.conditional(), parent))
    return cliques


def _inverse_roots(roots: list[Array]) -> list[Array]:
    """Return each R^-1; those of a size are inverted at once."""
    numbers = defaultdict[int, list[int]](list)
    for number, root in enumerate(roots):
        numbers[len(root)].append(number)
    inverses = roots.copy()
    for alike in numbers.values():
        stack = np.linalg.inv(np.array([roots[number] for number in alike]))
        for number, inverse in zip(alike, stack, strict=True):
            inverses[number] = inverse
    return inverses


def _joint(conditional: gtsam.GaussianConditional, inverse: Array, parent: _Joint | None) -> _Joint:
    """Return a clique's joint covariance by its parent's; a root has none."""
    first: dict[int, int] = {}
    shared: list[int] = []
    size, frontal = 0, len(inverse)
    for key in list(conditional.keys()):
        width = _width(key)
        if size >= frontal and parent is not None:
            entry = parent.first[key]
            shared.extend(range(entry, entry + width))
        first[key] = size
        size += width
    alone = inverse @ inverse.T
    if parent is None or not shared:
        return _Joint(alone, first)
    entries: Index = np.array(shared)
    covariance = np.empty((size, size))
    gain = inverse @ conditional.S()
    separator = parent.covariance.take(entries, 0).take(entries, 1)
    cross = gain @ separator
    covariance[:frontal, :frontal] = alone + cross @ gain.T
    covariance[:frontal, frontal:] = -cross
    covariance[frontal:, :frontal] = -cross.T
    covariance[frontal:, frontal:] = separator
    return _Joint(covariance, first)


def _width(key: int) -> int:
    return POINT.width if POINT.key <= key < POSE_LANDMARK.key else _FRAME_WIDTH
