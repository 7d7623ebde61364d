"""What a run can tell of each sensor's stated noise: the noise that its residuals have.

The smoother's residuals are divided among the sensors (graphslam.variance_components). Where they
leave a sensor's sigma open, a wrong one would not show in this run, in no figure of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from comparisons.checks.check import Check
from comparisons.checks.diagnosis.other_noise import NAMES, other_noises
from comparisons.checks.finding import Absent, Of
from comparisons.figures import Figure, Key, LeftOut, Nominal, finite
from comparisons.statistics import WORDS
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known
    from graphslam.smoother import SmootherEvidence
    from graphslam.variance_components import Component

_TESTABLE = 1.5
"""Least upper end over lower end of an interval that leaves a sigma open: a sigma that is wrong by
20 % is seen as wrong about as often as not."""
_WORTH = 1.2
"""Times the stated sigma, or its inverse, from which a note is due."""


@dataclass(frozen=True, kw_only=True)
class StatedNoise:
    """A sensor's noise over its stated one.

    Attributes:
        sensor: odometry, range, bearing, positions, pose landmarks or closures.
        factor: standard deviation that the residuals have, over the stated one.
        low: lower end of its 95 % interval.
        high: upper end of it; absent where there is none.
        testable: whether the run tells this sigma to 20 %.
        settled: whether the factors of all sensors were found; else this one is on its way.
    """

    sensor: Key[str]
    factor: Nominal[Figure]
    low: LeftOut[Figure]
    high: LeftOut[Figure]
    testable: bool
    settled: bool

    @property
    def said(self) -> str:
        """The factor, and what is known of it."""
        if not self.settled:
            return f"about {self.factor:.1g}, not converged"
        if finite(self.high) is None:
            return "not testable here"
        interval = f"{_digits(self.low)} to {_digits(self.high)}"
        if not self.testable:
            return f"not testable here ({interval})"
        return f"{_digits(self.factor)} ({interval})"


class StatedNoiseFinding(Of[tuple[StatedNoise, ...]]):
    """The noise of every sensor."""

    def __init__(self, components: Sequence[Component], remarks: Sequence[str] = ()) -> None:
        """components: of the smoother's residuals."""
        value = tuple(_noise(component) for component in components)
        super().__init__(value, remarks=remarks, entries={"stated_noise": value})

    def rows(self) -> Sequence[Row]:
        """Return a row for every sensor."""
        group = "Noise by residuals over the stated sigma (95 % interval)"
        return [Row(group, noise.sensor, noise.said) for noise in self.value]


class CheckStatedNoise(Check):
    """Which stated sigmas can this run tell, and do its residuals have them?"""

    name = "stated_noise"
    needs = "the batch smoother, without a robust kernel"
    errs = "a note on 1 of 1,000 sound runs"
    figures = (("stated_noise", StatedNoise),)

    def find(self, known: Known) -> StatedNoiseFinding | Absent:
        """Return the factor of each sensor's sigma, with its interval."""
        from graphslam.variance_components import variance_components

        result = known.result
        robust = result.options.robust != "none" or result.reweighted
        if robust or result.lagged is not None:
            return Absent("the smoother does not weight every measurement by its sigma")
        components = variance_components(result)
        return StatedNoiseFinding(components, _remarks(result, components))


def _digits(factor: float) -> str:
    return f"{factor:.2f}" if 0.1 < factor < 10.0 else f"{factor:.2g}"


def _noise(component: Component) -> StatedNoise:
    low, high = component.interval()
    return StatedNoise(
        sensor=NAMES.get(component.name, component.name),
        factor=component.factor,
        low=low,
        high=high,
        testable=high <= _TESTABLE * low,
        settled=component.settled,
    )


def _remarks(result: SmootherEvidence, components: Sequence[Component]) -> list[str]:
    """Of odometry alone: the innovations of all others have bands of their own.

    Only where its noise alone explains all residuals; else another fault may have raised it.
    """
    odometry = [
        component
        for component in components
        if component.name == "odometry" and not 1.0 / _WORTH < component.factor < _WORTH
    ]
    remarks = []
    for noise in other_noises(result, odometry):
        low, high = noise.component.interval(WORDS)
        remarks.append(
            f"the residuals fit with a noise of the odometry {noise.component.factor:.2g} times "
            f"the stated ({low:.2g} to {high:.2g} in 99.9 %)"
        )
    return remarks
