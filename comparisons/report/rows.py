"""Rows of figures that several jobs report: one figure a row, in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comparisons.figures import in_sigma
from comparisons.report.ladder import LadderStep
from comparisons.words import SPENT, Row

_STAGES = {
    "read": "reading the log",
    "ekf": "EKF",
    "frozen": "fixed-linearisation smoothers",
    "marginals": "marginal covariances",
}
"""Of the clock, where their names in a result are short."""


def seconds_rows(seconds: Mapping[str, float], cpu_s: Mapping[str, float] | None) -> list[Row]:
    """Return the time of each stage on the wall, which a busy machine stretches, and of the CPU."""
    return [
        Row(group, _STAGES.get(stage, stage), f"{s:.2f} s")
        for group, each in zip(SPENT, (seconds, cpu_s or {}), strict=True)
        for stage, s in each.items()
    ]


def gap_rows(steps: Sequence[LadderStep]) -> list[Row]:
    """Return the gaps of the chain of estimates; what exceeds its limit is marked.

    A gap that fails although its means are within the limit fails by covariance or error.
    """
    found = []
    for step in steps:
        group = f"{step.gap.capitalize()} gap: {step.above} to {step.below}"
        limit = "" if step.limit is None else f"<= {step.limit:.2g} sigma"
        within = step.sigma is not None and step.limit is not None and step.sigma <= step.limit
        inside = None if not step.judged else True if within else False if step.fails else None
        rest = False if step.fails and within else None
        mean = "not judged" if step.sigma is None and not step.judged else in_sigma(step.sigma)
        found.append(Row(group, "difference of the means (largest)", mean, limit, inside))
        if step.error_m is not None:
            found.append(Row(group, "distance", f"{step.error_m:.3g} m", "", rest))
        elif step.covariance is not None:
            far = f"{step.covariance:.2g}"
            found.append(Row(group, "relative difference of covariances", far, "", rest))
    return found
