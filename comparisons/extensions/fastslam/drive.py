"""FastSLAM driven through a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from ekf_reference.core.ekf import Stabilisation
from ekf_reference.core.geometry import rotation
from ekf_reference.core.landmark_types import diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam.association import (
    Choice,
    KnownIdentities,
    PerParticleLikelihood,
    View,
)
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions, Proposal

VIEW = View(range_m=30.0, half_angle_rad=1.2)
"""Where a landmark should be detected when it exists, for logs without labels."""


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """What a FastSLAM estimates of a log.

    slam: at the end of the log. mean: (K, 3) weighted mean at each epoch of the timeline, from the
    measurements up to then. covariance: (K, 3, 3) of the particles there. sampled: (S,) epochs at
    which poses were sampled, those of the filter's history.
    """

    slam: FastSlam
    mean: Array
    covariance: Array
    sampled: Index


class Sampling(NamedTuple):
    """How to sample. seed: of all random numbers. choice: of associations without labels."""

    particles: int = 100
    proposal: Proposal = "measurement"
    seed: int = 0
    choice: Choice = "likeliest"


def build_fastslam(log: Log, sampling: Sampling, *, known: bool) -> FastSlam:
    """Return a FastSLAM at the log's prior.

    known: associate by the log's labels, else every particle for itself.
    """
    stabilisation = Stabilisation()
    if not isinstance(log.odometry, RelativePoses):
        noise = log.odometry.noise
        stabilisation = Stabilisation(noise.variance_rate_position, noise.variance_rate_heading)
    rule = (
        KnownIdentities(log.measurements.label_gate)
        if known
        else PerParticleLikelihood(view=VIEW, choice=sampling.choice)
    )
    options = FastSlamOptions(
        particles=sampling.particles, proposal=sampling.proposal, association=rule
    )
    generator = np.random.default_rng(sampling.seed)
    prior = log.prior
    return FastSlam(
        motion_model(log), prior.pose, prior.covariance, generator, options, stabilisation
    )


def run_fastslam(
    slam: FastSlam,
    log: Log,
    timeline: Timeline,
    on_epoch: Callable[[int, FastSlam], None] = lambda epoch, slam: None,
) -> Cloud:
    """Drive a FastSLAM through a log. on_epoch: called with each epoch's number.

    Poses are sampled at epochs with measurements and at the last one; in between the motion
    accumulates, so that FastSLAM 2.0 conditions all of it on the next measurements.
    """
    seen = log.measurements
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    noise = diagonal_noise(np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad)))
    steps, first, done = timeline.steps_until(), timeline.measurements_until(), 0
    mean, covariance = np.empty((len(steps), 3)), np.empty((len(steps), 3, 3))
    sampled = []
    for k, time_s in enumerate(timeline.epoch_time_s.tolist()):
        for i in range(done, int(steps[k])):
            slam.predict(
                timeline.control[i], timeline.control_covariance[i], timeline.step_duration_s[i]
            )
        done, rows = int(steps[k]), slice(int(first[k]), int(first[k + 1]))
        if rows.start < rows.stop or k + 1 == len(steps):
            slam.observe(Measurements(z[rows], noise[rows], seen.landmark[rows], time_s=time_s))
            sampled.append(k)
        weight, pose = slam.weight, slam.predicted_pose()
        mean[k] = weight @ pose
        covariance[k] = np.einsum("n,ni,nj->ij", weight, pose - mean[k], pose - mean[k])
        root = slam.motion.root_at_arrival()  # of motion that is not sampled yet
        root = rotated(root, float(mean[k, 2]))
        covariance[k] += root @ root.T
        on_epoch(k, slam)
    return Cloud(
        slam=slam, mean=mean, covariance=covariance, sampled=np.array(sampled, dtype=np.intp)
    )


def rotated(root: Array, heading_rad: float) -> Array:
    """A root (3, 3) of a pose's covariance in its own frame, on the map."""
    turn = np.eye(3)
    turn[:2, :2] = rotation(heading_rad)
    found: Array = turn @ root
    return found
