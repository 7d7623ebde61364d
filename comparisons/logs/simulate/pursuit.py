"""The car-like vehicle of Nieto 2005, Appendix A, steered along a closed path."""

from __future__ import annotations

import math

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.odometry import Ackermann


def pursue(
    path: Array, v: Ackermann, speed_mps: float, sample_s: float, count: int
) -> tuple[Array, Array]:
    """True controls (N, 2) and poses (N + 1, 3) of the laser: pure pursuit along a path (P, 2).

    The pursuit steers the rear axle, which sits (a, b) behind the laser.
    """
    lookahead_m, dt = 4.0, sample_s
    step = np.linalg.norm(np.roll(path, -1, axis=0) - path, axis=1)
    ahead = max(1, round(lookahead_m / float(step.mean())))
    tangent = path[1] - path[0]
    heading = math.atan2(tangent[1], tangent[0])
    x, y = path[0].tolist()
    nearest = 0
    control, pose = np.empty((count, 2)), np.empty((count + 1, 3))
    pose[0] = _laser(v, x, y, heading)
    for k in range(count):
        window = (nearest + np.arange(50)) % len(path)
        offset = path[window] - (x, y)
        nearest = int(window[np.argmin(np.einsum("ij,ij->i", offset, offset))])
        goal_x, goal_y = path[(nearest + ahead) % len(path)].tolist()
        eta = math.atan2(goal_y - y, goal_x - x) - heading
        distance = math.hypot(goal_x - x, goal_y - y)
        steering = math.atan(2.0 * v.wheelbase_m * math.sin(eta) / distance)
        slip = 1.0 - math.tan(steering) * v.encoder_offset_m / v.wheelbase_m
        control[k] = speed_mps * slip, steering
        # The laser's Euler step of A.4 is that of the axle's middle plus the swing of (a, b).
        curvature = math.tan(steering) / v.wheelbase_m
        cos, sin = math.cos(heading), math.sin(heading)
        a, b, ds = v.sensor_forward_m, v.sensor_left_m, dt * speed_mps
        pose[k + 1] = pose[k] + ds * np.array(
            (
                cos - curvature * (a * sin + b * cos),
                sin + curvature * (a * cos - b * sin),
                curvature,
            )
        )
        heading = float(pose[k + 1, 2])
        # Where the axle's middle is, seen from the laser, for the pursuit.
        x = float(pose[k + 1, 0] - a * math.cos(heading) + b * math.sin(heading))
        y = float(pose[k + 1, 1] - a * math.sin(heading) - b * math.cos(heading))
    return control, pose


def _laser(v: Ackermann, x: float, y: float, heading: float) -> tuple[float, float, float]:
    """Nieto 2005, eq. A.2."""
    cos, sin = math.cos(heading), math.sin(heading)
    a, b = v.sensor_forward_m, v.sensor_left_m
    return x + a * cos - b * sin, y + a * sin + b * cos, heading
