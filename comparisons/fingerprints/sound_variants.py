"""Sound filters beside the reference EKF, each run no longer than the estimate may be like it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from comparisons.checks.grade import LIKE_SIGMA, Likeness
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.companion import Companion, EstimateLeftError
from comparisons.pipeline.references import VARIANTS, SoundFilters
from ekf_reference.core.ekf import Ekf

_FAR = 2.0
"""Times what `like` allows, in the EKF's sigma, which is not the variant's own."""


def variants_near(
    given: ExternalEstimate, ekf: Likeness, filters: SoundFilters
) -> Iterator[Reference]:
    """Yield the sound filters that an estimate may be like, by its poses.

    given: its poses at the reference's times, and no others. ekf: it beside the reference EKF.
    """
    poses = replace(given, pose_covariance=None)
    rounding = max(part.rounding[0] for part in ekf.parts)
    for name in VARIANTS:
        beside = Companion(poses, ekf, 0.0, _FAR * (LIKE_SIGMA + rounding))
        try:
            reference = filters.named(name, given.time_s, partial(_observed, beside))
        except EstimateLeftError:
            continue
        if reference is not None:
            yield reference


def _observed(beside: Companion, ekf: Ekf) -> Companion:
    """The observer of a filter that starts."""
    return beside
