"""An estimate from someone else's system: a trajectory, and as much more as there is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.archive import Shape, read_arrays
from comparisons.arrays import Array
from comparisons.errors import InputError, quoted, shorten
from comparisons.estimates.estimate import Estimate, landmark_blocks
from comparisons.estimates.folder import (
    FILES,
    SCAN_LANDMARKS,
    read_landmarks,
    read_meta,
    read_scan_landmarks,
    read_trajectory,
)
from comparisons.estimates.landmark_names import LandmarkNames, is_whole
from comparisons.estimates.planar_trace import OUTDATED_TRACE, TRACE, TraceFile, read_trace
from comparisons.estimates.trajectory_files import read_with_files
from comparisons.logs.readers.ros_bag import recognise_bag
from comparisons.logs.stamps import Nanoseconds
from comparisons.logs.validation import LARGEST
from comparisons.shown import Brief
from ekf_reference.core.layout import Layout

Information = Literal["filtered", "smoothed", "fixed-lag"]
Estimator = Literal["ekf", "smoother", "other"]

_NAMED = 4
"""Landmarks that a sentence names."""


class Removed(NamedTuple):
    """Landmarks that a filter has removed from its map, by id (D,), and in words."""

    landmark_id: tuple[int, ...]
    words: str


@dataclass(frozen=True, kw_only=True, repr=False)
class ExternalEstimate(Brief):
    """Hold an external estimate, with None for whatever was not handed in.

    Sequences in place of arrays will do: `slamcheck.check` converts and checks them. All
    covariances are of the additive global error (x, y, heading).

    Attributes:
        time_s: (K,) of the poses, increasing, on the log's clock.
        pose: (K, 3) x, y [m], heading [rad], unwrapped, in the log's frame.
        landmark_id: (L,) whole numbers, by the log's labels where it has them; None without a map.
        landmark: (L, 2) x, y [m]; None without a map.
        pose_covariance: (K, 3, 3) of each pose alone.
        landmark_covariance: (L, 2, 2) of each landmark alone.
        joint_covariance: (3 + 2 L, 3 + 2 L) of the last pose and all landmarks.
        information: What the poses know of the log, as of `Estimate`; None where it was not stated.
        estimator: What made it: `ekf`, `smoother` or `other`.
        trace: Where the filter linearised, for its algebra and model gaps.
        sha256: Of the files that it was read from, by name.
        left_out: Which poses or covariances of its file were not read, and why; empty where all
            were.
        source: What it was read from, where its file holds several estimates.
        labels: Names of landmarks by id, as its file spells them; none where arrays have ids.
        time_ns: (K,) the times exactly as its file has them, in whole nanoseconds; None where
            `time_s` tells as much, as float64 does not of seconds since 1970.
        removed: Landmarks that its filter has removed; None where nothing shows any.
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
    left_out: str = ""
    source: str = ""
    labels: Mapping[int, str] = field(default_factory=dict)
    time_ns: Nanoseconds | None = None
    removed: Removed | None = None

    def numbered_as(self, labels: Mapping[int, str]) -> ExternalEstimate:
        """Return it with the ids that a log has for its landmarks, in the map and in the trace.

        Args:
            labels: Of the log: names by id; none where it has numbers alone.

        Returns:
            The same where there are no landmarks. Names that the log lacks get further ids.

        Raises:
            InputError: The log names landmarks by numbers and the estimate does not, or a block of
                the trace is none of the estimate's landmarks.
        """
        if self.landmark_id is None:
            return self
        ids = self.landmark_id.tolist()
        words = [self.labels.get(number, str(number)) for number in ids]
        text = next((word for word in words if not is_whole(word)), None)
        if text is not None and not labels:
            raise InputError(
                f"the estimate names landmarks by text ({quoted(text)}), the log by numbers; "
                "use the numbers of the log's measurements.csv"
            )
        names = LandmarkNames(labels, words if self.labels else ids)
        trace = None if self.trace is None else self.trace.placed(names)
        gone = [] if trace is None else sorted(set(trace.removed_id) - set(names.numbers))
        said = f"which its filter removed, {_listed([labels.get(n, str(n)) for n in gone])}"
        return replace(
            self,
            landmark_id=np.array(names.numbers, dtype=np.int64),
            labels=dict(zip(names.numbers, words, strict=True)) if names.are_labels else {},
            trace=trace,
            removed=Removed(tuple(gone), said) if gone else self.removed,
        )

    @classmethod
    def of(cls, estimate: Estimate) -> ExternalEstimate:
        """Return an estimate with all it has, as somebody else would hand it in.

        Args:
            estimate: Of this project's estimators, or built from arrays. Pose landmarks are left
                out.

        Returns:
            The same poses, landmarks and covariances; what made them is not stated.
        """
        return cls(
            time_s=estimate.time_s,
            pose=estimate.pose,
            landmark_id=estimate.landmark_id,
            landmark=estimate.landmark,
            pose_covariance=estimate.pose_covariance,
            landmark_covariance=estimate.landmark_covariances(),
            joint_covariance=estimate.joint_covariance,
            information=estimate.information,
            labels=estimate.labels,
        )

    def validated(self) -> ExternalEstimate:
        """Return the same with float64 arrays, once their shapes and values are checked.

        Returns:
            A copy whose arrays are arrays, whatever sequences were given.

        Raises:
            InputError: An array has another shape than expected or holds no finite number, times
                do not increase, or only one of `landmark` and `landmark_id` is given.
        """
        time_s = _numbers("time_s", self.time_s, (-1,))
        if not len(time_s) or not (np.diff(time_s) > 0.0).all():
            raise InputError("estimate: time_s must hold at least one time, in increasing order")
        if (self.landmark is None) != (self.landmark_id is None):
            raise InputError("estimate: give landmark and landmark_id both, or neither")
        count = 0 if self.landmark is None else len(self.landmark)
        state = Layout.packed(3, count).size
        shapes = {
            "pose": (len(time_s), 3),
            "pose_covariance": (len(time_s), 3, 3),
            "landmark_id": (count,),
            "landmark": (count, 2),
            "landmark_covariance": (count, 2, 2),
            "joint_covariance": (state, state),
        }
        found: dict[str, Any] = {
            name: _numbers(name, value, shape)
            for name, shape in shapes.items()
            if (value := getattr(self, name)) is not None
        }
        if (ids := found.get("landmark_id")) is not None:
            found["landmark_id"] = ids.astype(np.int64)
            if (found["landmark_id"] != ids).any() or len(np.unique(ids)) < count:
                raise InputError("estimate: landmark_id must hold whole numbers, each once")
        if self.landmark_covariance is None and "joint_covariance" in found and count:
            found["landmark_covariance"] = landmark_blocks(found["joint_covariance"])
        return replace(self, time_s=time_s, **found)

    def padded(self) -> Estimate:
        """Return it as an estimate with all parts: no landmarks, and covariances NaN, if not given.

        Returns:
            An estimate; its joint covariance is of the last pose alone where none was given,
            whatever landmarks there are.
        """
        unknown = np.full((len(self.pose), 3, 3), np.nan)
        ids, places, joint = self.landmark_id, self.landmark, self.joint_covariance
        return Estimate(
            time_s=self.time_s,
            pose=self.pose,
            pose_covariance=unknown if self.pose_covariance is None else self.pose_covariance,
            landmark_id=np.zeros(0, dtype=np.int64) if ids is None else ids,
            landmark=np.zeros((0, 2)) if places is None else places,
            joint_covariance=unknown[-1] if joint is None else joint,
            information=self.information or "filtered",
            labels=self.labels,
        )

    def may_be(self, information: Information) -> bool:
        """Return whether its poses may know so much of the log; an EKF's know what is past.

        Args:
            information: `filtered`, `smoothed` or `fixed-lag`.

        Returns:
            True where the estimate says so, or where it says nothing and its kind allows it.
        """
        if self.information is None and self.estimator == "other":
            return information != "fixed-lag"
        default = "smoothed" if self.estimator == "smoother" else "filtered"
        return information == (self.information or default)

    @property
    def absent(self) -> list[str]:
        """What is missing, in words."""
        named = {
            "landmark": "landmarks",
            "pose_covariance": "pose covariances",
            "landmark_covariance": "landmark covariances",
            "joint_covariance": "joint covariance",
        }
        return [words for name, words in named.items() if getattr(self, name) is None]


def with_poses(given: ExternalEstimate, rows: NDArray[np.bool_]) -> ExternalEstimate:
    """Return an estimate with some of its poses (K,) alone."""
    cover = None if given.pose_covariance is None else given.pose_covariance[rows]
    exact = None if given.time_ns is None else given.time_ns[rows]
    time_s, pose = given.time_s[rows], given.pose[rows]
    return replace(given, time_s=time_s, pose=pose, pose_covariance=cover, time_ns=exact)


def read_external(
    path: str | Path,
    times: str | Path | None = None,
    trace: str | Path | None = None,
    topics: Sequence[str] = (),
) -> ExternalEstimate:
    """Read a trajectory file, or a folder with `trajectory.tum` and more of an estimate folder.

    Args:
        path: A TUM, KITTI or CSV trajectory, a folder, or a ROS bag (docs/formats.md).
        times: The file with the times of a KITTI trajectory; `times.txt` beside it by default.
        trace: What the filter did, as `Recorder` writes it; by default the folder's `filter.trace`.
        topics: Of a bag, the topic that holds the estimate; by default the only one of poses.

    Returns:
        Everything that is there: headings unwrapped, covariances of the additive global error.

    Raises:
        InputError: A file is missing, unreadable, or not of the form it should have.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder, expected a trajectory or a folder")
    if recognise_bag(path) is not None:
        return _read_bag(path, times, trace, topics)
    if path.is_dir():
        if times is not None:
            raise InputError(f"{path}: is a folder; --times is for KITTI files")
        found = (path / name for name in (TRACE, OUTDATED_TRACE) if (path / name).exists())
        chosen = next(found, None) if trace is None else Path(trace)
        own = [path / name for name in FILES] + ([] if chosen is None else [chosen])
        return replace(_read_folder(path, chosen), sha256=_hashes(own))
    if trace is not None:
        raise InputError(f"{path}: is no folder; --trace needs one, with landmarks.csv")
    trajectory, files = read_with_files(path, None if times is None else Path(times))
    if not len(trajectory.pose):
        raise InputError(f"{path}: holds no poses")
    return ExternalEstimate(
        time_s=trajectory.time_s,
        pose=trajectory.pose,
        pose_covariance=trajectory.covariance,
        sha256=_hashes(files),
        left_out=trajectory.left_out,
        time_ns=trajectory.time_ns,
    )


def _listed(names: list[str]) -> str:
    """Return the first of some names, and how many there are."""
    more = f", ... ({len(names)} in all)" if len(names) > _NAMED else ""
    return ", ".join(shorten(name) for name in names[:_NAMED]) + more


def _read_bag(
    path: Path, times: str | Path | None, trace: str | Path | None, topics: Sequence[str]
) -> ExternalEstimate:
    from comparisons.estimates.bag_estimate import read_bag_estimate

    for option, value in (("--times", times), ("--trace", trace)):
        if value is not None:
            raise InputError(f"{path}: is a ROS bag, which {option} does not go with")
    estimate = read_bag_estimate(path, topics)
    return ExternalEstimate(
        time_s=estimate.time_ns / 1e9,
        time_ns=estimate.time_ns,
        pose=estimate.pose,
        pose_covariance=estimate.covariance,
        sha256=_hashes(sorted(path.iterdir()) if path.is_dir() else [path]),
        left_out=estimate.left_out,
        source=estimate.source,
    )


def _numbers(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """An array of finite float64 of a shape, -1 for any length. Raises InputError."""
    try:
        found = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"estimate: {name} must hold numbers, of shape {shape}") from None
    if found.ndim != len(shape) or shape not in (found.shape, (-1,)):
        raise InputError(f"estimate: {name} has shape {found.shape}, expected {shape}")
    if not (usable := np.abs(found) <= LARGEST**2).all():
        row = int(np.argwhere(~usable)[0][0])
        raise InputError(f"estimate: {name}[{row}] holds a value that is not a finite number")
    return found


def _hashes(files: Iterable[Path]) -> dict[str, str]:
    """Of those files that are there, by name."""
    return {
        file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files if file.is_file()
    }


def _read_folder(path: Path, trace: Path | None) -> ExternalEstimate:
    time_s, pose, time_ns = read_trajectory(path / "trajectory.tum")
    if not len(pose):
        raise InputError(f"{path / 'trajectory.tum'}: holds no poses")
    information: Information | None = None
    estimator: Estimator = "other"
    if (path / "estimate.toml").exists():
        meta = read_meta(path / "estimate.toml")
        information, estimator = meta.information, meta.estimator
    ids = places = None
    labels: Mapping[int, str] = {}
    if (path / "landmarks.csv").exists():
        ids, places, labels = read_landmarks(path / "landmarks.csv")
        labels = labels or {number: str(number) for number in ids.tolist()}
    covariances = _read_covariances(path, len(pose), 0 if places is None else len(places))
    if trace is not None and ids is None:
        raise InputError(f"{trace}: needs landmarks.csv beside the trajectory")
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
        trace=None if trace is None else read_trace(trace),
        labels=labels,
        time_ns=time_ns,
    )


class _Covariances(NamedTuple):
    """Of poses (K, 3, 3), landmarks (L, 2, 2), and the last pose and them (3 + 2 L, 3 + 2 L)."""

    pose: Array | None
    landmark: Array | None
    joint: Array | None


def _read_covariances(path: Path, poses: int, landmarks: int) -> _Covariances:
    """Whichever a folder's `covariances.npz` has; the landmarks' own from the joint one."""
    points = Layout.packed(3, landmarks).size
    size = Layout.packed(3, landmarks, len(read_scan_landmarks(path / SCAN_LANDMARKS)[0])).size
    shapes: dict[str, Shape] = {
        "pose": (poses, 3, 3),
        "landmarks": (landmarks, 2, 2),
        "last_pose_and_landmarks": (size, size),
    }
    found: dict[str, Array] = {}
    archive = path / "covariances.npz"
    if archive.exists():
        found = read_arrays(archive, shapes)
        for name, array in found.items():
            _check_covariance(f"{archive}: {name}", array)
    joint = found.get("last_pose_and_landmarks")
    if joint is not None:
        joint = joint[:points, :points]  # scan landmarks have nothing to be compared with
    own = found.get("landmarks")
    if own is None and joint is not None and landmarks:
        own = landmark_blocks(joint)
    return _Covariances(found.get("pose"), own, joint)


def _check_covariance(name: str, array: Array) -> None:
    if not (finite := np.isfinite(array)).all():
        row, *_ = np.argwhere(~finite)[0].tolist()
        raise InputError(f"{name}[{row}] holds a value that is not a finite number")
    if (np.abs(array) > LARGEST**2).any():
        raise InputError(f"{name} holds a value beyond {LARGEST**2:g}, expected a covariance")
