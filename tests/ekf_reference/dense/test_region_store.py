import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.region_store import RegionStore, Rows


def filled(rng: np.random.Generator, batches: int = 20) -> tuple[RegionStore, dict[int, Array]]:
    """A store, and what it must hold."""
    store = RegionStore(2)
    expected: dict[int, Array] = {}
    for _ in range(batches):
        region = rng.choice(np.array([0, 3, 4, 9]), size=rng.integers(0, 30))
        value = rng.standard_normal((len(region), 2))
        store.append(region, value)
        for number in np.unique(region).tolist():
            before = expected.get(number, np.empty((0, 2)))
            expected[number] = np.vstack((before, value[region == number]))
    return store, expected


def test_rows_come_back_by_region_in_the_order_they_came() -> None:
    store, expected = filled(np.random.default_rng(0))
    assert np.unique(store.gather().region).tolist() == sorted(expected)
    assert len(store) == sum(len(rows) for rows in expected.values())
    asked = np.array([9, 5, 0])
    rows = store.gather(asked)
    assert np.array_equal(rows.value, np.vstack((expected[9], expected[0])))
    assert rows.region.tolist() == [9] * len(expected[9]) + [0] * len(expected[0])
    assert store.gather(np.array([7])).value.shape == (0, 2)


def test_written_back_rows_replace_theirs_alone() -> None:
    store, expected = filled(np.random.default_rng(1))
    rows = store.gather(np.array([4, 0]))
    rows.value[:] *= 2.0
    assert np.array_equal(store.gather(np.array([4])).value, expected[4])  # a copy until put
    store.put(rows)
    for number, factor in ((0, 2.0), (3, 1.0), (4, 2.0), (9, 1.0)):
        assert np.array_equal(store.gather(np.array([number])).value, factor * expected[number])
    store.put(Rows(np.empty(0, dtype=np.intp), np.empty((0, 2))))


def test_dropped_rows_leave_the_others_in_order() -> None:
    """Also with regions out of order, and all rows of a region dropped."""
    rng = np.random.default_rng(2)
    store, expected = filled(rng)
    rows = store.gather(np.array([9, 0, 4]))
    kept = rng.random(len(rows.region)) < 0.5
    kept[rows.region == 0] = False
    store.keep(rows, kept)
    for number in (9, 4):
        left = expected[number][kept[rows.region == number]]
        assert np.array_equal(store.gather(np.array([number])).value, left)
    assert len(store.gather(np.array([0])).value) == 0
    assert np.array_equal(store.gather(np.array([3])).value, expected[3])
    store.append(np.array([0]), np.ones((1, 2)))
    assert np.array_equal(store.gather(np.array([0])).value, np.ones((1, 2)))
