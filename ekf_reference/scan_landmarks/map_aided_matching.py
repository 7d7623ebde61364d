"""Template matching aided by the dense map around the landmark (Nieto 2005, section 6.2).

The map comes from the same filter and scans, so it is not independent of the prior and has no R.
It only selects which maximum of a template's correlation is the right one. z and R, from there,
are those of the template alone, against the whole prior, and so is the gate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.scan_landmarks.templates import (
    AMBIGUOUS,
    Observation,
    Template,
    TemplateMatching,
    observe,
)
from ekf_reference.scan_matching.alignment import align
from ekf_reference.scan_matching.sog import SumOfGaussians

_THIN_M = 0.3
"""Cells in which Gaussians are merged, since an alignment's cost grows with their number."""
_ONE_START_M = 1e4
"""Spacing of starts that leaves the middle of the prior alone."""


def enriched(template: Template, around: SumOfGaussians) -> SumOfGaussians:
    """Return a template's Gaussians and those around it, in its axis, each half of the weight.

    With weights by length, as within a scan, the incomplete map would outweigh the template.
    """
    n = len(around)
    even = SumOfGaussians(
        around.mean, around.covariance, np.full(n, 1.0 / max(n, 1)), np.zeros(n, dtype=bool)
    ).thinned(_THIN_M)
    shape, n = template.shape, len(even)
    weight = np.concatenate((shape.weight, np.full(n, 1.0 / max(n, 1))))
    return SumOfGaussians(
        np.concatenate((shape.mean, even.mean)),
        np.concatenate((shape.covariance, even.covariance)),
        weight / weight.sum(),
        np.concatenate((shape.boundary, even.boundary)),
    )


def observe_enriched(
    template: Template,
    around: SumOfGaussians,
    scan: SumOfGaussians,
    predicted: Array,
    covariance: Array,
    matching: TemplateMatching,
) -> Observation:
    """Align a template with a scan (see `observe`), searching where its surroundings fit.

    around: Gaussians in the landmark's axis. Two places that fit the surroundings are as ambiguous
    as two that fit a template.
    """
    alignment = matching.alignment
    found = align(enriched(template, around), scan, predicted, covariance, alignment)
    if found.runner_up > matching.options.ambiguous:
        return Observation(None, AMBIGUOUS)
    once = replace(matching, alignment=replace(alignment, spacing_m=_ONE_START_M))
    return observe(template, scan, found.pose, covariance, once)
