"""How the vehicle moved, as its own sensors tell: wheels, or measured displacements."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs import schema
from comparisons.logs.records import Stream
from comparisons.logs.validation import refuse
from comparisons.shown import Brief
from graphslam import increments

Named = Literal["euler", "middle", "arc"]
Integration = Named | int | float
"""How a sample's motion is integrated: see docs/models.md. A whole number: in so many Euler steps;
any other: in equal Euler steps of at most so many seconds."""


@dataclass(frozen=True)
class Ackermann:
    """Car-like vehicle; see Nieto 2005, Fig. A.2. Lengths in metres, zeros give a plain bicycle."""

    wheelbase_m: float
    encoder_offset_m: float = 0.0
    sensor_forward_m: float = 0.0
    sensor_left_m: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            object.__setattr__(self, f.name, float(value))
            if not abs(value) <= 1e3:
                raise InputError(f"vehicle: {f.name} is {value}, expected at most 1000 m")
        if self.wheelbase_m < 0.01:
            raise InputError(f"vehicle: wheelbase_m is {self.wheelbase_m}, expected at least 0.01")


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of a wheel odometry sample, and the stabilisation noise.

    sigma_speed_mps; sigma_turn: of the steering angle [rad] or of the yaw rate [rad/s].
    variance_rate_position [m^2/s], variance_rate_heading [rad^2/s]: small noise both estimators
    add (Nieto 2005, section 2.1.1), since one sample's control noise is singular. Zero will do
    where the samples between any two poses make it regular; see adapters.motion.check_regular.
    """

    sigma_speed_mps: float
    sigma_turn: float
    variance_rate_position: float = 1e-6
    variance_rate_heading: float = 1e-8

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            object.__setattr__(self, f.name, float(value))
            if not 0.0 <= value <= 1e6:
                raise InputError(
                    f"odometry noise: {f.name} is {value}, expected between 0 and 1e+06"
                )


@dataclass(frozen=True, repr=False)
class SteeringOdometry(Stream, Brief):
    """Speed [m/s] and steering angle [rad, left positive], each held until the next sample."""

    table = schema.STEERED

    time_s: Array
    speed_mps: Array
    steering_rad: Array
    vehicle: Ackermann
    noise: OdometryNoise

    @property
    def controls(self) -> tuple[Array, Array]:
        """Of the estimators, (N,) each."""
        return self.speed_mps, self.steering_rad

    def __post_init__(self) -> None:
        super().__post_init__()
        slip = np.tan(self.steering_rad) * self.vehicle.encoder_offset_m / self.vehicle.wheelbase_m
        smaller = "a smaller angle (it turns the vehicle about the wheel with the encoder)"
        refuse("steering odometry", slip > 0.95, "steering_rad", self.steering_rad, smaller)


@dataclass(frozen=True, repr=False)
class VelocityOdometry(Stream, Brief):
    """Speed [m/s] and yaw rate [rad/s], each held until the next sample."""

    table = schema.VELOCITY

    time_s: Array
    speed_mps: Array
    yaw_rate_radps: Array
    noise: OdometryNoise

    @property
    def controls(self) -> tuple[Array, Array]:
        """Of the estimators, (N,) each."""
        return self.speed_mps, self.yaw_rate_radps


@dataclass(frozen=True, repr=False)
class RelativePoses(Stream, Brief):
    """Displacements between consecutive poses; the first departs from the prior.

    time_s: (N,) of arrival. displacement: (N, 3) dx, dy [m], dheading [rad] in the departing
    frame. covariance: (N, 3, 3) in the arriving frame (the convention of g2o and gtsam), all NaN
    where nothing measured the motion, the displacement being a guess and the log having closures.
    """

    table = schema.RELATIVE

    time_s: Array
    displacement: Array
    covariance: Array


Odometry = SteeringOdometry | VelocityOdometry | RelativePoses


def own_integration(odometry: SteeringOdometry | VelocityOdometry) -> Integration:
    """As the documents have it: Nieto 2005, eqs. 2.5 and A.4; the middle heading of yaw rates."""
    return "euler" if isinstance(odometry, SteeringOdometry) else "middle"


def wheel_samples(
    odometry: SteeringOdometry | VelocityOdometry,
    controls: Iterable[Array],
    hold_s: Array,
    integration: Integration | None = None,
) -> increments.MotionSamples:
    """Motions under controls (N,) each, held so long (N,), by graphslam's vehicle models."""
    (first, second), noise = controls, odometry.noise
    added = increments.Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)
    common = (first, second, hold_s, (noise.sigma_speed_mps, noise.sigma_turn), added)
    asked = integration or own_integration(odometry)
    if isinstance(odometry, SteeringOdometry):
        geometry = increments.AckermannGeometry(**vars(odometry.vehicle))
        return increments.ackermann_samples(*common, geometry, asked)
    return increments.unicycle_samples(*common, asked)


# Odometry given as poses, which carry no covariance of their displacements, so one is stated:
# variances grow with the way and with the turn, hence do not depend on how often a scanner fires.
# It is generous for wheels indoors, since scan matching corrects what it leaves open.
SIGMA_M_PER_SQRT_M = 0.1
"""Forward and sideways: 10 % after one metre."""
SIGMA_M_PER_SQRT_RAD = 0.05
SIGMA_RAD_PER_SQRT_M = 0.05
SIGMA_RAD_PER_SQRT_RAD = 0.1
"""Of the heading: 10 % after one radian."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 1e-3])
_LONGEST_S = 0.5

NOISE_TEXT = (
    f"stated: {SIGMA_M_PER_SQRT_M:g} m per root metre and {SIGMA_M_PER_SQRT_RAD:g} m per root "
    f"radian, {SIGMA_RAD_PER_SQRT_M:g} rad per root metre and {SIGMA_RAD_PER_SQRT_RAD:g} rad per "
    "root radian"
)


def displacements(time_s: Array, pose: Array) -> RelativePoses:
    """Motion from each pose to the next, with the stated covariance.

    time_s: (N,), increasing. pose: (N, 3) x, y [m], heading [rad], wrapped or not. The result has
    N - 1 records and departs from the first pose, which is the prior's; none for one pose.
    """
    step = (np.diff(pose[:, 0]) + 1j * np.diff(pose[:, 1])) * np.exp(-1j * pose[:-1, 2])
    turn = np.angle(np.exp(1j * np.diff(pose[:, 2])))
    way, swing = np.abs(step), np.abs(turn)
    position = SIGMA_M_PER_SQRT_M**2 * way + SIGMA_M_PER_SQRT_RAD**2 * swing
    heading = SIGMA_RAD_PER_SQRT_M**2 * way + SIGMA_RAD_PER_SQRT_RAD**2 * swing
    variance = np.column_stack((position, position, heading)) + _LEAST_SIGMA**2
    moved = np.column_stack((step.real, step.imag, turn))
    return RelativePoses(time_s[1:], moved, variance[:, :, None] * np.eye(3))


def poses_at(time_s: Array, sample_s: Array, pose: Array) -> Array:
    """(N, 3) poses interpolated at the instants (N,) among the samples (M,), (M, 3).

    Headings are interpolated the short way round. The instants must lie within the samples' time.
    """
    whole = np.column_stack((pose[:, :2], np.unwrap(pose[:, 2])))
    return np.column_stack([np.interp(time_s, sample_s, column) for column in whole.T])


def instants_of(wanted_s: Array, sample_s: Array) -> Array:
    """(N,) instants wanted, both ends of the samples, and one of them in each empty half second.

    wanted_s: (M,) within the samples' time.
    """
    return np.unique(np.concatenate((wanted_s, sample_s[[0, -1]], filling(wanted_s, sample_s))))


def filling(instants_s: Array, sample_s: Array) -> Array:
    """One of the samples (M,) in each half second in which no instant lies.

    Without them a trajectory would cut its corners wherever nothing was seen for a while.
    """
    cell = np.floor(sample_s / _LONGEST_S)
    first = np.unique(cell, return_index=True)[1]
    empty = ~np.isin(cell[first], np.floor(instants_s / _LONGEST_S))
    return sample_s[first[empty]]
