"""The filter's part in merging two pose landmarks that are one (Nieto 2005, section 5.2.3)."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import POSE
from ekf_reference.core.measurement_update import Linearised
from ekf_reference.core.state import LocalMap
from ekf_reference.models.relative_pose import RelativePose

_MODEL = RelativePose()


def merge_landmarks(ekf: Ekf, first: int, second: int, z: Array, covariance: Array) -> LocalMap:
    """Fuse where the second's frame is in the first's, and remove the second.

    z: (3,) such as the alignment of their templates says, with covariance (3, 3); zero with little
    covariance makes them equal. Returns the two as they were before the removal, to move what the
    second's frame holds (scan_matching.frames). Raises ValueError for one landmark, or one removed.
    """
    if first == second:
        raise ValueError(f"landmark {first} is one already")
    both = np.array((first, second), dtype=np.intp)

    def linearise() -> Linearised:
        local = ekf.state.map_of(both, POSE)
        at = _MODEL.predict(local.landmark[0], local.landmark[1:])
        by_pose = np.zeros((3, len(local.pose)))
        jacobian = np.hstack((by_pose, at.jacobian_pose[0], at.jacobian_landmark[0]))
        return Linearised(local, jacobian, _MODEL.innovation(z, at.z[0]))

    ekf.fuse(linearise, covariance[None], ekf.take_numbers("merge"), both[1:], first)
    known = ekf.state.map_of(both, POSE)
    ekf.remove(both[1:], POSE)
    return known
