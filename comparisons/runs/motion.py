"""A timeline's steps as the smoother's motion samples."""

from __future__ import annotations

from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses, SteeringOdometry
from comparisons.runs.timeline import Timeline
from graphslam import increments


def motion_samples(log: Log, timeline: Timeline) -> increments.Samples:
    """Body-frame displacements and covariances of all steps, by graphslam's vehicle models."""
    odometry = log.odometry
    if isinstance(odometry, RelativePoses):
        return increments.relative_pose_samples(timeline.control, timeline.control_covariance)
    noise = odometry.noise
    stabilisation = increments.Stabilisation(
        noise.variance_rate_position, noise.variance_rate_heading
    )
    first, second = timeline.control.T
    common = (timeline.step_duration_s, noise.sigma_speed_mps, noise.sigma_turn, stabilisation)
    if isinstance(odometry, SteeringOdometry):
        return increments.ackermann_samples(first, second, *common, **vars(odometry.vehicle))
    return increments.unicycle_samples(first, second, *common)
