"""Whether the filter used the log as it is, and to its end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.checks.check import EVENTS, Check
from comparisons.checks.diagnosis.data_usage import DataFault, data_faults
from comparisons.checks.finding import OfFilter
from comparisons.checks.verdict import faulty
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class DataFinding(OfFilter[tuple[DataFault, ...]]):
    """What the filter did to the data."""


class CheckData(Check):
    """Does the filter use each measurement once, in time, and for the landmark of its label?"""

    name = "data"
    needs = EVENTS
    errs = "not measured; a gate is at fault at a probability of 1e-6"

    def find(self, known: Known) -> DataFinding:
        """Return what it did to the data; the gaps that follow are a consequence."""
        prepared, untimely = known.prepared, known.records.untimely()
        log, labelled, smoothed = prepared.log, prepared.labelled, known.gaps.smoothed
        found = data_faults(log, known.ekf, smoothed, labelled=labelled, timed=not untimely)
        faults = (*untimely, *found)
        causes = [Cause("data", fault.evidence, fault.hint) for fault in faults]
        return DataFinding(faults, causes, known.records.left_out())


class CheckBreakdown(Check):
    """Did the filter reach the end of the log?"""

    name = "breakdown"
    needs = EVENTS
    errs = "not at all"

    def find(self, known: Known) -> OfFilter[str | None]:
        """Return what stopped it, which is a cause where no other explains it."""
        breakdown = known.ekf.breakdown
        if not breakdown or faulty(known):
            return OfFilter(breakdown)
        hint = (
            "check the measurements and their sigmas at that time; the gaps are computed up to it"
        )
        return OfFilter(breakdown, [Cause("breakdown", breakdown, hint)])
