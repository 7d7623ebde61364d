"""What lays a template, a piece of a scan, onto other scans, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from graphslam.arrays import Array
from graphslam.scan.matchers import JudgedMatcher, MatchOptions
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.refinement import RefinementOptions
from graphslam.scan.registration import ScanError

_LEAST_LEVER_M = 0.01
_FREE_M = 100.0
"""Sigma of what a shape does not fix: so wide that the guess, which is the estimate's, says nothing
of itself."""


@dataclass(frozen=True)
class Template:
    """A piece of a scan. pose: number of the one it was taken from. place: (3,) its axis there.

    points: (M, 3) in the axis' frame [m].
    """

    pose: int
    place: Array
    points: Array


class TemplateMatchers:
    """A matcher for each size of template, and a judge of where it began.

    A direction counts as fixed when so great a share of the points fix it, and three points at
    least: in noise the normals along a wall turn, and a long one would seem to fix its own length.
    """

    fixing: float = 0.15

    def __init__(
        self, settings: KissIcpOptions, kind: Callable[[MatchOptions], JudgedMatcher]
    ) -> None:
        """settings: of scan odometry for these scans. kind: makes the matcher."""
        self._settings, self._kind = settings, kind
        self._matchers: dict[int, JudgedMatcher] = {}

    def matcher(self, count: int) -> JudgedMatcher:
        """For templates of so many points."""
        if count not in self._matchers:
            self._matchers[count] = self._kind(self._options(count, _FREE_M))
        return self._matchers[count]

    def initialised(self, template: Template, cloud: Array, free_m: float) -> Array:
        """(3, 3) how far the axis of a template's points may be from their true surfaces' axis.

        Of the right perturbation. cloud: (N, 3) the scan that it is a piece of.
        """
        options = self._options(len(template.points), free_m)
        calibration = self.matcher(len(template.points)).calibration
        judge = replace(options.judge, calibration=calibration)
        try:
            found = _Standing(replace(options, judge=judge)).match(
                template.points, cloud, template.place
            )
        except ScanError:  # no surface fixes it at all
            return np.diag((free_m, free_m, free_m / lever_m(template.points))) ** 2
        return found.covariance

    def _options(self, count: int, free_m: float) -> MatchOptions:
        fixed = max(RefinementOptions().least_stiffness, self.fixing * count)
        judge = RefinementOptions(least_stiffness=fixed, free_sigma_m=free_m)
        return replace(MatchOptions.suited(self._settings, judge), iterations=30, least_points=3)


def lever_m(points: Array) -> float:
    """Root mean square distance of points (M, 3) from the axis, per heading [m/rad]."""
    return max(float(np.sqrt(np.mean(np.sum(points[:, :2] ** 2, axis=1)))), _LEAST_LEVER_M)


class _Standing(JudgedMatcher):
    """Takes the guess for the result, and judges it."""

    def align(self, source: Array, target: Array, start: Array) -> Iterator[Array]:
        """See JudgedMatcher."""
        yield from ()
