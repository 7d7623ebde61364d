"""Whether another noise of one sensor, and nothing else, explains an optimum's residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from comparisons.statistics import WORDS
from graphslam.goodness_of_fit import Goodness, rescaled
from graphslam.optimum import ChiSquareTest
from graphslam.smoother import SmootherEvidence
from graphslam.variance_components import Component

_MOST_RATIO = 1.5
"""Largest upper end over lower end of the interval of a noise that is named: what is known worse
takes up any misfit."""
NAMES = {"position": "positions", "pose landmark": "pose landmarks", "loop closure": "closures"}
"""Of components, where reports call them otherwise."""


class OtherNoise(NamedTuple):
    """A sensor's noise with which everything fits. test: of the whole with it."""

    component: Component
    test: ChiSquareTest

    @property
    def sensor(self) -> str:
        """What reports call it."""
        return NAMES.get(self.component.name, self.component.name)


def other_noises(result: SmootherEvidence, components: Sequence[Component]) -> list[OtherNoise]:
    """Return those sensors that explain the residuals alone, by a noise of another size.

    With it the whole lies in its band, that sensor's residuals have about one per degree of
    freedom, and all residuals are alike over time, landmarks and sensors.

    components: of the result's residuals. Those whose noise is the stated one, that were not found,
    or that the residuals leave open, explain nothing.
    """
    stated = Goodness(result.problem, result.graph, result.values)
    explaining = []
    for component in components:
        low, high = component.interval(WORDS)
        if not _is_certain(component) or low <= 1.0 <= high:
            continue
        try:
            goodness = rescaled(stated, component.name, component.factor)
        except RuntimeError:
            continue
        if goodness.sound:
            explaining.append(OtherNoise(component, goodness.test))
    return explaining


def _is_certain(component: Component) -> bool:
    """Whether its noise was found, and surely."""
    low, high = component.interval(WORDS)
    return component.settled and high <= _MOST_RATIO * low
