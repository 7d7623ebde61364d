"""A drive on an arc through a yard, with a scan from every pose."""

import numpy as np

from graphslam.scan import planar
from tests.graphslam.numerics import Array
from tests.graphslam.scan.shapes import YARD, scan

STEP = np.array((0.2, 0.02, 0.06))
SIGMA_M = 0.01


def drive(
    scans: int, sigma_m: float = SIGMA_M, step: Array = STEP, seed: int = 0
) -> tuple[Array, list[Array]]:
    """True poses (N, 3) on an arc through the yard, and a scan from each."""
    rng = np.random.default_rng(seed)
    poses = [np.array((-2.5, -3.5, 0.0))]
    for _ in range(scans - 1):
        poses.append(planar.compose(poses[-1], step))
    return np.array(poses), [scan(rng, YARD, pose, sigma_m) for pose in poses]
