"""Composite odometry: many samples between two poses become one increment with its covariance.

Each sample moves the vehicle by a small body-frame displacement. An increment's covariance is of
the right perturbation, in the frame of arrival (delta Exp(xi)), which is what BetweenFactorPose2
takes. Everything is computed for all samples of a log at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphslam.arrays import Array, Index

Integration = Literal["euler", "middle", "arc"] | int | float
"""A sample's displacement along the departing heading, along the middle one, or on a circle; a
whole number: in so many equal steps, each along its departing heading; any other number: in equal
steps of at most so many seconds."""


@dataclass(frozen=True)
class MotionSamples:
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
    sigma: tuple[float, float],
    stabilisation: Stabilisation,
    geometry: AckermannGeometry,
    integration: Integration = "euler",
) -> MotionSamples:
    """Return the motion of a car with an encoder on the rear left wheel, its pose at the laser.

    In the body frame A.4 says: the axle's middle advances by ds, the laser at (a, b) also swings by
    -b and a times the turn ds tan(alpha) / L.

    Args:
        speed_mps: (N,) of the encoder.
        steering_rad: (N,), positive to the left.
        duration_s: (N,) for which each sample holds.
        sigma: Of speed [m/s] and steering [rad] of every sample, independent.
        stabilisation: Noise added to every sample.
        geometry: Measures of the car.
        integration: Along the departing heading in the source.

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
    if integration != "euler":
        displacement, jacobian = _integrated(displacement, jacobian, duration_s, 0.0, integration)
    return _with_noise(displacement, jacobian, sigma, duration_s, stabilisation)


def unicycle_samples(
    speed_mps: Array,
    yaw_rate_radps: Array,
    duration_s: Array,
    sigma: tuple[float, float],
    stabilisation: Stabilisation,
    integration: Integration = "middle",
) -> MotionSamples:
    """Return the motion of a differential drive: a chord along the heading halfway.

    Args:
        speed_mps: (N,), forward.
        yaw_rate_radps: (N,), positive to the left.
        duration_s: (N,) for which each sample holds.
        sigma: Of speed [m/s] and yaw rate [rad/s] of every sample, independent.
        stabilisation: Noise added to every sample.
        integration: Another way to lead the displacement.

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
    if integration != "middle":
        displacement, jacobian = _integrated(displacement, jacobian, duration_s, 0.5, integration)
    return _with_noise(displacement, jacobian, sigma, duration_s, stabilisation)


def _integrated(
    displacement: Array,
    jacobian: Array,
    duration_s: Array,
    taken: float,
    integration: Integration,
) -> tuple[Array, Array]:
    """Integrate samples in another way; `taken`: share of the turn at which they have the heading.

    As complex numbers: a displacement z at the departing heading becomes z f(turn), where f is 1,
    exp(i turn / 2), the mean m(turn) of exp(i s turn) over s from 0 to 1, or in n steps the mean
    over their beginnings, m(turn) / m(turn / n).
    """
    turn = displacement[:, 2]
    straight = (displacement[:, 0] + 1j * displacement[:, 1]) * np.exp(-1j * taken * turn)
    by_straight = (jacobian[:, 0] + 1j * jacobian[:, 1]) * np.exp(-1j * taken * turn)[:, None]
    by_straight -= 1j * taken * straight[:, None] * jacobian[:, 2]
    factor, by_turn = np.ones(len(turn), complex), np.zeros(len(turn), complex)
    if integration == "middle":
        factor = np.exp(0.5j * turn)
        by_turn = 0.5j * factor
    elif integration != "euler":
        factor, by_turn = _mean_turn(turn)
        if not isinstance(integration, str):
            steps: float | Array = integration
            if isinstance(integration, float):
                steps = np.maximum(1.0, np.ceil(duration_s / integration - 1e-9))
            part, by_part = _mean_turn(turn / steps)
            factor = factor / part
            by_turn = (by_turn - factor * by_part / steps) / part
    way = straight * factor
    by_control = by_straight * factor[:, None] + (straight * by_turn)[:, None] * jacobian[:, 2]
    moved, changed = displacement.copy(), jacobian.copy()
    moved[:, 0], moved[:, 1] = way.real, way.imag
    changed[:, 0], changed[:, 1] = by_control.real, by_control.imag
    return moved, changed


def _mean_turn(turn: Array) -> tuple[Array, Array]:
    """Return (exp(i turn) - 1) / (i turn) and its derivative; their Taylor series near zero."""
    small = np.abs(turn) < 0.1
    t = np.where(small, 1.0, turn)
    mean = (np.exp(1j * t) - 1.0) / (1j * t)
    slope = (np.exp(1j * t) - mean) / t
    term = np.ones(len(turn), complex)  # (i turn)^n / (n + 1)!
    series, by_turn = np.zeros(len(turn), complex), np.zeros(len(turn), complex)
    for n in range(12):
        series += term
        by_turn += 1j * (n + 1) / (n + 2) * term
        term = term * 1j * turn / (n + 2)
    return np.where(small, series, mean), np.where(small, by_turn, slope)


def compose(samples: MotionSamples, interval: Index, count: int) -> MotionSamples:
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
    transport = inverse_adjoint(
        cos * east + sin * north, -sin * east + cos * north, heading[last] - heading[after]
    )
    carried = transport @ samples.covariance @ transport.transpose(0, 2, 1)
    carried = 0.5 * (carried + carried.transpose(0, 2, 1))
    covariance = np.zeros((count, 3, 3))
    filled = start < end
    if filled.any():
        covariance[filled] = np.add.reduceat(carried, start[filled], axis=0)
    return MotionSamples(displacement, covariance)


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


def dead_reckoned_covariance(prior: Array, poses: Array, covariance: Array) -> Array:
    """Return covariances (K, 3, 3) of poses that the odometry alone leads to, to first order.

    An error of step j turns what comes after it about pose j: with T(p) = [[I, J p], [0, 1]], J a
    quarter turn, it is T(p_k) T(-p_j) times as large at pose k, so that all sums run along once.

    Args:
        prior: (3, 3) of the first pose, additive in the world's frame.
        poses: (K, 3) of `dead_reckoned`.
        covariance: (K-1, 3, 3) of the increments' right perturbations, in the frame of arrival.

    Returns:
        They are additive in the world's frame, as those of estimates.
    """
    nothing = np.zeros(len(covariance))
    into_world = inverse_adjoint(nothing, nothing, -poses[1:, 2])
    step = np.concatenate((prior[None], into_world @ covariance @ into_world.mT))
    place = poses[:, :2] - poses[0, :2]
    back, there = _about(-place), _about(place)
    summed = np.cumsum(back @ step @ back.mT, axis=0)
    found: Array = there @ summed @ there.mT
    return found


def _about(place: Array) -> Array:
    """T(p) (K, 3, 3) of places (K, 2)."""
    return inverse_adjoint(place[:, 0], place[:, 1], np.zeros(len(place)))


def _dead_reckoning(displacement: Array) -> tuple[Array, Array, Array]:
    """Heading, x, y (N + 1,) of the samples chained from the origin."""
    heading = np.concatenate(([0.0], np.cumsum(displacement[:, 2])))
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    dx, dy = displacement[:, 0], displacement[:, 1]
    x = np.concatenate(([0.0], np.cumsum(cos * dx - sin * dy)))
    y = np.concatenate(([0.0], np.cumsum(sin * dx + cos * dy)))
    return heading, x, y


def inverse_adjoint(x: Array, y: Array, turn: Array) -> Array:
    """Return Ad(T^-1) for planar motions T = (x, y, turn).

    A right perturbation (u, w) before T equals R^T (u + w (-y, x)), w after it.

    Args:
        x: (N,) [m].
        y: (N,) [m].
        turn: (N,) [rad].

    Returns:
        (N, 3, 3).
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
    sigma: tuple[float, float],
    duration_s: Array,
    stabilisation: Stabilisation,
) -> MotionSamples:
    """Turn control noise, given through Jacobians in the departing frame, into the arriving one."""
    cos, sin = np.cos(displacement[:, 2]), np.sin(displacement[:, 2])
    arriving = np.empty_like(jacobian)
    arriving[:, 0] = cos[:, None] * jacobian[:, 0] + sin[:, None] * jacobian[:, 1]
    arriving[:, 1] = -sin[:, None] * jacobian[:, 0] + cos[:, None] * jacobian[:, 1]
    arriving[:, 2] = jacobian[:, 2]
    variance = np.array((sigma[0] ** 2, sigma[1] ** 2))
    covariance = (arriving * variance) @ arriving.transpose(0, 2, 1)
    covariance[:, 0, 0] += stabilisation.variance_rate_position * duration_s
    covariance[:, 1, 1] += stabilisation.variance_rate_position * duration_s
    covariance[:, 2, 2] += stabilisation.variance_rate_heading * duration_s
    return MotionSamples(displacement, covariance)
