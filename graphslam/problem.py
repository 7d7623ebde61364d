"""The SLAM problem as arrays: the smoother's input, before any graph is made of it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from graphslam.arrays import Array, Index
from graphslam.layout import Layout

OPEN_PRIOR = np.diag((1e8, 1e8, 1e6))
"""A prior's covariance [m^2, rad^2] that says nothing and only keeps the equations regular."""


@dataclass(frozen=True)
class Merges:
    """N pairs of pose landmarks that are one: where the second is in the first's frame.

    pose: (N,) at which it was found, both having been seen. first, second: (N,) landmarks.
    measured: (N, 3) x, y, heading. covariance: (N, 3, 3) of the right perturbation, in the
    second's frame.
    """

    pose: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    first: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    second: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))


@dataclass(frozen=True)
class PoseLandmarkMeasurements:
    """N measurements of pose landmarks (place and direction), such as templates of scans.

    pose: (N,) and landmark: (N,) indices, these landmarks being numbered apart from the others.
    measured: (N, 3) x, y, heading of the landmark in the pose's frame. covariance: (N, 3, 3) of
    the right perturbation, in the landmark's frame. merges: which of these landmarks are one.
    """

    pose: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    landmark: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    measured: Array = field(default_factory=lambda: np.zeros((0, 3)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    merges: Merges = field(default_factory=Merges)

    @property
    def count(self) -> int:
        """Number of landmarks."""
        return int(self.landmark.max(initial=-1)) + 1


@dataclass(frozen=True)
class LoopClosures:
    """N measured motions between poses that do not follow each other, such as closed loops.

    first, second: (N,) indices of poses. motion: (N, 3) of the second in the first's frame.
    covariance: (N, 3, 3) of the right perturbation, in the second's frame. kernel: the robust
    kernel that they are under, of graph_builder.KERNELS, as a wrong one may come between.
    """

    first: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    second: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    motion: Array = field(default_factory=lambda: np.zeros((0, 3)))
    covariance: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    kernel: str = "none"

    @property
    def last(self) -> Index:
        """(N,) the later pose of each."""
        return np.maximum(self.first, self.second)


@dataclass(frozen=True, kw_only=True)
class SlamProblem:
    """The smoother's input, for K poses, L landmarks and M measurements.

    prior_pose: (3,), prior_covariance: (3, 3) of the additive global error of pose 0.
    increment: (K-1, 3) from pose k to k+1 in the frame of k; increment_covariance: (K-1, 3, 3)
    of the right perturbation (frame of k+1), NaN where nothing measured the motion, so that the
    increment is a guess and closures must connect the two poses.
    measurement_pose, measurement_landmark: (M,) indices. z: (M, 2) range and bearing; sigma: (M,
    2).
    position_pose: (G,) indices. position: (G, 2) of an antenna at `lever_m` (forward, left) of
    the pose, with position_covariance: (G, 2, 2).
    surveyed: (S, 2) positions of the first S landmarks, known beforehand with
    surveyed_covariance: (S, 2, 2). pose_landmarks: measurements of pose landmarks, too.
    loop_closures: motions between poses that do not follow each other.
    """

    prior_pose: Array
    prior_covariance: Array
    increment: Array
    increment_covariance: Array
    measurement_pose: Index
    measurement_landmark: Index
    z: Array
    sigma: Array
    landmark_count: int
    position_pose: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    position: Array = field(default_factory=lambda: np.zeros((0, 2)))
    position_covariance: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    lever_m: tuple[float, float] = (0.0, 0.0)
    surveyed: Array = field(default_factory=lambda: np.zeros((0, 2)))
    surveyed_covariance: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))
    pose_landmarks: PoseLandmarkMeasurements = field(default_factory=PoseLandmarkMeasurements)
    loop_closures: LoopClosures = field(default_factory=LoopClosures)

    @property
    def pose_count(self) -> int:
        """K."""
        return len(self.increment) + 1

    def same_as(self, other: SlamProblem) -> bool:
        """Compare with another problem, number for number; NaN equals itself.

        Args:
            other: The other problem.

        Returns:
            Whether both are equal.
        """
        return _same(self, other)

    @property
    def steps(self) -> Index:
        """(S,) the increments that were measured."""
        return np.flatnonzero(np.isfinite(self.increment_covariance[:, 0, 0]))

    @property
    def seen_landmarks(self) -> Index:
        """Point landmarks that something is known of: measured, or surveyed."""
        return np.union1d(self.measurement_landmark, np.arange(len(self.surveyed)))

    @property
    def open_prior(self) -> bool:
        """The prior says nothing, not even where in a whole turn the vehicle heads."""
        return bool(self.prior_covariance[2, 2] > (2.0 * np.pi) ** 2)

    @property
    def residual_dimension(self) -> int:
        """Scalar measurements, the prior's three included unless it is open."""
        pairs = len(self.z) + len(self.position) + len(self.surveyed)
        seen = self.pose_landmarks
        triples = int(not self.open_prior) + len(self.steps) + len(self.loop_closures.motion)
        triples += len(seen.measured) + len(seen.merges.measured)
        return 3 * triples + 2 * pairs

    @property
    def state_dimension(self) -> int:
        """Scalar unknowns."""
        return Layout(self.pose_count, self.landmark_count, self.pose_landmarks.count).size

    def prefix(self, pose_count: int) -> SlamProblem:
        """Return the problem up to an early pose.

        Args:
            pose_count: How many of the first poses stay.

        Returns:
            A smaller problem; landmarks keep their numbers, also those that are no longer measured.
        """
        seen, closed, merged = self.pose_landmarks, self.loop_closures, self.pose_landmarks.merges
        merges = _some(merged, merged.pose < pose_count)
        return replace(
            self.keep(self.measurement_pose < pose_count, self.position_pose < pose_count),
            increment=self.increment[: pose_count - 1],
            increment_covariance=self.increment_covariance[: pose_count - 1],
            pose_landmarks=replace(_some(seen, seen.pose < pose_count), merges=merges),
            loop_closures=_some(closed, closed.last < pose_count),
        )

    def keep(self, measurements: NDArray[np.bool_], positions: NDArray[np.bool_]) -> SlamProblem:
        """Return the problem with some of its measurements.

        Args:
            measurements: (M,) which measurements of point landmarks stay.
            positions: (G,) which absolute positions stay.

        Returns:
            The same poses and landmarks, fewer measurements.
        """
        return replace(
            self,
            measurement_pose=self.measurement_pose[measurements],
            measurement_landmark=self.measurement_landmark[measurements],
            z=self.z[measurements],
            sigma=self.sigma[measurements],
            position_pose=self.position_pose[positions],
            position=self.position[positions],
            position_covariance=self.position_covariance[positions],
        )


_Columns = TypeVar("_Columns", Merges, PoseLandmarkMeasurements, LoopClosures)


def _some(columns: _Columns, rows: NDArray[np.bool_]) -> _Columns:
    """Some rows of all arrays."""
    every = vars(columns).items()
    some: dict[str, Any] = {k: v[rows] for k, v in every if isinstance(v, np.ndarray)}
    return replace(columns, **some)


def _same(one: Any, other: Any) -> bool:
    if not is_dataclass(one):
        return one is other or np.array_equal(one, other, equal_nan=isinstance(one, np.ndarray))
    return all(_same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
