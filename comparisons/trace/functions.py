"""Which of a filter's functions are evaluated as they are recorded, and what becomes of failures.

In: functions, points and blocks, from a `Recorder`. Out: values and derivatives at a sample of the
events, those of each slot (F, G_x, or H of a sensor) by themselves. A function that fails does not
end the recording: a warning names the event, and its derivative is not recorded.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from comparisons.arrays import Array
from comparisons.trace.charts import QUATERNIONS, BlockChart, JointChart, chart_of
from comparisons.trace.derivatives import Evaluated, Steps, evaluate

FIRST = 100
"""Events of a slot that are all evaluated, before a share of them is."""
THOROUGH = 10
"""Of so many evaluations of a slot one compares two steps; the others take over the smaller one."""

Function = Callable[[Array], Any]


class NotEvaluatedWarning(UserWarning):
    """A function of a filter could not be evaluated where the filter was."""


class FunctionOutcome(NamedTuple):
    """What a function leads to: slot, as `H of gps`, and a chart; None of a measurement."""

    slot: str
    chart: JointChart | None


class FunctionSampler:
    """Evaluates functions of a filter at a sample of its events."""

    def __init__(self, share: float, quaternions: str | None) -> None:
        """share: of the events beyond the first of each slot. quaternions: one of QUATERNIONS."""
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"derivatives is {share:g}, expected a share of 0 to 1")
        if quaternions is not None and quaternions not in QUATERNIONS:
            raise ValueError(f"quaternions is {quaternions!r}, expected one of {QUATERNIONS}")
        self._every = 0 if share == 0.0 else max(1, round(1.0 / share))
        self._quaternions = quaternions
        self._charts: dict[str, BlockChart] = {}
        self._sigma: dict[str, Array] = {}
        self._events: Counter[tuple[str, tuple[int, ...]]] = Counter()
        self._steps: dict[tuple[str, int], tuple[Steps, int]] = {}
        self._warned: set[str] = set()

    def begin(self, dims: Mapping[str, int], covariance: Array) -> None:
        """Note about how large the errors of the first blocks are. covariance: (n, n)."""
        sigma = np.sqrt(np.maximum(np.nan_to_num(covariance.diagonal()), 0.0))
        ends = np.cumsum(list(dims.values()))[:-1]
        self._sigma = dict(zip(dims, np.split(sigma, ends), strict=True))

    def define(self, block: str, chart: BlockChart) -> None:
        """Take a chart of the filter's own for a block."""
        self._charts[block] = chart

    def joint(self, names: Sequence[str], dims: Sequence[int], charts: Sequence[str]) -> JointChart:
        """Return the chart of some blocks. Raises ValueError where a block has no such chart."""
        parts = [
            self._charts[name] if name in self._charts else chart_of(chart, dim, self._quaternions)
            for name, dim, chart in zip(names, dims, charts, strict=True)
        ]
        return JointChart(parts, dims)

    def is_due(self, slot: str, dims: Sequence[int]) -> bool:
        """Count an event of a slot, and return whether it is evaluated."""
        key = slot, tuple(dims)
        self._events[key] += 1
        beyond = self._events[key] - FIRST
        return self._every > 0 and (beyond <= 0 or beyond % self._every == 0)

    def evaluate(
        self,
        function: Function,
        point: ArrayLike,
        before: JointChart,
        outcome: FunctionOutcome,
        names: Sequence[str],
    ) -> Evaluated:
        """Evaluate a function. Raises ValueError where it gives no numbers, or not enough."""
        numbers = np.asarray(point, dtype=np.float64).ravel()
        if len(numbers) != before.numbers:
            raise ValueError(
                f"cannot be differentiated: point has {len(numbers)} numbers, its blocks' charts "
                f"{before.numbers}"
            )
        sigma = [self._sigma.get(name, np.zeros(0)) for name in names]
        size = np.concatenate(sigma)
        if len(size) != before.errors:
            size = np.zeros(before.errors)
        key = outcome.slot, before.errors
        known, count = self._steps.get(key, (None, 0))
        with np.errstate(all="ignore"):
            evaluated, steps = evaluate(
                function,
                numbers,
                (before, outcome.chart),
                size,
                known if count % THOROUGH else None,
            )
        self._steps[key] = steps, count + 1
        return evaluated

    def warn(self, slot: str, where: str, fault: BaseException) -> None:
        """Warn once of a slot's function."""
        if slot not in self._warned:
            self._warned.add(slot)
            what = str(fault)
            if not isinstance(fault, ValueError):
                what = f"raised {type(fault).__name__}" + (f" ({what})" if what else "")
            text = f"{where}: the function for {slot} {what}; its derivative is not recorded"
            warnings.warn(text, NotEvaluatedWarning, stacklevel=5)
