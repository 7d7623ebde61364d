"""How many steps the reference filters make, whoever runs them: what a check costs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest.mock import patch

from comparisons.adapters import reference_filter
from comparisons.adapters.filter_loop import (
    FilterAttachment,
    FilterEpoch,
    FilterObservers,
    run_filter_loop,
)
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array
from comparisons.logs.log import Log, Positions
from ekf_reference.core.ekf import Ekf


@dataclass
class FilterSteps(FilterObservers):
    """Counts. steps: predictions of all runs."""

    steps: int = 0

    def before_predict(self, ekf: Ekf, time_s: float, control: Array, duration_s: float) -> None:
        """Count one."""
        self.steps += 1


@contextmanager
def counted_steps() -> Iterator[FilterSteps]:
    """Count the predictions of all reference filters, of this process alone."""
    counter = FilterSteps()

    def counting(
        ekf: Ekf,
        log: Log,
        timeline: Timeline,
        positions: Positions | None,
        beside: FilterAttachment,
    ) -> Iterator[FilterEpoch]:
        watching = FilterObservers([counter, beside.watching])
        return run_filter_loop(ekf, log, timeline, positions, replace(beside, watching=watching))

    with patch.object(reference_filter, "run_filter_loop", counting):
        yield counter
