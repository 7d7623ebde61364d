from unittest.mock import patch

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.box_tree import BoxTree, tiled


def random_boxes(rng: np.random.Generator, count: int, size_m: float) -> Array:
    low = rng.uniform(0, 100, (count, 2))
    return np.hstack((low, low + rng.uniform(0, size_m, (count, 2))))


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 64, 65, 700])
def test_meetings_equal_brute_force(count: int) -> None:
    rng = np.random.default_rng(count)
    box, asked = random_boxes(rng, count, 9.0), random_boxes(rng, 300, 3.0)
    asked[:150, 2:] = asked[:150, :2]
    asked[7] = np.nan
    for order in (np.arange(count), rng.permutation(count), tiled(box[:, :2])):
        found = BoxTree.pack(box, order).meeting(asked)
        touch = (asked[:, None, :2] <= box[:, 2:]) & (box[:, :2] <= asked[:, None, 2:])
        expected = np.argwhere(touch.all(axis=2))
        pairs = np.column_stack((found.query, found.item))
        assert np.array_equal(pairs[np.lexsort(pairs.T[::-1])], expected)


def test_a_box_that_is_no_number_is_empty_and_hides_no_other() -> None:
    rng = np.random.default_rng(1)
    box = random_boxes(rng, 200, 9.0)
    asked = random_boxes(rng, 300, 3.0)
    whole = BoxTree.pack(box, np.arange(200)).meeting(asked)
    box[::3] = np.nan
    found = BoxTree.pack(box, np.arange(200)).meeting(asked)
    left = whole.item % 3 > 0
    assert np.array_equal(found.item, whole.item[left])
    assert np.array_equal(found.query, whole.query[left])


def tried(tree: BoxTree, point: Array) -> float:
    """Boxes tried per point."""
    with patch.object(np, "flatnonzero", wraps=np.flatnonzero) as chosen:
        tree.meeting(np.hstack((point, point)))
    return sum(len(call.args[0]) for call in chosen.call_args_list) / len(point)


def test_boxes_tried_grow_with_the_logarithm() -> None:
    """100 times as many boxes, each as large against its neighbours: a few levels more."""
    rng = np.random.default_rng(0)
    cost = {}
    for count in (100, 1_000, 10_000):
        box = random_boxes(rng, count, 100.0 / np.sqrt(count))
        point = rng.uniform(0, 100, (500, 2))
        cost[count] = tried(BoxTree.pack(box, tiled(box[:, :2])), point)
    assert cost[10_000] < cost[100] * 2.5
    assert cost[10_000] - cost[1_000] < 2.0 * (cost[1_000] - cost[100]) + 8
    shuffled = BoxTree.pack(box, rng.permutation(len(box)))
    assert tried(shuffled, point) > 20 * cost[10_000]
