"""A log's start pose and truth in one frame: another prior's pose, or truth laid onto the start.

`load_log` asks for both, `--prior-pose` and `--align`; `check` lays the estimate onto the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.adapters.motion import motion_between
from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import Landmarks, Log, Poses, Surfaces
from comparisons.logs.odometry import RelativePoses
from graphslam.scan import planar


@dataclass(frozen=True)
class PlaneMotion:
    """A motion of the plane: a turn [rad] about the origin, then a shift (2,) [m]."""

    turn_rad: float
    shift_m: Array

    @classmethod
    def between(cls, pose: Array, onto: Array) -> PlaneMotion:
        """Return the motion that brings a pose (3,) onto another."""
        turn = float(onto[2] - pose[2])
        return cls(turn, onto[:2] - planar.rotation(turn)[:2, :2] @ pose[:2])

    @property
    def rotation(self) -> Array:
        """(2, 2)."""
        found: Array = planar.rotation(self.turn_rad)[:2, :2]
        return found

    def places(self, places: Array) -> Array:
        """Move places (N, 2)."""
        moved: Array = places @ self.rotation.T + self.shift_m
        return moved

    def __str__(self) -> str:
        x, y = self.shift_m.tolist()
        return (
            f"turned by {np.degrees(self.turn_rad):.4g} degrees and moved by ({x:.4g}, {y:.4g}) m"
        )


def with_prior_pose(log: Log, pose: tuple[float, float, float]) -> Log:
    """Return a log that starts from another pose, as certain as its own."""
    return replace(log, prior=replace(log.prior, pose=np.array(pose)))


def with_truth_at_start(log: Log) -> Log:
    """Return a log whose truth is laid onto the odometry's path, by the first true pose in it.

    The path begins at the prior. Raises InputError where no true pose lies in the log's time.
    """
    poses = log.truth.poses
    if poses is None:
        return log
    first_s = first_reckoned_s(log, float(poses.time_s[0]))
    if not first_s <= min(log.end_s, float(poses.time_s[-1])):
        raise InputError(
            f"{log.name}: no true pose lies in the log's time, expected one for --align"
        )
    motion = PlaneMotion.between(poses.at(np.array([first_s]))[0], reckoned_at(log, first_s))
    landmarks, surfaces = log.truth.landmarks, log.truth.surfaces
    pose = np.column_stack((motion.places(poses.pose[:, :2]), poses.pose[:, 2] + motion.turn_rad))
    truth = replace(log.truth, poses=Poses(poses.time_s, pose))
    if landmarks is not None:
        covariance = motion.rotation @ landmarks.covariance @ motion.rotation.T
        places = motion.places(landmarks.position_m)
        truth = replace(truth, landmarks=Landmarks(landmarks.id, places, covariance))
    if surfaces is not None:
        ends = [motion.places(surfaces.segment[:, at : at + 2]) for at in (0, 2)]
        truth = replace(truth, surfaces=Surfaces(np.hstack(ends)))
    return replace(log, truth=truth, provenance={**log.provenance, "truth": str(motion)})


def first_reckoned_s(log: Log, time_s: float) -> float:
    """Return the first time from one on at which the odometry tells a pose."""
    start_s = log.prior.time_s
    if not isinstance(log.odometry, RelativePoses):
        return max(start_s, time_s)
    known = np.append(start_s, log.odometry.time_s)
    return float(known[min(int(np.searchsorted(known, time_s)), len(known) - 1)])


def reckoned_at(log: Log, time_s: float) -> Array:
    """Return the pose (3,) that the odometry leads to from the prior."""
    if time_s <= log.prior.time_s:
        return log.prior.pose
    motion = motion_between(log, np.array([time_s]))
    found: Array = planar.compose(log.prior.pose, motion.displacement[0])
    return found
