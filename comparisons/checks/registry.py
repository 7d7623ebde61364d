"""The checks, in the order in which they are asked: one may read what another has found."""

from __future__ import annotations

from comparisons.checks.accuracy import CheckAccuracy
from comparisons.checks.algebra import CheckAlgebra
from comparisons.checks.association import CheckAssociation
from comparisons.checks.check import About, Check
from comparisons.checks.compression import CheckCompression
from comparisons.checks.consistency.finding import CheckConsistency
from comparisons.checks.data import CheckBreakdown, CheckData
from comparisons.checks.explaining import CheckDropouts, CheckMisfit
from comparisons.checks.filter import AboutFilter
from comparisons.checks.gained import CheckGain
from comparisons.checks.gaps import AboutGaps
from comparisons.checks.linearisation import CheckLinearisation
from comparisons.checks.log import AboutLog
from comparisons.checks.model import CheckModel
from comparisons.checks.optimum import CheckOptimum
from comparisons.checks.position_gate import CheckPositions
from comparisons.checks.qualifiers import CheckTruthGap
from comparisons.checks.settings import AboutSettings
from comparisons.checks.smoother import AboutSmoother
from comparisons.checks.solution import AboutMap, AboutPoseGraph
from comparisons.checks.spurious import CheckSpurious
from comparisons.checks.stated_noise import CheckStatedNoise
from comparisons.checks.unused_positions import CheckUnusedPositions

BASIS: tuple[About, ...] = (AboutLog(), AboutSettings())
"""What every job has; each adds its estimates, and asks CHECKS of them."""
OF_RUN: tuple[About, ...] = (AboutFilter(), AboutSmoother(), AboutGaps())
"""What a run has besides."""
OF_SOLUTION: tuple[About, ...] = (AboutMap(), AboutPoseGraph(), AboutSmoother())
"""What a smoother alone has besides."""
OF_FILTER: tuple[Check, ...] = (
    CheckOptimum(),
    CheckData(),
    CheckAlgebra(),
    CheckModel(),
    CheckBreakdown(),
    CheckLinearisation(),
)
"""Of a filter whose events are known: these decide its verdict."""
CHECKS: tuple[Check, ...] = (
    CheckSpurious(),
    CheckConsistency(),
    CheckStatedNoise(),
    CheckAccuracy(),
    CheckAssociation(),
    CheckCompression(),
    CheckGain(),
    CheckPositions(),
    CheckTruthGap(),
    CheckUnusedPositions(),
    *OF_FILTER,
)
"""Of every job."""
EXPLAINING: tuple[Check, ...] = (CheckMisfit(), CheckDropouts())
"""Of a run, after all others."""
