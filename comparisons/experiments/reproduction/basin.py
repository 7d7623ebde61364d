"""How far off an alignment may begin, with a template alone and with what is around it (N 6.2).

Two questions. From one start: does it end where the landmark is, as the basin of convergence
asks? And with a prior to search, as Scan-SLAM does it: is what is then said of the landmark right,
wrong, or is nothing said?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.scan_landmarks.map_aided_matching import enriched, observe_enriched
from ekf_reference.scan_landmarks.scan_slam import ScanSlamOptions
from ekf_reference.scan_landmarks.templates import (
    Observation,
    Template,
    TemplateMatching,
    View,
    observe,
)
from ekf_reference.scan_matching.alignment import align
from ekf_reference.scan_matching.sog import SumOfGaussians

_ONE_START = np.diag((1e-6, 1e-6, 1e-8))
TURN = math.radians(10.0)
"""A start that is off by a metre is turned by so much."""
SAME_MAXIMUM = (1.0, math.radians(10.0))
"""An alignment that ends so near is at the right maximum, metres and radians: with the noise of
Table 5.1 those of templates lie 0.3 m (median) off the truth."""
_ANYWHERE = View(math.inf, -math.pi, math.pi, share=0.0)


@dataclass(frozen=True)
class Seen:
    """A landmark in a scan from elsewhere. around: as ScanSlam has it. true: (3,) in the scan."""

    template: Template
    around: SumOfGaussians
    scan: SumOfGaussians
    true: Array


@dataclass(frozen=True)
class ConvergenceBasin:
    """Shares by initial error (E,) [m]; columns are the template alone and with its surroundings.

    converged: (E, 2) from one start. right, wrong: (E, 2) with a prior of that sigma to search; the
    rest says nothing. cases: landmarks in scans.
    """

    error_m: Array
    converged: Array
    right: Array
    wrong: Array
    cases: int


def _converges(template: SumOfGaussians, true: Array, scan: SumOfGaussians, off: Array) -> bool:
    """Whether an alignment that begins off by (3,) ends where the template is."""
    return _is_close(align(template, scan, true + off, _ONE_START).pose, true)


def _offsets(rng: np.random.Generator, error_m: float, draws: int) -> Array:
    """(D, 3) of so many metres any way, and turned with them either way."""
    way = rng.uniform(0.0, 2.0 * np.pi, draws)
    side = rng.choice((-1.0, 1.0), draws)
    return error_m * np.column_stack((np.cos(way), np.sin(way), side * TURN))


def basin(
    cases: Sequence[Seen], errors: Sequence[float], draws: int, rng: np.random.Generator
) -> ConvergenceBasin:
    """All cases from `draws` starts per initial error [m]."""
    count = np.zeros((3, len(errors), 2))
    for row, error in enumerate(errors):
        for case in cases:
            richer = enriched(case.template, case.around)
            for off in _offsets(rng, error, draws):
                count[0, row] += (
                    _converges(case.template.shape, case.true, case.scan, off),
                    _converges(richer, case.true, case.scan, off),
                )
                for column, what in enumerate(_searched(case, off, error)):
                    if what.usable and what.alignment is not None:
                        close = _is_close(what.alignment.pose, case.true)
                        count[1 if close else 2, row, column] += 1
    converged, right, wrong = count / max(draws * len(cases), 1)
    return ConvergenceBasin(np.array(errors, dtype=float), converged, right, wrong, len(cases))


def _searched(case: Seen, off: Array, error_m: float) -> tuple[Observation, Observation]:
    """What Scan-SLAM makes of it, without and with the surroundings."""
    o = ScanSlamOptions()
    prior = np.diag((error_m, error_m, error_m * TURN)) ** 2
    matching = TemplateMatching(_ANYWHERE, o.observation, o.alignment, o.belief)
    how = case.scan, case.true + off, prior, matching
    return observe(case.template, *how), observe_enriched(case.template, case.around, *how)


def _is_close(pose: Array, true: Array) -> bool:
    away = pose - true
    turned = abs(float(wrap_angle(away[2])))
    return bool(np.hypot(*away[:2]) <= SAME_MAXIMUM[0] and turned <= SAME_MAXIMUM[1])
