"""The checks that every run is asked, in the order of its report."""

from __future__ import annotations

from comparisons.checks.accuracy import CheckAccuracy
from comparisons.checks.association import CheckAssociation
from comparisons.checks.check import Check
from comparisons.checks.consistency.finding import CheckConsistency
from comparisons.checks.position_gate import CheckPositions
from comparisons.checks.qualifiers import CheckTruthGap
from comparisons.checks.spurious import CheckSpurious
from comparisons.checks.stated_noise import CheckStatedNoise

CHECKS: tuple[Check, ...] = (
    CheckSpurious(),
    CheckConsistency(),
    CheckStatedNoise(),
    CheckAccuracy(),
    CheckAssociation(),
    CheckPositions(),
    CheckTruthGap(),
)
"""One that needs what another has found comes after it; those of extensions come last."""
