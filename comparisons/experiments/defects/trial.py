"""Runs with planted defects, and whether the report names them."""

from __future__ import annotations

from comparisons.adapters.defects.defect import Defect
from comparisons.checks.verdict import Verdict
from comparisons.config import RunConfig
from comparisons.experiments.defects.logs import open_case
from comparisons.pipeline.compare import REQUIRED, Comparison, Modified, compare_prepared
from comparisons.pipeline.prepare import prepare


def run_defect(defect: Defect, seed: int = 4) -> Comparison:
    """A filter with the defect, on a log that shows it."""
    log, ekf = open_case(defect.log, seed)
    planted = [Modified(defect.plant)]
    return compare_prepared(prepare(log, RunConfig(ekf=ekf), required=REQUIRED, also=planted))


def named_first(defect: Defect, verdict: Verdict) -> bool:
    """Whether the report's first cause is the defect: the right gap, and all of its words."""
    if not verdict.causes:
        return False
    first = verdict.causes[0]
    gap, *words = defect.expected_cause
    text = f"{first.evidence}; {first.hint}"
    return first.gap == gap and all(word in text for word in words)
