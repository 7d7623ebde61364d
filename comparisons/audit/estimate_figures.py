"""What errors of the estimate say of a filter: by the truth, and by all measurements together.

The same figures are asked again with a cause of the innovations taken in: those that then lie in
their bands are consequences of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np

from comparisons.audit.consistency import (
    BlockErrors,
    ConsistencyDeparture,
    Smoothed,
    first_error,
)
from comparisons.audit.least_squares import AnchoredSmoother
from comparisons.audit.replay import BlockLayout, Replay
from comparisons.explain.recorded_steps import RecordedStep, apply_step
from comparisons.statistics import Averaged, rarity
from comparisons.trace.events import Predict, Snapshot, TracePrior

EstimateKind = Literal["smoother", "nees", "first error"]


class EstimateFigures(NamedTuple):
    """Errors of an estimate.

    Attributes:
        prior: Which the filter began with.
        smoothed: By all measurements.
        errors: By the truth.
        nees: NEES by them, of the state and of blocks.
        is_prior_known: The prior is a covariance.
        is_smoothed_told: Least squares tell the first error.
    """

    prior: TracePrior
    smoothed: Smoothed
    errors: BlockErrors
    nees: Mapping[str, Averaged]
    is_prior_known: bool = True
    is_smoothed_told: bool = True

    def departures(self, level: float) -> dict[EstimateKind, list[ConsistencyDeparture]]:
        """Return what departs, by kind. level: of each kind, of a sound filter."""
        by_truth = self.errors.departures(self.nees, level)
        first = self._first_error(level)
        return {
            "smoother": self._of_smoother(level),
            "nees": by_truth,
            "first error": [] if first is None else [first],
        }

    def _of_smoother(self, level: float) -> list[ConsistencyDeparture]:
        averaged = self.smoothed.averaged
        if averaged is None or averaged.p_value >= level:
            return []
        low, high = averaged.band
        text = f"filter minus smoother is {averaged.mean:.3g}, expected {low:.3g} to {high:.3g}"
        weight = rarity(averaged.mean, averaged.dof)
        return [ConsistencyDeparture(text, averaged.p_value, averaged.worst, weight=weight)]

    def _first_error(self, level: float) -> ConsistencyDeparture | None:
        """Judge the first error by P0: the recorded one, or else as least squares have it."""
        prior, before, first = self.prior, self.errors.before, self.smoothed.first
        layout, p = BlockLayout(prior.blocks, prior.dims), prior.covariance
        if before is not None and self.is_prior_known:
            return first_error(layout, p, before, np.zeros_like(p), level)
        if first is None or not self.is_smoothed_told:
            return None
        return first_error(layout, p, first.mean, first.covariance, level)


def figures_of_steps(steps: Iterable[RecordedStep], every: int) -> EstimateFigures:
    """Return the figures of a filter that does the events by Kalman's gain.

    Args:
        steps: Of a trace, with other noises and without constants.
        every: Of so many snapshots one is smoothed back to.
    """
    acted, snapshots = False, 0
    replay: Replay
    prior: TracePrior
    errors: BlockErrors
    for step in steps:
        event = step.event
        match event:
            case TracePrior():
                prior, replay = event, Replay(event)
                smoother, errors = AnchoredSmoother(event), BlockErrors(replay.layout)
            case Snapshot():
                snapshots += 1
                at = replay.layout.columns(event.blocks)
                if event.error is not None:
                    error = event.error - replay.mean[at]
                    covariance = replay.covariance[at][:, at]
                    within = event._replace(covariance=covariance)
                    errors.add(within, error, replay.layout, is_first=not acted)
                if snapshots % every == 0:
                    smoother.keep(event.number, smoother.marginal())
            case _:
                acted = True
                smoother.take(event, apply_step(replay, step))
                if isinstance(event, Predict) and step.applied is not None:
                    smoother.correct(step.applied)
    return EstimateFigures(prior, smoother.smoothed(), errors, errors.averages())
