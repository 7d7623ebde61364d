"""The simulated world is what it says it is."""

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_reference.core.geometry import Array
from tests.ekf_reference.ray_casting import Solids, cast, sides
from tests.ekf_reference.worlds import Q, circuit, followed

SQUARE = Solids(sides(np.array(((-4.0, -4.0), (4.0, -4.0), (4.0, 4.0), (-4.0, 4.0)))))


def test_beams_meet_what_is_nearest() -> None:
    angle = np.linspace(-np.pi, np.pi, 721)
    way = cast(angle, np.zeros(3), SQUARE)
    assert np.allclose(np.maximum(np.abs(way * np.cos(angle)), np.abs(way * np.sin(angle))), 4.0)
    disc = Solids(SQUARE.segment, np.array(((2.0, 0.0, 1.0),)))
    pose = np.array((0.0, 1.0, -0.5 * np.pi))
    ahead = np.arctan2(2.0, 1.0) + np.array((-0.01, 0.0, 0.01, 1.0))
    assert np.isclose(cast(ahead, pose, disc)[1], np.sqrt(5.0) - 0.5)
    assert (cast(ahead, pose, disc)[:3] < cast(ahead, pose, SQUARE)[:3]).all()
    assert cast(ahead, pose, disc)[3] == cast(ahead, pose, SQUARE)[3]
    assert np.isinf(cast(ahead, np.array((9.0, 0.0, 0.0)), Solids())).all()


def normalised_errors(scale: float) -> Array:
    """(20,) squared errors over a filter's covariance times scale, one for each drive of 20 s."""
    found = []
    for seed in range(20):
        drive = circuit(seed, duration_s=20.0)
        state = followed(drive).state
        places = drive.met.ravel()
        error = state.mean - np.concatenate((drive.pose[drive.scan[-1].step], places))
        found.append(error @ np.linalg.solve(scale * state.covariance, error) / len(error))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "honest"), [(1.0, True), (0.8, False), (1.25, False)])
def test_a_filter_that_knows_the_noise_is_as_wrong_as_it_says(scale: float, honest: bool) -> None:
    """Two-sided chi-square, 1 in 1000 to fail by chance."""
    size = 3 + 2 * len(circuit(0, duration_s=20.0).met)
    low, high = chi2.ppf((0.0005, 0.9995), 20 * size) / (20 * size)
    assert bool(low < normalised_errors(scale).mean() < high) is honest


def test_the_same_seed_gives_the_same_drive() -> None:
    one, same, other = (circuit(seed, duration_s=2.0) for seed in (1, 1, 2))
    assert np.array_equal(one.control, same.control)
    assert not np.array_equal(one.control, other.control)
    spread = np.var(circuit(0).control, axis=0)
    assert np.allclose(spread, np.diag(Q), rtol=0.2)
