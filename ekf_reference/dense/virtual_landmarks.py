"""Corners for regions where no landmark can stand, such as inside buildings (Nieto 2005, 3.5.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ekf_reference.dense.conditions import Conditions
from ekf_reference.dense.triangles import Array, turned


class VirtualLandmark(NamedTuple):
    """A landmark that nobody sees, and the sighting by which it enters the map.

    point: (2,) [m]. z: (2,) range [m] and bearing [rad] from the vehicle, bearing in (-pi, pi].
    """

    point: Array
    z: Array


@dataclass(frozen=True)
class VirtualLandmarks:
    """Where a virtual landmark is wanted.

    conditions: the first of them is asked of the vehicle's position and the two landmarks.
    depth: how far behind the line between the two, as a share of their distance; equilateral
    by default.
    """

    conditions: Conditions = field(default_factory=Conditions)
    depth: float = math.sqrt(0.75)

    def wanted(self, pose: Array, landmark: Array, covariance: Array) -> VirtualLandmark | None:
        """The third corner to two landmarks, on the side away from the vehicle; None for not now.

        Source: Nieto 2005, section 3.5.1: created "at a moment where the vehicle is highly
        correlated with the other two landmarks", since it is placed relative to the vehicle and
        has no information of its own.

        pose: (3,). landmark: (2, 2) [m]. covariance: (7, 7) of the pose, then the landmarks. None
        too where the landmarks coincide or the vehicle stands on their line, so that no side
        is the far one.

        To create it, augment the filter as by a sighting z without noise, and never update it by
        a sighting. What the filter knew is not changed by that.
        """
        place = np.array((0, 1, 3, 4, 5, 6))
        corners = np.vstack((pose[:2], landmark))
        alike = self.conditions.correlated(covariance[np.ix_(place, place)])
        edge = landmark[1] - landmark[0]
        normal = turned(edge)
        side = float(normal @ (pose[:2] - landmark[0]))
        if not alike.all() or abs(side) <= 1e-9 * np.square(np.ptp(corners, axis=0)).sum():
            return None
        point = landmark.mean(axis=0) - math.copysign(self.depth, side) * normal
        east, north = point - pose[:2]
        bearing = math.remainder(math.atan2(north, east) - pose[2], 2.0 * math.pi)
        return VirtualLandmark(point, np.array((math.hypot(east, north), bearing)))
