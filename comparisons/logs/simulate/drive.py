"""Drive the car-like vehicle of Nieto 2005, Appendix A, around a world and record a log.

The truth is the model itself (A.3, A.4) under the true controls, so a filter with the same model
has no model error at all; the recorded controls and measurements carry the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Poses, Prior, Truth
from comparisons.logs.odometry import Ackermann, OdometryNoise, SteeringOdometry
from comparisons.logs.readers.victoria_park import UTE
from comparisons.logs.simulate.ray_casting import blocks
from comparisons.logs.simulate.worlds import LandmarkWorld, nieto_loop

PAIRS = 2_000_000
"""Pairs of a scan and a landmark whose distances are held in memory at once."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Vehicle and sensors; the defaults are Nieto 2005, Table 2.2 and Appendix A.

    field_of_view_rad: full angle of the sensor, centred straight ahead. extra_s: driven on after
    the last loop. noise_scale: multiplies every sigma above and the stabilisation noise's, what is
    added to the data and what the log states alike. exact: nothing is added, and the log states
    its sigmas all the same: there both estimators must find the truth itself.
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
    extra_s: float = 0.0
    noise_scale: float = 1.0
    exact: bool = False
    vehicle: Ackermann = UTE

    @property
    def added_scale(self) -> float:
        """What the sigmas are multiplied by where noise is added."""
        return 0.0 if self.exact else self.noise_scale

    def scan_samples(self, count: int) -> NDArray[np.int64]:
        """Which of `count` samples end with a scan."""
        return np.arange(self.scan_every, count + 1, self.scan_every)


def simulate(
    rng: np.random.Generator, drive: Drive | None = None, world: LandmarkWorld | None = None
) -> Log:
    """One simulated log with truth. The same generator state gives the same log."""
    drive, world = drive or Drive(), world or nieto_loop()
    time, control, pose = true_drive(drive, world)
    odometry = wheel_odometry(rng, drive, time, control)
    scans = drive.scan_samples(len(control))
    measurements = point_measurements(rng, drive, world.landmark, time[scans], pose[scans])
    return Log(
        name="simulated-loop",
        format="simulated",
        prior=known_start(pose, drive.noise_scale),
        odometry=odometry,
        measurements=measurements,
        truth=Truth(Poses(time, pose), exact_landmarks(world.landmark)),
        provenance={
            "source": "Nieto 2005, section 2.9, Table 2.2",
            "loops": str(drive.loops),
            "noise_scale": f"{drive.noise_scale:g}",
        },
    )


def true_drive(drive: Drive, world: LandmarkWorld) -> tuple[Array, Array, Array]:
    """Times (N + 1,), true controls (N, 2) and true poses (N + 1, 3) of the laser."""
    count = round((drive.loops * drive.loop_s + drive.extra_s) / drive.sample_s)
    time: Array = drive.sample_s * np.arange(float(count + 1))
    return time, *pursue(world.path, drive.vehicle, drive.speed_mps, drive.sample_s, count)


def wheel_odometry(
    rng: np.random.Generator, drive: Drive, time: Array, control: Array
) -> SteeringOdometry:
    """The controls as the sensors tell them, with noise."""
    noise, scale = drive.added_scale * rng.standard_normal((len(control), 2)), drive.noise_scale
    return SteeringOdometry(
        time[:-1],
        control[:, 0] + drive.sigma_speed_mps * noise[:, 0],
        control[:, 1] + drive.sigma_steering_rad * noise[:, 1],
        drive.vehicle,
        OdometryNoise(
            scale * drive.sigma_speed_mps,
            scale * drive.sigma_steering_rad,
            scale**2 * 1e-7,
            scale**2 * 1e-9,
        ),
    )


def known_start(pose: Array, scale: float) -> Prior:
    """The estimators start where the vehicle does; so small a doubt leaves the frame fixed.

    scale: as the noise's.
    """
    return Prior(0.0, pose[0], scale**2 * 1e-10 * np.eye(3))


def exact_landmarks(landmark: Array) -> Landmarks:
    """Landmarks (L, 2) in order, without doubt."""
    return Landmarks(np.arange(len(landmark)), landmark, np.zeros((len(landmark), 2, 2)))


def point_measurements(
    rng: np.random.Generator,
    drive: Drive,
    landmark: Array,
    time: Array,
    pose: Array,
    hidden: NDArray[np.bool_] | None = None,
) -> LandmarkMeasurements:
    """All landmarks in view of every scan (N,), with noise; hidden: (N, L) are left out.

    landmark: (L, 2), or (N, L, 2) where they are in each scan, NaN for nowhere.
    """
    parts = [
        _in_view(
            drive,
            landmark if landmark.ndim == 2 else landmark[scans],
            pose[scans],
            None if hidden is None else hidden[scans],
            scans.start,
        )
        for scans in blocks(len(pose), landmark.shape[-2], PAIRS)
    ]
    scan, which, distance, bearing = (np.concatenate(column) for column in zip(*parts, strict=True))
    sigma = np.array((drive.sigma_range_m, drive.sigma_bearing_rad))
    noise = drive.added_scale * rng.standard_normal((len(scan), 2))
    z = np.column_stack((distance, bearing)) + sigma * noise
    return LandmarkMeasurements.of(time[scan], z, drive.noise_scale * sigma, which)


def _in_view(
    drive: Drive, landmark: Array, pose: Array, hidden: NDArray[np.bool_] | None, first: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
    """Return the scan (M,), from `first` on, landmark, true range and bearing of what is in view.

    landmark: (L, 2) or (N, L, 2). pose: (N, 3). hidden: (N, L).
    """
    offset = landmark - pose[:, None, :2]
    distance = np.linalg.norm(offset, axis=2)
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - pose[:, None, 2]
    bearing = np.angle(np.exp(1j * bearing))
    seen = (distance <= drive.max_range_m) & (np.abs(bearing) <= 0.5 * drive.field_of_view_rad)
    scan, which = np.nonzero(seen if hidden is None else seen & ~hidden)
    return first + scan, which, distance[scan, which], bearing[scan, which]


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
        east = cos - curvature * (a * sin + b * cos)
        north = sin + curvature * (a * cos - b * sin)
        pose[k + 1] = pose[k] + ds * np.array((east, north, curvature))
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
