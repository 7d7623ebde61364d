"""Least squares over the events of a trace, and what is smoothed back from its end."""

from __future__ import annotations

from comparisons.arrays import Array
from comparisons.audit.consistency import Anchors, Smoothed
from comparisons.audit.replay import Fused
from comparisons.trace.events import (
    Augment,
    Clone,
    Event,
    Predict,
    Remove,
    Reset,
    TracePrior,
    Update,
)
from graphslam.arrays import Marginal
from graphslam.event_smoother import EventSmoother

LARGEST_ANCHORED = 500
"""Entries of a state whose smoothed marginals are kept on the way."""


class AnchoredSmoother:
    """All events so far as one linear problem, with filtered marginals kept on the way."""

    def __init__(self, prior: TracePrior) -> None:
        """Begin with the prior."""
        self._smoother = EventSmoother(prior.blocks, prior.dims, prior.covariance)
        self._anchors = Anchors()
        if len(prior.covariance) <= LARGEST_ANCHORED:
            self._anchors.begin(self._smoother.marginal())
            self._smoother.anchor()

    def take(self, event: Event, fused: Fused | None) -> None:
        """Do an event. fused: what the recursion made of an update."""
        match event:
            case Predict():
                self._smoother.predict(event.blocks, event.jacobian, event.noise)
            case Update() if fused is not None and event.used:
                self._smoother.measure(event.blocks, event.jacobian, event.noise, event.residual)
                self._smoother.correct(fused.applied)
            case Reset():
                self._smoother.predict(event.blocks, event.jacobian, None)
            case Augment():
                g = event.noise_jacobian
                noise = g @ event.noise @ g.T
                self._smoother.augment(event.name, event.blocks, event.jacobian, noise)
            case Clone():
                self._smoother.clone(event.source, event.name)
            case Remove():
                self._smoother.remove(event.blocks)

    def correct(self, correction: Array) -> None:
        """Take (n,) off the error of the estimate."""
        self._smoother.correct(correction)

    def marginal(self) -> Marginal:
        """Return mean and covariance of the error of the filter's estimate, by all events."""
        return self._smoother.marginal()

    def keep(self, number: int, marginal: Marginal) -> None:
        """Keep a marginal, to which is smoothed back in the end. number: the event's."""
        if len(marginal.mean) <= LARGEST_ANCHORED:
            self._anchors.add(number, marginal, self._smoother.anchor())

    def smoothed(self) -> Smoothed:
        """Return filtered minus smoothed at what was kept, and the first error."""
        return self._anchors.smoothed()
