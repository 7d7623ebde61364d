"""The covariance recursion against dense matrices of the whole state."""

from typing import Any

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.replay import Replay, check_gain, noise_factor
from comparisons.covariances import largest_pair
from comparisons.trace.events import Augment, Clone, Predict, Remove, Reset, TracePrior, Update

RNG = np.random.default_rng(0)


def spread(n: int) -> Array:
    root = RNG.standard_normal((n, n))
    found: Array = root @ root.T + np.eye(n)
    return found


def start() -> Replay:
    return Replay(TracePrior(0, None, ("a", "b", "c"), (2, 1, 3), spread(6)))


def whole(blocks: tuple[str, ...], m: Array) -> Array:
    """A matrix on some blocks of a, b, c as one on all of them."""
    places = {"a": [0, 1], "b": [2], "c": [3, 4, 5]}
    columns = [i for name in blocks for i in places[name]]
    found = np.zeros((len(m), 6))
    found[:, columns] = m
    return found


def test_prediction_of_blocks_out_of_order() -> None:
    replay, blocks = start(), ("c", "a")
    f, q, p = RNG.standard_normal((5, 5)), spread(5), replay.covariance.copy()
    replay.apply(Predict(1, None, blocks, f, q))
    select = whole(blocks, np.eye(5))
    big = np.eye(6) + select.T @ (f - np.eye(5)) @ select
    np.testing.assert_allclose(
        replay.covariance, big @ p @ big.T + select.T @ q @ select, rtol=1e-12
    )


def test_update_and_its_innovation() -> None:
    replay, blocks = start(), ("b", "c")
    h, r, p = RNG.standard_normal((2, 4)), spread(2), replay.covariance.copy()
    residual = np.array([0.4, -0.3])
    fused = replay.update(Update(1, None, "s", blocks, residual, h, r, True, None, None))
    big = whole(blocks, h)
    s = big @ p @ big.T + r
    gain = p @ big.T @ np.linalg.inv(s)
    np.testing.assert_allclose(replay.covariance, p - gain @ s @ gain.T, atol=1e-12)
    np.testing.assert_allclose(fused.gain, gain, atol=1e-12)
    assert fused.whitened @ fused.whitened == pytest.approx(residual @ np.linalg.solve(s, residual))
    np.testing.assert_allclose(replay.mean, np.zeros(6), atol=1e-14)


def test_any_gain_has_josephs_covariance_and_a_lost_correction_shows() -> None:
    replay, h, r = start(), np.eye(2), spread(2)
    p, gain = replay.covariance.copy(), 0.2 * RNG.standard_normal((6, 2))
    residual, applied = np.array([1.0, 2.0]), np.zeros(6)
    replay.update(Update(1, None, "s", ("a",), residual, h, r, True, applied, gain))
    a = np.eye(6) - gain @ whole(("a",), h)
    np.testing.assert_allclose(replay.covariance, a @ p @ a.T + gain @ r @ gain.T, atol=1e-12)
    np.testing.assert_allclose(replay.mean, gain @ residual, atol=1e-12)


def test_an_error_that_is_known_is_no_part_of_the_next_innovation() -> None:
    """Two measurements tell of an error of 2 / 3; the first does not correct the estimate."""
    replay, one = Replay(TracePrior(0, None, ("a",), (1,), np.eye(1))), np.eye(1)
    for applied in (0.0, 1.0 / 3.0):
        residual, correction = np.ones(1), np.array([applied])
        fused = replay.update(
            Update(1, None, "s", ("a",), residual, one, one, True, correction, None)
        )
    assert fused.innovation == pytest.approx([0.5], rel=1e-12)
    assert replay.mean == pytest.approx([2.0 / 3.0 - 1.0 / 3.0], rel=1e-12)


@pytest.mark.parametrize(
    ("part", "factors", "said"),
    [
        ("gain", (0.5, 0.5, 1.0, *[1.0 + 1e-5] * 3), ""),  # beside half, 1e-5 is not named
        ("correction", (2.0, 2.0, *[1.0] * 4), "twice"),
        ("correction", (2.0, 3.0, *[1.0] * 4), "is not gain x residual"),
    ],
)
def test_the_block_is_named_of_which_gain_or_correction_is_wrong(
    part: str, factors: tuple[float, ...], said: str
) -> None:
    replay, h, r, times = start(), np.eye(2), spread(2), np.array(factors)
    event = Update(1, None, "s", ("a",), np.array([1.0, -2.0]), h, r, True, None, None)
    right = replay.copy().update(event)
    of = {"gain": times[:, None] * right.gain, "correction": times * right.applied}
    given: dict[str, Any] = {part: of[part]}
    wrong = event._replace(**given)
    fused = replay.update(wrong)
    (found,) = check_gain(wrong, fused, np.sqrt(replay.covariance.diagonal()), replay.layout, 1e-6)
    assert found.blocks == ("a",)
    assert said in found.what


@pytest.mark.parametrize("factor", [0.25, 1.0, 3.0])
def test_the_noise_that_a_gain_is_of_is_found(factor: float) -> None:
    p, h, r = spread(4), RNG.standard_normal((2, 4)), spread(2)
    across, seen = p @ h.T, h @ p @ h.T
    gain = across @ np.linalg.inv(seen + factor * r)
    assert noise_factor(gain, across, seen, r) == pytest.approx(factor)
    assert noise_factor(across @ np.linalg.inv(seen - 0.1 * r), across, seen, r) is None
    assert noise_factor(across @ np.linalg.inv(seen + spread(2)), across, seen, r) is None


def test_the_largest_difference_of_two_blocks_may_stand_on_either_side() -> None:
    scaled = np.zeros((4, 4))
    scaled[0, 1], scaled[3, 0] = 1.0, 2.0
    for one in (scaled, scaled.T):
        assert largest_pair(one, ("a", "b", "c"), (2, 1, 1)) == ("a", "c")


def test_a_rejected_measurement_changes_nothing() -> None:
    replay = start()
    p = replay.covariance.copy()
    event = Update(1, None, "s", ("a",), np.ones(2), np.eye(2), np.eye(2), False, None, None)
    fused = replay.update(event)
    np.testing.assert_array_equal(replay.covariance, p)
    assert np.isfinite(fused.whitened).all()
    np.testing.assert_array_equal(fused.applied, np.zeros(6))


def test_an_innovation_without_a_covariance_is_none() -> None:
    replay = start()
    replay.covariance[:2, :2] = -10.0 * np.eye(2)
    event = Update(1, None, "s", ("a",), np.ones(2), np.eye(2), np.eye(2), True, None, None)
    assert np.isnan(replay.update(event).whitened).all()


def test_new_blocks_copies_removals_and_resets() -> None:
    replay = start()
    p = replay.covariance.copy()
    g, by_noise, r = RNG.standard_normal((2, 3)), RNG.standard_normal((2, 1)), spread(1)
    replay.apply(Augment(1, None, "new", ("b", "a"), g, by_noise, r))
    replay.apply(Clone(2, None, "copy", "b"))
    j = np.array([[2.0]])
    replay.apply(Reset(3, None, ("b",), j))
    big = np.vstack((np.eye(6), whole(("b", "a"), g), np.eye(6)[2:3]))
    right = big @ p @ big.T
    right[6:8, 6:8] += by_noise @ r @ by_noise.T
    turn = np.diag([1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    right = turn @ right @ turn.T
    np.testing.assert_allclose(replay.covariance, right, rtol=1e-12)
    replay.apply(Remove(4, None, ("a", "new")))
    kept = [2, 3, 4, 5, 8]
    np.testing.assert_allclose(replay.covariance, right[np.ix_(kept, kept)], rtol=1e-12)
    assert list(replay.layout.dims) == ["b", "c", "copy"]


def test_a_copy_goes_its_own_way() -> None:
    replay = start()
    p = replay.covariance.copy()
    other = replay.copy()
    other.apply(Predict(1, None, ("a",), 2.0 * np.eye(2), np.eye(2)))
    other.apply(Clone(2, None, "copy", "b"))
    np.testing.assert_array_equal(replay.covariance, p)
    assert list(replay.layout.dims) == ["a", "b", "c"]
