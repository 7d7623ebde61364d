"""Drive the car-like vehicle of Nieto 2005, Appendix A, around a world and record a log.

The truth is the model itself (A.3, A.4) under the true controls, so a filter with the same model
has no model error at all; the recorded controls and sightings carry the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.logs.log import Landmarks, Log, Poses, Prior, Sightings, Truth
from comparisons.logs.odometry import Ackermann, OdometryNoise, SteeringOdometry
from comparisons.logs.readers.victoria_park import UTE
from comparisons.logs.simulate.worlds import World, nieto_loop

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Drive:
    """Vehicle and sensors; the defaults are Nieto 2005, Table 2.2 and Appendix A.

    field_of_view_rad: full angle of the sensor, centred straight ahead. noise_scale: multiplies
    what is added to the data, not the sigmas that the log states, so that zero gives exact data.
    """

    loops: int = 1
    speed_mps: float = 3.0
    sample_s: float = 0.025
    scan_every: int = 8
    sigma_speed_mps: float = 0.3
    sigma_steering_rad: float = math.radians(3.0)
    sigma_range_m: float = 0.15
    sigma_bearing_rad: float = math.radians(1.0)
    max_range_m: float = 20.0
    field_of_view_rad: float = math.pi
    loop_s: float = 85.0
    noise_scale: float = 1.0
    vehicle: Ackermann = UTE


def simulate(
    rng: np.random.Generator, drive: Drive | None = None, world: World | None = None
) -> Log:
    """One simulated log with truth. The same generator state gives the same log."""
    drive, world = drive or Drive(), world or nieto_loop()
    count = round(drive.loops * drive.loop_s / drive.sample_s)
    time: Array = drive.sample_s * np.arange(float(count + 1))
    control, pose = _true_drive(drive, world, count)
    scale = drive.noise_scale
    noise = scale * rng.standard_normal((count, 2))
    odometry = SteeringOdometry(
        time[:-1],
        control[:, 0] + drive.sigma_speed_mps * noise[:, 0],
        control[:, 1] + drive.sigma_steering_rad * noise[:, 1],
        drive.vehicle,
        OdometryNoise(drive.sigma_speed_mps, drive.sigma_steering_rad, 1e-7, 1e-9),
    )
    scans = np.arange(drive.scan_every, count + 1, drive.scan_every)
    sightings = _sightings(rng, drive, world, time[scans], pose[scans])
    # The estimators start where the vehicle does; so small a doubt leaves the frame fixed there.
    prior = Prior(0.0, pose[0], 1e-10 * np.eye(3))
    landmarks = Landmarks(
        np.arange(len(world.landmark)), world.landmark, np.zeros((len(world.landmark), 2, 2))
    )
    return Log(
        "simulated-loop",
        "simulated",
        prior,
        odometry,
        sightings,
        truth=Truth(Poses(time, pose), landmarks),
        provenance={
            "source": "Nieto 2005, section 2.9, Table 2.2",
            "loops": str(drive.loops),
            "noise_scale": f"{scale:g}",
        },
    )


def _true_drive(drive: Drive, world: World, count: int) -> tuple[Array, Array]:
    """True controls (N, 2) and poses (N + 1, 3) of the laser: pure pursuit along the path.

    The pursuit steers the rear axle, which sits (a, b) behind the laser.
    """
    v = drive.vehicle
    lookahead_m, dt = 4.0, drive.sample_s
    path = world.path
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
        control[k] = drive.speed_mps * slip, steering
        # The laser's Euler step of A.4 is that of the axle's middle plus the swing of (a, b).
        curvature = math.tan(steering) / v.wheelbase_m
        cos, sin = math.cos(heading), math.sin(heading)
        a, b, ds = v.sensor_forward_m, v.sensor_left_m, dt * drive.speed_mps
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


def _sightings(
    rng: np.random.Generator, drive: Drive, world: World, time: Array, pose: Array
) -> Sightings:
    """All landmarks in view of every scan, with noise."""
    offset = world.landmark[None] - pose[:, None, :2]
    distance = np.linalg.norm(offset, axis=2)
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - pose[:, None, 2]
    bearing = np.angle(np.exp(1j * bearing))
    scan, landmark = np.nonzero(
        (distance <= drive.max_range_m) & (np.abs(bearing) <= 0.5 * drive.field_of_view_rad)
    )
    count = len(scan)
    noise = drive.noise_scale * rng.standard_normal((count, 2))
    return Sightings(
        time[scan],
        distance[scan, landmark] + drive.sigma_range_m * noise[:, 0],
        bearing[scan, landmark] + drive.sigma_bearing_rad * noise[:, 1],
        np.full(count, drive.sigma_range_m),
        np.full(count, drive.sigma_bearing_rad),
        landmark,
        np.full(count, np.nan),
    )
