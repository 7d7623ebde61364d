"""Whether a filter's models are the smoother's: F1 against F2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.checks.agreement import Gap, ModelFigures
from comparisons.checks.check import EVENTS, Check
from comparisons.checks.data import DataFinding
from comparisons.checks.finding import OfFilter
from comparisons.rounding import EXACT, Allowed
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.model_differences import ModelDifference
    from comparisons.pipeline.known import Known

FITTED = "check for these model errors, which were fitted to the trace: "
"""Begins a hint that names known model errors; they follow, separated by semicolons."""
HINT = (
    "check the signs of the Jacobians, the wrapping of the innovation, the noise for a sigma that "
    "is squared twice, and the conventions of steering and bearing"
)


class CheckModel(Check):
    """Are the filter's models those of the log, where the filter was linearised?"""

    name = "model"
    needs = EVENTS
    errs = "not at all but by rounding, for which it allows"
    figures = (("agreement", ModelFigures),)

    def find(self, known: Known) -> OfFilter[Gap]:
        """Return F1 against F2."""
        records, gap = known.records, known.gaps.agreement.model
        untold, causes = gap.explained_by(records.model), []
        if not untold or (records.untold and not gap.within(records.MOST_HIDDEN)):
            differences, known_errors = records.differences, records.known_model_errors()
            # Else the data's use explains the gap, or rounding, which leaves each record right.
            misused = known.value(DataFinding)
            if differences or known_errors or not (untold or misused):
                causes.append(model_cause(gap, differences, known_errors, records.model))
        return OfFilter(gap, causes)


def model_cause(
    gap: Gap,
    differences: Sequence[ModelDifference],
    known_model_errors: Sequence[str],
    allowed: Allowed = EXACT,
) -> Cause:
    """F1 against F2. known_model_errors: mistakes that reproduce what was recorded.

    Of each kind of relation the largest difference is named, of its Jacobians and of the rest.
    """
    largest = {difference.group: difference for difference in reversed(differences)}
    named = "; ".join(
        str(difference) for difference in differences if largest[difference.group] is difference
    )
    hint = HINT
    if differences and differences[0].absent:
        hint = (
            f"complete {differences[0].quantity}: its columns are zero in the filter, but the "
            "measurement depends on these states"
        )
    if known_model_errors:
        hint = FITTED + "; ".join(known_model_errors)
    return Cause(
        "model",
        "the filter's models differ from the smoother's, linearised at the same points, "
        f"{gap.beside(allowed)}" + (f"; {named}" if named else ""),
        hint,
    )
