"""Composite odometry: many samples between two poses become one increment with its covariance.

Each sample moves the vehicle by a small body-frame displacement. An increment's covariance is of
the right perturbation, in the frame of arrival (delta Exp(xi)), which is what BetweenFactorPose2
takes. Everything is computed for all samples of a log at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam.arrays import Array, Index


@dataclass(frozen=True)
class Samples:
    """Body-frame motion of N samples.

    displacement: (N, 3) dx, dy [m], dheading [rad] in the departing frame.
    covariance: (N, 3, 3) of the right perturbation in the arriving frame.
    """

    displacement: Array
    covariance: Array


@dataclass(frozen=True)
class Stabilisation:
    """Noise added to every sample, per second: m^2 / s (isotropic) and rad^2 / s."""

    variance_rate_position: float = 0.0
    variance_rate_heading: float = 0.0


@dataclass(frozen=True)
class AckermannGeometry:
    """Measures of a car (Nieto 2005, A.3 and A.4) [m].

    wheelbase_m: L. encoder_offset_m: H, the encoder left of the axle's middle. sensor_forward_m,
    sensor_left_m: (a, b), the laser from there.
    """

    wheelbase_m: float
    encoder_offset_m: float = 0.0
    sensor_forward_m: float = 0.0
    sensor_left_m: float = 0.0


def ackermann_samples(
    speed_mps: Array,
    steering_rad: Array,
    duration_s: Array,
    sigma_speed_mps: float,
    sigma_steering_rad: float,
    stabilisation: Stabilisation,
    geometry: AckermannGeometry,
) -> Samples:
    """Return the motion of a car with an encoder on the rear left wheel, its pose at the laser.

    In the body frame A.4 says: the axle's middle advances by ds, the laser at (a, b) also swings by
    -b and a times the turn ds tan(alpha) / L.

    Args:
        speed_mps: (N,) of the encoder.
        steering_rad: (N,), positive to the left.
        duration_s: (N,) for which each sample holds.
        sigma_speed_mps: Of every sample, independent.
        sigma_steering_rad: Of every sample, independent.
        stabilisation: Noise added to every sample.
        geometry: Measures of the car.

    Returns:
        Displacements in the departing frame, covariances in the arriving one.

    Source: Nieto 2005, eqs. A.3 and A.4.
    """
    wheelbase_m = geometry.wheelbase_m
    forward_m, left_m = geometry.sensor_forward_m, geometry.sensor_left_m
    tan = np.tan(steering_rad)
    slip = 1.0 - tan * (geometry.encoder_offset_m / wheelbase_m)
    advance = duration_s * speed_mps / slip
    turn = advance * tan / wheelbase_m
    # turn = dt v tan / (L - H tan), whose derivative in tan is dt v L / (L - H tan)^2.
    turn_by_steering = duration_s * speed_mps / wheelbase_m * (1.0 + tan**2) / slip**2
    advance_by_steering = turn_by_steering * geometry.encoder_offset_m
    jacobian = np.empty((len(tan), 3, 2))
    for column, (forward, angle) in enumerate(
        (
            (duration_s / slip, duration_s / slip * tan / wheelbase_m),
            (advance_by_steering, turn_by_steering),
        )
    ):
        jacobian[:, 0, column] = forward - left_m * angle
        jacobian[:, 1, column] = forward_m * angle
        jacobian[:, 2, column] = angle
    displacement = np.column_stack((advance - left_m * turn, forward_m * turn, turn))
    variances = (sigma_speed_mps**2, sigma_steering_rad**2)
    return _with_noise(displacement, jacobian, variances, duration_s, stabilisation)


def unicycle_samples(
    speed_mps: Array,
    yaw_rate_radps: Array,
    duration_s: Array,
    sigma_speed_mps: float,
    sigma_yaw_rate_radps: float,
    stabilisation: Stabilisation,
) -> Samples:
    """Return the motion of a differential drive: a chord along the heading halfway.

    Args:
        speed_mps: (N,), forward.
        yaw_rate_radps: (N,), positive to the left.
        duration_s: (N,) for which each sample holds.
        sigma_speed_mps: Of every sample, independent.
        sigma_yaw_rate_radps: Of every sample, independent.
        stabilisation: Noise added to every sample.

    Returns:
        Displacements in the departing frame, covariances in the arriving one.
    """
    turn = duration_s * yaw_rate_radps
    chord = duration_s * speed_mps
    cos, sin = np.cos(0.5 * turn), np.sin(0.5 * turn)
    jacobian = np.zeros((len(turn), 3, 2))
    jacobian[:, 0, 0] = duration_s * cos
    jacobian[:, 1, 0] = duration_s * sin
    jacobian[:, 0, 1] = -0.5 * duration_s * chord * sin
    jacobian[:, 1, 1] = 0.5 * duration_s * chord * cos
    jacobian[:, 2, 1] = duration_s
    displacement = np.column_stack((chord * cos, chord * sin, turn))
    variances = (sigma_speed_mps**2, sigma_yaw_rate_radps**2)
    return _with_noise(displacement, jacobian, variances, duration_s, stabilisation)


def relative_pose_samples(displacement: Array, covariance: Array) -> Samples:
    """Return measured displacements as samples.

    Args:
        displacement: (N, 3) dx, dy [m], dheading [rad] in the departing frame.
        covariance: (N, 3, 3) of the right perturbation, in the arriving frame.

    Returns:
        The same arrays; nothing is copied.
    """
    return Samples(displacement, covariance)


def compose(samples: Samples, interval: Index, count: int) -> Samples:
    """Compose the samples of each interval into one increment.

    A perturbation xi_i at the arrival of sample i reaches the end of the interval as Ad(T_i^-1)
    xi_i, T_i the motion from i to the end; the covariances add, being independent.

    Args:
        samples: N samples, in order of time.
        interval: (N,) the interval of each sample, not decreasing.
        count: How many intervals.

    Returns:
        `count` increments; zero, with zero covariance, for an interval without samples.
    """
    heading, x, y = _dead_reckoning(samples.displacement)
    start = np.searchsorted(interval, np.arange(count), side="left")
    end = np.searchsorted(interval, np.arange(count), side="right")
    cos, sin = np.cos(heading[start]), np.sin(heading[start])
    east, north = x[end] - x[start], y[end] - y[start]
    displacement = np.column_stack(
        (cos * east + sin * north, -sin * east + cos * north, heading[end] - heading[start])
    )

    last = end[interval]
    after = np.arange(1, len(interval) + 1)
    cos, sin = np.cos(heading[after]), np.sin(heading[after])
    east, north = x[last] - x[after], y[last] - y[after]
    transport = _inverse_adjoint(
        cos * east + sin * north, -sin * east + cos * north, heading[last] - heading[after]
    )
    carried = transport @ samples.covariance @ transport.transpose(0, 2, 1)
    carried = 0.5 * (carried + carried.transpose(0, 2, 1))
    covariance = np.zeros((count, 3, 3))
    filled = start < end
    if filled.any():
        covariance[filled] = np.add.reduceat(carried, start[filled], axis=0)
    return Samples(displacement, covariance)


def dead_reckoned(prior_pose: Array, displacement: Array) -> Array:
    """Return the poses that displacements lead to on their own.

    Args:
        prior_pose: (3,) x, y [m], heading [rad].
        displacement: (N, 3), each in the departing frame.

    Returns:
        (N + 1, 3), headings unwrapped.
    """
    heading, x, y = _dead_reckoning(displacement)
    cos, sin = np.cos(prior_pose[2]), np.sin(prior_pose[2])
    turned = np.column_stack((cos * x - sin * y, sin * x + cos * y, heading))
    poses: Array = prior_pose + turned
    return poses


def _dead_reckoning(displacement: Array) -> tuple[Array, Array, Array]:
    """Heading, x, y (N + 1,) of the samples chained from the origin."""
    heading = np.concatenate(([0.0], np.cumsum(displacement[:, 2])))
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    dx, dy = displacement[:, 0], displacement[:, 1]
    x = np.concatenate(([0.0], np.cumsum(cos * dx - sin * dy)))
    y = np.concatenate(([0.0], np.cumsum(sin * dx + cos * dy)))
    return heading, x, y


def _inverse_adjoint(x: Array, y: Array, turn: Array) -> Array:
    """Ad(T^-1) (N, 3, 3) for planar motions T = (x, y, turn).

    A right perturbation (u, w) before T equals R^T (u + w (-y, x)), w after it.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    result = np.zeros((len(x), 3, 3))
    result[:, 0, 0] = result[:, 1, 1] = cos
    result[:, 0, 1] = sin
    result[:, 1, 0] = -sin
    result[:, 0, 2] = -cos * y + sin * x
    result[:, 1, 2] = sin * y + cos * x
    result[:, 2, 2] = 1.0
    return result


def _with_noise(
    displacement: Array,
    jacobian: Array,
    variances: tuple[float, float],
    duration_s: Array,
    stabilisation: Stabilisation,
) -> Samples:
    """Turn control noise, given through Jacobians in the departing frame, into the arriving one."""
    cos, sin = np.cos(displacement[:, 2]), np.sin(displacement[:, 2])
    arriving = np.empty_like(jacobian)
    arriving[:, 0] = cos[:, None] * jacobian[:, 0] + sin[:, None] * jacobian[:, 1]
    arriving[:, 1] = -sin[:, None] * jacobian[:, 0] + cos[:, None] * jacobian[:, 1]
    arriving[:, 2] = jacobian[:, 2]
    covariance = (arriving * np.array(variances)) @ arriving.transpose(0, 2, 1)
    covariance[:, 0, 0] += stabilisation.variance_rate_position * duration_s
    covariance[:, 1, 1] += stabilisation.variance_rate_position * duration_s
    covariance[:, 2, 2] += stabilisation.variance_rate_heading * duration_s
    return Samples(displacement, covariance)
