"""What research/high_level.py concludes from paired drives."""

import numpy as np
import pytest

from research.high_level import judged
from tests.helpers import Array

SEEDS = 30
_DRAWN = np.random.default_rng(4).standard_normal((SEEDS, 6))
NOISE = (_DRAWN - _DRAWN.mean(axis=0)) / _DRAWN.std(axis=0, ddof=1)
"""Mean exactly 0, standard deviation exactly 1."""


def by_t(*t: float) -> Array:
    """(30, 6) changes with these values of Student's t in the first columns, 0 in the others."""
    changes: Array = NOISE + np.append(t, np.zeros(6 - len(t))) / np.sqrt(SEEDS)
    return changes


def test_a_gain_is_named_and_a_loss_is_none() -> None:
    assert judged(by_t(-4.0, -1.0, 0.0, -5.0))[-1] == (
        "gain significant at 5 %: heading, 2nd; position [m]"
    )
    assert judged(by_t(4.0, 5.0, 4.0, 5.0))[-1] == "no significant gain"
    assert judged(by_t())[-1] == "no significant gain"


def test_four_errors_are_four_chances() -> None:
    """T of 2.05 has a p of 0.05 with 29 degrees of freedom, of 2.66 a quarter of that."""
    assert judged(by_t(-2.6))[-1] == "no significant gain"  # broken: each tested alone
    assert judged(by_t(-2.7))[-1] == "gain significant at 5 %: position [m]"
    both = judged(by_t(-2.7, 0.0, -2.6))[-1]  # the second has to pass a third of it only
    assert both == "gain significant at 5 %: position [m]; position, 2nd"
    assert judged(by_t(0.0, 0.0, 0.0, 0.0, -9.0))[-1] == "no significant gain"  # NEES is no error


def test_the_figures_of_a_line() -> None:
    change = by_t(-2.045)
    mean, sigma, t, p, less, _, of, sign = judged(change)[1].removeprefix("position [m]").split()
    assert float(mean) == pytest.approx(-2.045 / np.sqrt(SEEDS), abs=1e-4)
    assert float(sigma) == pytest.approx(1.0 / np.sqrt(SEEDS), abs=1e-4)
    assert float(t) == pytest.approx(-2.045, abs=0.006)
    assert float(p) == pytest.approx(0.05, abs=1e-3)
    assert (int(less), int(of)) == ((change[:, 0] < 0.0).sum(), SEEDS)
    assert 0.0 < float(sign) <= 1.0
