"""Whether a compressed filter compresses: where a local area holds most of the map it does not."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.adapters.ekf_run import Compression
from comparisons.checks.check import Check
from comparisons.checks.finding import LackingError, Of

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


class CompressionFinding(Of[Compression | None]):
    """What a compressed filter has saved, None of others.

    Its figures stand in the result's part of the filter.
    """


class CheckCompression(Check):
    """Does the compressed filter leave landmarks passive, or is it the full filter here?"""

    name = "compression"
    needs = "a compressed filter"
    errs = "never: it counts"

    def find(self, known: Known) -> CompressionFinding:
        """Return what was saved, with a remark where that is nothing."""
        try:
            compression = known.ekf.compression
        except LackingError:  # of a filter that is not run here nothing is asked
            compression = None
        remarks = []
        if compression is not None and not compression.updates_with_passive:
            remarks.append(
                "the compressed filter is the full filter here: in none of its "
                f"{compression.updates:,} updates was a landmark passive, as a local area holds "
                "most of the map"
            )
        return CompressionFinding(compression, (), remarks)
