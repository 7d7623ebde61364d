"""A quadtree covers what its grid covers, and no leaf hides a difference."""

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array
from ekf_reference.dense.layers.quadtree import Quadtree, quadtree

CELL_M = 0.2


def grid(rng: np.random.Generator) -> tuple[Array, Array]:
    """Cells around the origin, a tenth of them never seen; flat but for a wall."""
    at = np.stack(np.meshgrid(np.arange(-19, 21), np.arange(-7, 33), indexing="ij"), axis=-1)
    at = at.reshape(-1, 2)[rng.random(1600) > 0.1].astype(float)
    flat = 0.2 + 0.01 * rng.random(len(at))
    center = np.asarray((at + 0.5) * CELL_M, dtype=np.float64)
    return center, np.where(at[:, 0] == 3, 0.9, flat)


def held(tree: Quadtree, center: Array) -> NDArray[np.bool_]:
    """(N, M) which cell lies in which leaf."""
    off = center[:, None] - tree.corner
    inside = (off > 0.0) & (off < tree.side_m[:, None])
    return inside[..., 0] & inside[..., 1]


def test_every_cell_is_in_one_leaf_that_is_alike() -> None:
    center, occupancy = grid(np.random.default_rng(0))
    tree = quadtree(center, occupancy, CELL_M, most=0.05)
    inside = held(tree, center)
    assert (inside.sum(axis=1) == 1).all()
    np.testing.assert_allclose(inside.sum(axis=0), (tree.side_m / CELL_M) ** 2, rtol=1e-9)
    means = [occupancy[row].mean() for row in inside.T]
    np.testing.assert_allclose(tree.occupancy, means, rtol=1e-12)
    assert max(np.ptp(occupancy[row]) for row in inside.T) <= 0.05
    assert tree.side_m.max() >= 4 * CELL_M


def test_four_leaves_that_are_alike_are_one() -> None:
    """Full and flat, 16 x 16 cells are one leaf; with one cell apart its squares stay small."""
    at = np.stack(np.meshgrid(np.arange(16), np.arange(16)), axis=-1).reshape(-1, 2)
    center = np.asarray((at + 0.5) * CELL_M, dtype=np.float64)
    flat = np.full(256, 0.3)
    assert len(quadtree(center, flat, CELL_M, most=0.0).side_m) == 1
    flat[0] = 0.9
    assert len(quadtree(center, flat, CELL_M, most=0.5).side_m) == 4 + 3 + 3 + 3
