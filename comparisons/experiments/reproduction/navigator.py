"""A filter that says where the robot is while a simulated run goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import NO_GATE
from comparisons.arrays import Array
from ekf_reference.association.known import KnownAssociation
from ekf_reference.association.nearest_neighbour import EuclideanNeighbour
from ekf_reference.core.ekf import Ekf
from ekf_reference.filters.misono import DirectionCosineEkf, DirectionCosineOptions
from ekf_reference.models.motion import RelativePoseModel


class FilterNavigator:
    """A filter with a relative-pose motion model, as Navigator of the waypoint run."""

    def __init__(self, ekf: Ekf, *, use_measurements: bool = True, use_fixes: bool = True) -> None:
        """ekf: at its prior. Without measurements and fixes it is dead reckoning."""
        self.ekf = ekf
        self.use_measurements = use_measurements
        self.use_fixes = use_fixes
        self.path: list[Array] = [self.pose()]

    def departed(self, displacement: Array, covariance: Array, true_pose: Array) -> None:
        """Predict; the truth stays unread."""
        self.ekf.predict(displacement, covariance, 0.0)
        self.path.append(self.pose())

    def saw(self, z: Array, sigma: Array, landmark: NDArray[np.int64]) -> None:
        """Associate and update."""
        if self.use_measurements and len(z):
            self.ekf.observe(z, sigma, landmark)
            self.path[-1] = self.pose()

    def fixed(self, position: Array, covariance: Array) -> None:
        """Fuse the position."""
        if self.use_fixes:
            self.ekf.fix_position(position, covariance)
            self.path[-1] = self.pose()

    def pose(self) -> Array:
        """(3,) the filter's estimate."""
        return self.ekf.read_pose().pose


def direction_cosine_navigator(
    *, complete: bool, slam: bool = True, aided: bool = False
) -> FilterNavigator:
    """Misono's filter at the base, as published or complete; without `slam` it dead reckons.

    aided: it is given labels and positions; else landmarks go by eq. 17, and there are none.
    """
    rule = KnownAssociation() if aided else EuclideanNeighbour()
    ekf = DirectionCosineEkf(
        RelativePoseModel(),
        rule,
        np.zeros(3),
        1e-10 * np.eye(3),
        options=DirectionCosineOptions(
            full_jacobian=complete, renormalise=complete, stacked=complete
        ),
    )
    if not complete:
        ekf.fixes = replace(ekf.fixes, gate=NO_GATE)
    return FilterNavigator(ekf, use_measurements=slam, use_fixes=slam and aided)
