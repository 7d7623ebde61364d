"""Contract of all charts: steps lead there and back, and the error is carried over."""

import numpy as np
import pytest

from ekf_reference.core.chart import ADDITIVE, Chart
from ekf_reference.core.geometry import Array
from ekf_reference.filters.misono import UnitCircle, from_heading
from tests.ekf_reference.filters.test_misono import CovarianceLeftBehind, DividedByLength
from tests.ekf_reference.numerics import central_difference


class Backwards(UnitCircle):
    """Broken: the step from the one to the other leads the other way."""

    def minus(self, pose: Array, other: Array) -> Array:
        return super().minus(other, pose)


def pose_of(chart: Chart, entries: Array) -> Array:
    return entries if chart is ADDITIVE else from_heading(entries)


def departures(chart: Chart, seed: int) -> tuple[float, float]:
    """Return how far off a pose is after the way there, and an error after its correction."""
    rng = np.random.default_rng(seed)
    pose, other = (pose_of(chart, one) for one in rng.uniform(-1.0, 1.0, (2, 3)))
    step = rng.uniform(-0.5, 0.5, len(pose))
    after = chart.plus(pose, step)
    ways = [chart.plus(pose, chart.minus(there, pose)) - there for there in (other, after)]
    carried = central_difference(lambda e: chart.minus(chart.plus(pose, step + e), after), 0 * step)
    reset = chart.reset(pose, step)
    error = carried - (np.eye(len(pose)) if reset is None else reset)
    return float(np.abs(ways).max()), float(np.abs(error).max())


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("chart", [ADDITIVE, UnitCircle()])
def test_steps_lead_there_and_the_error_is_carried_over(chart: Chart, seed: int) -> None:
    way, error = departures(chart, seed)
    assert way < 1e-14
    assert error < 1e-9


@pytest.mark.parametrize("chart", [Backwards(), DividedByLength(), CovarianceLeftBehind()])
def test_broken_charts_are_rejected(chart: Chart) -> None:
    assert max(departures(chart, 0)) > 1e-3
