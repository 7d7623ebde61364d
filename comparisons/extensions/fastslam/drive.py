"""FastSLAM driven through a log, or through a stretch of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import motion_model, stabilisation
from comparisons.adapters.timeline import Timeline
from comparisons.arrays import Array, Index
from comparisons.logs.log import Log
from ekf_reference.core.landmark_types import diagonal_noise
from ekf_reference.core.measurements import Measurements
from ekf_reference.fastslam.association import (
    Choice,
    ExpectedDetection,
    KnownIdentities,
    ParticleAssociation,
    PerParticleLikelihood,
)
from ekf_reference.fastslam.filter import FastSlam, FastSlamOptions, Proposal
from graphslam.scan import planar

VIEW = ExpectedDetection(range_m=30.0, half_angle_rad=1.2)
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
    """How to sample.

    choice: of associations, in logs without labels. seed: of all random numbers; a stream of their
    own for every cloud.
    """

    particles: int = 100
    proposal: Proposal = "measurement"
    seed: int = 0
    choice: Choice = "likeliest"
    stream: tuple[int, ...] = ()


class DriveStart(NamedTuple):
    """What is known at first: pose (3,) and the covariance (3, 3) of its additive global error."""

    pose: Array
    covariance: Array


def build_fastslam(log: Log, sampling: Sampling, *, known: bool) -> FastSlam:
    """Return a FastSLAM at the log's prior.

    known: associate by the log's labels, else every particle for itself.
    """
    rule: ParticleAssociation = PerParticleLikelihood(view=VIEW, choice=sampling.choice)
    if known:
        rule = KnownIdentities(log.measurements.label_gate)
    return start_fastslam(log, sampling, rule, DriveStart(log.prior.pose, log.prior.covariance))


def start_fastslam(
    log: Log, sampling: Sampling, rule: ParticleAssociation, start: DriveStart
) -> FastSlam:
    """Return a FastSLAM with the log's vehicle."""
    options = FastSlamOptions(
        particles=sampling.particles, proposal=sampling.proposal, association=rule
    )
    generator = np.random.default_rng((sampling.seed, *sampling.stream))
    return FastSlam(motion_model(log), *start, generator, options, stabilisation(log))


class Inputs:
    """Controls and measurements by epoch."""

    def __init__(self, log: Log, timeline: Timeline, identity: NDArray[np.int64]) -> None:
        """identity: (M,) landmark of each of the log's measurements, negative where unknown."""
        measurements = log.measurements
        self._timeline, self._identity = timeline, identity
        self._z = np.column_stack((measurements.range_m, measurements.bearing_rad))
        self._noise = diagonal_noise(
            np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))
        )
        self._steps, self._rows = timeline.steps_until(), timeline.measurements_until()
        self.epochs = len(self._steps)

    def predict(self, slam: FastSlam, epoch: int) -> None:
        """Move from the epoch before."""
        first = int(self._steps[epoch - 1]) if epoch else 0
        for i in range(first, int(self._steps[epoch])):
            slam.predict(
                self._timeline.control[i],
                self._timeline.control_covariance[i],
                self._timeline.step_duration_s[i],
            )

    def seen(self, epoch: int) -> Measurements:
        """Return the epoch's measurements, of which there may be none."""
        rows = slice(int(self._rows[epoch]), int(self._rows[epoch + 1]))
        time_s = float(self._timeline.epoch_time_s[epoch])
        return Measurements(self._z[rows], self._noise[rows], self._identity[rows], time_s=time_s)


def run_fastslam(slam: FastSlam, log: Log, timeline: Timeline) -> Cloud:
    """Drive a FastSLAM through a log.

    Poses are sampled at epochs with measurements and at the last one; in between the motion
    accumulates, so that FastSLAM 2.0 conditions all of it on the next measurements.
    """
    inputs = Inputs(log, timeline, log.measurements.landmark)
    mean, covariance = np.empty((inputs.epochs, 3)), np.empty((inputs.epochs, 3, 3))
    sampled = []
    for k in range(inputs.epochs):
        inputs.predict(slam, k)
        measurements = inputs.seen(k)
        if len(measurements) or k + 1 == inputs.epochs:
            slam.observe(measurements)
            sampled.append(k)
        weight, pose = slam.weight, slam.predicted_pose()
        mean[k] = weight @ pose
        covariance[k] = np.einsum("n,ni,nj->ij", weight, pose - mean[k], pose - mean[k])
        root = slam.motion.root_at_arrival()  # of motion that is not sampled yet
        root = planar.rotation(float(mean[k, 2])) @ root
        covariance[k] += root @ root.T
    return Cloud(
        slam=slam, mean=mean, covariance=covariance, sampled=np.array(sampled, dtype=np.intp)
    )
