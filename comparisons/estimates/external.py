"""An estimate from someone else's system: a trajectory, and as much more as there is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.archive import read_arrays
from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate, landmark_blocks
from comparisons.estimates.folder import (
    FILES,
    SCAN_LANDMARKS,
    read_landmarks,
    read_meta,
    read_scan_landmarks,
    read_trajectory,
)
from comparisons.estimates.trace_file import TRACE, TraceFile, read_trace
from comparisons.estimates.trajectory_files import read_with_files
from comparisons.logs.validation import LARGEST

Information = Literal["filtered", "smoothed", "fixed-lag"]
Estimator = Literal["ekf", "smoother", "other"]
_ARRAYS = ("pose", "landmarks", "last_pose_and_landmarks")


@dataclass(frozen=True, kw_only=True)
class ExternalEstimate:
    """What was handed in; None for what was not.

    time_s: (K,). pose: (K, 3) x, y, heading, unwrapped. landmark_id: (L,) and landmark: (L, 2),
    both None without a map. pose_covariance: (K, 3, 3). landmark_covariance: (L, 2, 2).
    joint_covariance: (3 + 2 L, 3 + 2 L) of the last pose and all landmarks. All covariances are
    of the additive global error. information: as of Estimate, None where it was not said.
    estimator: what it calls itself.
    trace: what the filter linearised where.
    sha256: of the files it was read from, by name.
    """

    time_s: Array
    pose: Array
    landmark_id: NDArray[np.int64] | None = None
    landmark: Array | None = None
    pose_covariance: Array | None = None
    landmark_covariance: Array | None = None
    joint_covariance: Array | None = None
    information: Information | None = None
    estimator: Estimator = "other"
    trace: TraceFile | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, estimate: Estimate) -> ExternalEstimate:
        """Return an estimate with all it has, as somebody else would hand it in."""
        return cls(
            time_s=estimate.time_s,
            pose=estimate.pose,
            landmark_id=estimate.landmark_id,
            landmark=estimate.landmark,
            pose_covariance=estimate.pose_covariance,
            landmark_covariance=estimate.landmark_covariances(),
            joint_covariance=estimate.joint_covariance,
            information=estimate.information,
        )

    def padded(self) -> Estimate:
        """Return it as an estimate with all parts: no landmarks, and covariances NaN, if not given.

        The joint covariance is then of the last pose alone, whatever landmarks there are.
        """
        unknown = np.full((len(self.pose), 3, 3), np.nan)
        ids, places = self.landmark_id, self.landmark
        return Estimate(
            time_s=self.time_s,
            pose=self.pose,
            pose_covariance=unknown if self.pose_covariance is None else self.pose_covariance,
            landmark_id=np.zeros(0, dtype=np.int64) if ids is None else ids,
            landmark=np.zeros((0, 2)) if places is None else places,
            joint_covariance=unknown[-1]
            if self.joint_covariance is None
            else self.joint_covariance,
            information=self.information or "filtered",
        )

    def may_be(self, information: Information) -> bool:
        """Whether its poses may know so much of the log; an EKF's know what is past."""
        if self.information is None and self.estimator == "other":
            return information != "fixed-lag"
        default = "smoothed" if self.estimator == "smoother" else "filtered"
        return information == (self.information or default)

    @property
    def absent(self) -> list[str]:
        """What is missing, in words."""
        return [
            words
            for value, words in (
                (self.landmark, "landmarks"),
                (self.pose_covariance, "pose covariances"),
                (self.landmark_covariance, "landmark covariances"),
                (self.joint_covariance, "joint covariance"),
            )
            if value is None
        ]


def read_external(path: Path, times: Path | None = None) -> ExternalEstimate:
    """A trajectory's file, or a folder with `trajectory.tum` and any files of an estimate folder.

    times: of a KITTI file. Raises InputError.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder, expected a trajectory or a folder")
    if path.is_dir():
        if times is not None:
            raise InputError(f"{path}: is a folder; --times is for KITTI files")
        return replace(_read_folder(path), sha256=_hashes(path / name for name in (*FILES, TRACE)))
    (time_s, pose, covariance), files = read_with_files(path, times)
    if not len(pose):
        raise InputError(f"{path}: holds no poses")
    return ExternalEstimate(
        time_s=time_s, pose=pose, pose_covariance=covariance, sha256=_hashes(files)
    )


def _hashes(files: Iterable[Path]) -> dict[str, str]:
    """Of those files that are there, by name."""
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.is_file()
    }


def _read_folder(path: Path) -> ExternalEstimate:
    time_s, pose = read_trajectory(path / "trajectory.tum")
    if not len(pose):
        raise InputError(f"{path / 'trajectory.tum'}: holds no poses")
    information: Information | None = None
    estimator: Estimator = "other"
    if (path / "estimate.toml").exists():
        meta = read_meta(path / "estimate.toml")
        information, estimator = meta.information, meta.estimator
    ids = places = None
    if (path / "landmarks.csv").exists():
        ids, places = read_landmarks(path / "landmarks.csv")
    covariances = _read_covariances(path, len(pose), 0 if places is None else len(places))
    trace = None
    if (path / TRACE).exists():
        if ids is None:
            raise InputError(f"{path / TRACE}: needs landmarks.csv beside it")
        trace = read_trace(path / TRACE, ids)
    return ExternalEstimate(
        time_s=time_s,
        pose=pose,
        landmark_id=ids,
        landmark=places,
        pose_covariance=covariances.pose,
        landmark_covariance=covariances.landmark,
        joint_covariance=covariances.joint,
        information=information,
        estimator=estimator,
        trace=trace,
    )


class _Covariances(NamedTuple):
    """Of poses (K, 3, 3), landmarks (L, 2, 2), and the last pose and them (3 + 2 L, 3 + 2 L)."""

    pose: Array | None
    landmark: Array | None
    joint: Array | None


def _read_covariances(path: Path, poses: int, landmarks: int) -> _Covariances:
    """Whichever a folder's `covariances.npz` has; the landmarks' own from the joint one."""
    points = 3 + 2 * landmarks
    size = points + 3 * len(read_scan_landmarks(path / SCAN_LANDMARKS)[0])
    shapes = {
        "pose": (poses, 3, 3),
        "landmarks": (landmarks, 2, 2),
        "last_pose_and_landmarks": (size, size),
    }
    found: dict[str, Array] = {}
    archive = path / "covariances.npz"
    if archive.exists():
        found = read_arrays(archive, _ARRAYS)
        for name, array in found.items():
            _check_covariance(f"{archive}: {name}", array, shapes[name])
    joint = found.get("last_pose_and_landmarks")
    if joint is not None:
        joint = joint[:points, :points]  # what is told of scan landmarks has nothing to be held by
    own = found.get("landmarks")
    if own is None and joint is not None and landmarks:
        own = landmark_blocks(joint)
    return _Covariances(found.get("pose"), own, joint)


def _check_covariance(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, expected {shape}")
    if not (finite := np.isfinite(array)).all():
        row, *_ = np.argwhere(~finite)[0].tolist()
        raise InputError(f"{name}[{row}] holds a value that is not a finite number")
    if (np.abs(array) > LARGEST**2).any():
        raise InputError(f"{name} holds a value beyond {LARGEST**2:g}, expected a covariance")
