"""Whether a filter solves its own linear equations: E against F1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.checks.agreement import AlgebraFigures, Gap
from comparisons.checks.check import EVENTS, Check
from comparisons.checks.finding import OfFilter
from comparisons.rounding import EXACT, ROUNDING, Allowed
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

HINT = (
    "check prediction, update and landmark initialisation for a covariance block that is dropped, "
    "outdated or not transposed"
)
SPARED_SIGMA = 0.05
"""Largest difference of the means that sparing part of the covariance may cause, in sigma."""
_NAMED = 3
"""So many events of the filter's algebra are named."""


class CheckAlgebra(Check):
    """Does the filter solve its own linear equations?"""

    name = "algebra"
    needs = EVENTS
    errs = "not at all but by rounding, for which it allows"
    figures = (("agreement", AlgebraFigures),)

    def find(self, known: Known) -> OfFilter[Gap]:
        """Return E against F1; a filter that is conservative by design may be larger."""
        records, conservative = known.records, known.prepared.ekf.conservative
        gap, allowed = known.gaps.agreement.algebra, records.algebra
        causes = []
        if not (_conservative(gap, allowed) if conservative else gap.explained_by(allowed)):
            hint = records.single or records.unnamed or HINT
            causes.append(algebra_cause(gap, records.operations(), allowed, hint))
        remarks = [] if records.untold or not records.precision else [records.precision]
        if conservative and not gap.within(ROUNDING):
            under = gap.sigma < ROUNDING
            mean = f"less than {ROUNDING:.2g}" if under else f"{gap.sigma:.2g}"
            remarks.append(
                "the filter is conservative by design: its covariance exceeds the exact one by up "
                f"to {gap.covariance:.2g} (relative), its mean differs by {mean} sigma"
            )
        return OfFilter(gap, causes, remarks)


def _conservative(gap: Gap, allowed: Allowed) -> bool:
    least, skew = 1.0 - allowed.covariance, allowed.covariance
    return gap.least >= least and gap.asymmetry <= skew and gap.sigma <= SPARED_SIGMA


def algebra_cause(
    gap: Gap, operations: Sequence[str], allowed: Allowed = EXACT, hint: str = HINT
) -> Cause:
    """E against F1. operations: what is wrong with which, the first first.

    hint: what to check where no event is named.
    """
    named = "".join(f"; {operation}" for operation in operations[:_NAMED])
    first = operations[0].partition(": ")[0] if operations else ""
    return Cause(
        "algebra",
        f"the filter differs from the solution of its own linear equations {gap.beside(allowed)}"
        + named,
        f"check {first}" if first else hint,
    )
