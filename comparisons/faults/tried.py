"""All faults that a filter without a trace is searched for, by how simple they are."""

from __future__ import annotations

from functools import cached_property

from comparisons.faults.catalogue import catalogue, families
from comparisons.faults.fault import Family, Fault
from comparisons.faults.planted_algebra import (
    algebra_families,
    algebra_faults,
    joined_algebra_faults,
)
from comparisons.faults.planting import ComposedFaults, composed_faults
from comparisons.faults.streams import stream_families, stream_faults
from comparisons.faults.timing import timing_families, timing_faults
from comparisons.logs.log import Log


class TriedFaults:
    """Of a log: its data, events' times, what composes of nothing, models, algebra."""

    def __init__(self, log: Log) -> None:
        """log: that the filter was given."""
        self._log = log

    @cached_property
    def _composed(self) -> ComposedFaults:
        return composed_faults(self._log)

    @cached_property
    def single(self) -> list[Fault]:
        """One change, without a number."""
        return [
            *stream_faults(self._log),
            *timing_faults(self._log),
            *catalogue(self._log),
            *self._composed.single,
            *algebra_faults(),
        ]

    @cached_property
    def numbered(self) -> list[Family]:
        """One change, with a number."""
        return [
            *stream_families(self._log),
            *timing_families(),
            *families(self._log),
            *self._composed.numbered,
            *algebra_families(),
        ]

    @cached_property
    def joined(self) -> list[Fault]:
        """Two changes at once, without a number."""
        return [*joined_algebra_faults(), *self._composed.joined]

    def named(self, words: str) -> Fault:
        """Return the first fault without a number whose words begin so. Raises KeyError."""
        for fault in (*self.single, *self.joined):
            if fault.what.startswith(words):
                return fault
        raise KeyError(words)

    def family(self, words: str) -> Family:
        """Return the first with a number whose words begin so. Raises KeyError."""
        for family in self.numbered:
            if family.what.startswith(words):
                return family
        raise KeyError(words)
