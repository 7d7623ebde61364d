"""All planted defects."""

from __future__ import annotations

from comparisons.checks.verdict import Verdict
from comparisons.experiments.defects import algebra, data, models, noise
from comparisons.experiments.defects.defect import Defect
from comparisons.experiments.defects.logs import open_case
from comparisons.pipeline.compare import Comparison, compare_estimators

CATALOGUE: tuple[Defect, ...] = (
    *algebra.DEFECTS,
    *models.DEFECTS,
    *noise.DEFECTS,
    *data.DEFECTS,
)


def run_defect(defect: Defect, seed: int = 4) -> Comparison:
    """A filter with the defect, on a log that shows it."""
    log, choices = open_case(defect.log, seed)
    return compare_estimators(log, choices, modify=defect.plant)


def named_first(defect: Defect, verdict: Verdict) -> bool:
    """Whether the report's first cause is the defect: the right gap, and all of its words."""
    if not verdict.causes:
        return False
    first = verdict.causes[0]
    gap, *words = defect.expected_cause
    text = f"{first.evidence}; {first.hint}"
    return first.gap == gap and all(word in text for word in words)
