import math

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds, probability

MODEL = InverseSensorModel(p_occupied=0.9, p_free=0.3)
HALF = math.sqrt(2.0 * math.log(2.0))
"""Sigmas off the return at which lambda_r is one half, lambda zero."""


def at(sigmas: float, off: float = 0.0, model: InverseSensorModel = MODEL) -> float:
    """The model so many sigmas before the return and off the beam."""
    return float(model.probability(np.array([sigmas * 0.1]), np.array([off * 0.02]), 0.1, 0.02)[0])


def printed_without_squares(ahead_m: float, sigma_m: float) -> float:
    """The exponent of 4.2 as printed: over sigma, not its square."""
    level = 1.0 - 2.0 * math.exp(-0.5 * ahead_m**2 / sigma_m)
    return 0.1 + 0.4 * (1.0 - level) if level <= 0.0 else 0.5 - 0.2 * level


def test_equation_4_4_by_hand() -> None:
    assert at(0.0) == pytest.approx(0.9)  # lambda = -1: 0.1 + 0.4 * 2
    assert at(HALF) == pytest.approx(0.5)  # lambda = 0
    assert at(HALF + 1e-9) == pytest.approx(0.5)  # continuous
    assert at(20.0) == pytest.approx(0.3)  # lambda = 1
    assert at(1.0) == pytest.approx(0.1 + 0.8 * math.exp(-0.5))
    assert at(2.0) == pytest.approx(0.5 - 0.2 * (1.0 - 2.0 * math.exp(-2.0)))


def test_behind_r_u_is_unknown() -> None:
    """The return itself reaches as far behind as before."""
    assert at(-1.0) == pytest.approx(at(1.0))
    assert at(-HALF) == pytest.approx(0.5)
    for sigmas in (-HALF - 1e-6, -2.0, -50.0):
        assert at(sigmas) == 0.5


def test_range_and_bearing() -> None:
    model = InverseSensorModel(with_bearing=True)
    assert at(1.0, 5.0) == at(1.0)
    assert at(0.6, 0.8, model) == pytest.approx(at(1.0))
    assert at(0.0, 3.0, model) == 0.5  # beside the return, not before it
    assert at(1.0, 3.0, model) < 0.5


def test_printed_sigma_for_its_square_fails() -> None:
    """Erratum of 4.1 and 4.2: scaling lengths and sigmas alike must change nothing."""
    for scale in (0.1, 1.0, 7.0):
        ahead = np.array([scale * 0.15])
        found = MODEL.probability(ahead, np.zeros(1), scale * 0.1, 1.0)
        assert found[0] == pytest.approx(at(1.5))
    assert abs(printed_without_squares(0.15, 0.1) - at(1.5)) > 0.2
    assert abs(printed_without_squares(0.15, 0.1) - printed_without_squares(1.5, 1.0)) > 0.1


@pytest.mark.parametrize(("free", "occupied"), [(0.5, 0.9), (0.3, 0.5), (0.0, 0.9), (0.3, 1.0)])
def test_probabilities_on_the_wrong_side_are_refused(free: float, occupied: float) -> None:
    with pytest.raises(ValueError, match="either side of one half"):
        InverseSensorModel(occupied, free)


def bayes(prior: float, said: Array) -> float:
    """N 4.6, with P(r | occupied) proportional to what the model says, prior one half."""
    occupied, free = prior * np.prod(said), (1.0 - prior) * np.prod(1.0 - said)
    return float(occupied / (occupied + free))


def test_adding_log_odds_is_bayes_and_the_printed_4_7_is_not() -> None:
    said = np.random.default_rng(0).uniform(0.2, 0.9, 6)
    total = log_odds(said).sum()
    assert probability(total) == pytest.approx(bayes(0.5, said))
    assert np.allclose(probability(log_odds(said)), said)
    printed = float(log_odds(0.6))
    for _ in said:  # the map's own term stands where the scan's belongs
        printed += printed
    assert abs(float(probability(np.array(printed))) - bayes(0.6, said)) > 0.1
