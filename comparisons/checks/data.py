"""Whether the filter used the log as it is, and to its end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.checks.check import Check
from comparisons.checks.diagnosis.data_usage import DataFault, data_faults
from comparisons.checks.finding import Finding, OfFilter
from comparisons.checks.verdict import faulty
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class DataFinding(OfFilter[tuple[DataFault, ...]]):
    """What the filter did to the data."""

    def __init__(self, faults: Sequence[DataFault], remarks: Sequence[str]) -> None:
        """remarks: on what it left out."""
        self.value = tuple(faults)
        self.causes = [Cause("data", one.evidence, one.hint) for one in faults]
        self.remarks = remarks


class CheckData(Check):
    """Does the filter use each measurement once, in time, and for the landmark of its label?"""

    name = "data"
    needs = "a filter with the events that it went through"
    errs = "not measured; a gate is at fault at a probability of 1e-6"

    def find(self, known: Known) -> DataFinding:
        """Return what it did to the data; the gaps that follow are a consequence."""
        records, prepared = known.records, known.prepared
        untimely = records.untimely()
        found = data_faults(
            prepared.log,
            known.ekf,
            known.gaps.smoothed,
            labelled=prepared.labelled,
            timed=not untimely,
        )
        return DataFinding((*untimely, *found), records.left_out())


class BreakdownFinding(OfFilter[str]):
    """What stopped the filter."""

    def __init__(self, breakdown: str, *, explained: bool) -> None:
        """explained: another cause says why."""
        self.value = breakdown
        if explained:
            self.remarks = [f"{breakdown}; all comparisons end at that time"]
        else:
            hint = (
                "check the measurements and their sigmas at that time; the gaps are computed up "
                "to it"
            )
            self.causes = [Cause("breakdown", breakdown, hint)]


class CheckBreakdown(Check):
    """Did the filter reach the end of the log?"""

    name = "breakdown"
    needs = "a filter with the events that it went through"
    errs = "not at all"

    def find(self, known: Known) -> Finding:
        """Return what stopped it, and nothing where it reached the end."""
        breakdown = known.ekf.breakdown
        return BreakdownFinding(breakdown, explained=faulty(known)) if breakdown else Finding()
