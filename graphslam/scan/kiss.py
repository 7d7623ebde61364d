"""KISS-ICP's pieces, loaded where they are first used: commands without scans do not pay for them.

One thread always: with more, its sums depend on who comes first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from graphslam.arrays import Array
from graphslam.scan.libraries import kiss_icp

if TYPE_CHECKING:
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.registration import Registration


def registration(iterations: int, converged: float) -> Registration:
    """The aligner of points to a voxel map; converged: step that ends it."""
    return kiss_icp().registration.Registration(iterations, converged, max_num_threads=1)


def voxel_map(voxel_m: float, reach_m: float, per_voxel: int) -> VoxelHashMap:
    """An empty map that forgets what lies beyond its reach."""
    return kiss_icp().mapping.VoxelHashMap(voxel_m, reach_m, per_voxel)


def thinned(points: Array, voxel_m: float) -> Array:
    """(M, 3) one of the points (N, 3) in each voxel, the first."""
    return np.asarray(kiss_icp().voxelization.voxel_down_sample(points, voxel_m))
