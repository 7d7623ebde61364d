"""Templates of landmarks, and their observation in scans (Nieto 2005, 5.2.1, 5.2.3 and 5.7)."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from ekf_reference.core.geometry import Array, Index, Mask, to_world
from ekf_reference.core.measurements import DynamicGuard
from ekf_reference.scan_matching.alignment_covariance import (
    CovarianceOptions,
    ScanAlignment,
    scan_align,
)
from ekf_reference.scan_matching.problem import AlignmentOptions
from ekf_reference.scan_matching.sog import SumOfGaussians

_LEAST_POINTS = 3
_LEAST_LEVER_M = 0.01
_TIE = 1e-6
"""Metres or radians; far above rounding. What lies on a bound to so much falls on one side of it:
recorded ranges and bearings are multiples of a step, and often lie on bounds exactly."""
_BESIDE = 2.5
"""Two returns are beside each other when so many beams or fewer apart; no whole number of them."""

BLANK = "blank scan"
OUT_OF_VIEW = "out of view"
APART = "does not meet the scan"
AMBIGUOUS = "ambiguous"
UNFINISHED = "not converged"
UNDETERMINED = "no direction determined"


MOVING_SHARE = 0.2
"""Of a template in dynamic regions; then its landmark is deactivated. Of 22 templates
(`dynamic-lanes`, car park) 11 had 0.07 or less, as at a region's edge, and 11 0.25 or more."""


@dataclass(frozen=True)
class Template:
    """A landmark's shape in its own axis, and where the axis was when it was made.

    shape: with its centroid at the axis' origin. pose: (3,) of the axis in the vehicle's frame,
    x_L of Nieto 2005, eq. 5.2, as first seen; its heading is the vehicle's, so 0.
    """

    shape: SumOfGaussians
    pose: Array

    @classmethod
    def of_segment(cls, scan: SumOfGaussians, rows: Index) -> Self:
        """Some returns of a scan in the vehicle's frame; the axis at their centroid (5.2.3).

        Raises ValueError for fewer than three returns, or all in one place: nothing in them
        has a heading.
        """
        part = scan.take(rows)
        if len(part) < _LEAST_POINTS or part.lever_m < _LEAST_LEVER_M:
            raise ValueError(
                f"a template of {len(part)} points within {part.lever_m:.3f} m, expected at least "
                f"{_LEAST_POINTS} over {_LEAST_LEVER_M} m"
            )
        centre = part.centroid
        return cls(replace(part, mean=part.mean - centre), np.append(centre, 0.0))

    def moves(self, axis: Array, guard: DynamicGuard) -> bool:
        """Return whether it is largely where things move, its axis at (3,) (section 6.5)."""
        return bool(np.mean(guard.is_dynamic(self.placed(axis))) >= MOVING_SHARE)

    def placed(self, axis: Array) -> Array:
        """Return its points (N, 2) where its axis is at (3,)."""
        return to_world(axis, self.shape.mean)


@dataclass(frozen=True)
class SensorView:
    """What a sensor sees: ranges up to reach_m, bearings from first_rad to last_rad.

    share: least part of a template's points that must be in view (section 5.7). shadow_m: a
    return nearer than a point by more than that hides it.
    """

    reach_m: float
    first_rad: float
    last_rad: float
    share: float = 0.9
    shadow_m: float = 1.0

    def sees(self, point: Array) -> Mask:
        """(N,) which points (N, 2) of the scanner's frame lie in the field of view.

        What lies on its rims does, what lies at the scanner does not.
        """
        bearing, way = np.arctan2(point[:, 1], point[:, 0]), np.hypot(*point.T)
        # Turned by whole circles into the one that begins at the first bearing.
        after = np.mod(bearing - self.first_rad + _TIE, 2.0 * np.pi)
        inside: Mask = (
            (way > _TIE)
            & (way <= self.reach_m + _TIE)
            & (after <= self.last_rad - self.first_rad + 2.0 * _TIE)
        )
        return inside


@dataclass(frozen=True)
class ObservationOptions:
    """When an alignment observes a landmark.

    overlap: least share of what is aligned that finds a counterpart. ambiguous: greatest second
    maximum over the best. visible: of the template only what should be in view is aligned.
    """

    overlap: float = 0.5
    ambiguous: float = 0.8
    visible: bool = False


@dataclass(frozen=True)
class TemplateMatching:
    """How templates are sought in scans.

    view: what the sensor sees. options: what counts as seeing a landmark. alignment and belief: of
    the alignment, and of its covariance.
    """

    view: SensorView
    options: ObservationOptions = field(default_factory=ObservationOptions)
    alignment: AlignmentOptions = field(default_factory=AlignmentOptions)
    belief: CovarianceOptions = field(default_factory=CovarianceOptions)


@dataclass(frozen=True)
class Observation:
    """The observation of a template in a scan.

    alignment: z and R with their evidence, None when nothing was tried. reason: why it must not
    be used, one of BLANK, OUT_OF_VIEW, APART, AMBIGUOUS, UNDETERMINED, UNFINISHED; empty where it
    may be.
    """

    alignment: ScanAlignment | None
    reason: str = ""

    @property
    def usable(self) -> bool:
        """Whether it may go into a filter's update, through its gate."""
        return not self.reason


def share_in_view(template: Template, scan: SumOfGaussians, pose: Array, view: SensorView) -> float:
    """Return the share of a template's points that the scanner should see.

    pose: (3,) of the template's axis in the scanner's frame. Points outside the field of view, or
    behind much nearer returns on both sides, are not seen.
    """
    return float(np.mean(_in_view(template, scan, pose, view)))


def observe(
    template: Template,
    scan: SumOfGaussians,
    predicted: Array,
    covariance: Array,
    matching: TemplateMatching,
) -> Observation:
    """[z, R] = scan_align(G_L, G_o, z^) of Nieto 2005, section 5.2.1, against the whole scan.

    scan: in the scanner's frame, bearings in order. predicted: (3,) z^, the axis' pose in that
    frame, and covariance: (3, 3) of its error.
    """
    o, view = matching.options, matching.view
    if not len(scan):
        return Observation(None, BLANK)
    seen = _in_view(template, scan, predicted, view)
    if np.mean(seen) < view.share:
        return Observation(None, OUT_OF_VIEW)
    shape = template.shape.take(seen) if o.visible else template.shape
    found = scan_align(shape, scan, predicted, covariance, matching.alignment, matching.belief)
    evidence = found.alignment
    if evidence.overlap < o.overlap:
        return Observation(found, APART)
    if evidence.runner_up > o.ambiguous:
        return Observation(found, AMBIGUOUS)
    if found.open_directions == 3:
        return Observation(found, UNDETERMINED)
    return Observation(found, "" if evidence.converged else UNFINISHED)


def _in_view(template: Template, scan: SumOfGaussians, pose: Array, view: SensorView) -> Mask:
    """(N,) which of a template's points the sensor should see; see share_in_view."""
    point = template.shape.transformed(pose).mean
    seen = view.sees(point)
    return seen & ~_hidden(point, scan, view.shadow_m) if len(scan) > 1 else seen


def _hidden(point: Array, scan: SumOfGaussians, shadow_m: float) -> Mask:
    """(N,) points (N, 2) behind the returns on both sides."""
    bearing, way = np.arctan2(scan.mean[:, 1], scan.mean[:, 0]), np.hypot(*scan.mean.T)
    spacing = np.diff(bearing)
    width = _BESIDE * float(np.median(spacing))
    at = np.arctan2(point[:, 1], point[:, 0])
    after = np.clip(np.searchsorted(bearing, at - _TIE), 1, len(bearing) - 1)
    beside = (at >= bearing[0] - width) & (at <= bearing[-1] + width)
    close = beside & (spacing[after - 1] <= width)
    nearer = np.maximum(way[after - 1], way[after]) + shadow_m + _TIE < np.hypot(*point.T)
    hidden: Mask = close & nearer
    return hidden
