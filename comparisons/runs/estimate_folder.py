"""An estimate on disk: TUM trajectory, landmarks.csv, covariances.npz, estimate.toml."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from comparisons.archive import read_archive
from comparisons.errors import InputError
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import Table, read_text
from comparisons.logs.validation import LARGEST, distinct, increasing, whole_numbers, within
from comparisons.runs.estimate import Array, Estimate

FILES = ("trajectory.tum", "landmarks.csv", "covariances.npz", "estimate.toml")
"""What an estimate folder holds."""

_TUM = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
_LANDMARKS = ("id", "x_m", "y_m")


class Meta(BaseModel):
    """`estimate.toml`."""

    model_config = ConfigDict(extra="forbid")
    version: Literal[1]
    information: Literal["filtered", "smoothed", "fixed-lag"]
    provenance: dict[str, str] = {}


def write_estimate(estimate: Estimate, folder: Path) -> None:
    """Write into a folder that exists and is empty."""
    (folder / "trajectory.tum").write_text(
        tum_text(estimate.time_s, estimate.pose), encoding="utf-8"
    )
    rows = zip(estimate.landmark_id.tolist(), estimate.landmark.tolist(), strict=True)
    (folder / "landmarks.csv").write_text(
        ",".join(_LANDMARKS) + "\n" + "".join(f"{i},{x!r},{y!r}\n" for i, (x, y) in rows),
        encoding="utf-8",
    )
    np.savez_compressed(
        folder / "covariances.npz",
        pose=estimate.pose_covariance,
        last_pose_and_landmarks=estimate.joint_covariance,
    )
    lines = ["version = 1", f"information = {json.dumps(estimate.information)}", "", "[provenance]"]
    lines += [
        f"{json.dumps(k, ensure_ascii=False)} = {json.dumps(v, ensure_ascii=False)}"
        for k, v in estimate.provenance.items()
    ]
    (folder / "estimate.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def tum_text(time_s: Array, pose: Array) -> str:
    """A trajectory as TUM lines, from times (K,) and planar poses (K, 3)."""
    half = 0.5 * pose[:, 2]
    flat = np.zeros((len(half), 3))
    rows = np.column_stack((time_s, pose[:, :2], flat, np.sin(half), np.cos(half)))
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def read_estimate(folder: Path) -> Estimate:
    """Read a folder. Headings are unwrapped from pose to pose. Raises InputError."""
    meta = read_meta(folder / "estimate.toml")
    time_s, poses = read_trajectory(folder / "trajectory.tum")
    archive_path = folder / "covariances.npz"
    pose, joint = read_archive(archive_path, ("pose", "last_pose_and_landmarks"))
    ids, landmark = read_landmarks(folder / "landmarks.csv")
    size = 3 + 2 * len(ids)
    if pose.shape != (len(poses), 3, 3) or joint.shape != (size, size):
        raise InputError(
            f"{archive_path}: shapes {pose.shape} and {joint.shape}, expected "
            f"{(len(poses), 3, 3)} and {(size, size)}"
        )
    if not (np.isfinite(pose).all() and np.isfinite(joint).all()):
        raise InputError(f"{archive_path}: holds a value that is not a finite number")
    return Estimate(time_s, poses, pose, ids, landmark, joint, meta.information, meta.provenance)


def read_meta(path: Path) -> Meta:
    """`estimate.toml`. Raises InputError."""
    try:
        return Meta.model_validate(tomllib.loads(read_text(path)))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None
    except (ValueError, RecursionError) as error:  # TOMLDecodeError is a ValueError
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not valid TOML: {error}") from None


def read_trajectory(path: Path) -> tuple[Array, Array]:
    """Times (K,) and planar poses (K, 3) of a TUM file, headings unwrapped. Raises InputError."""
    tum = Table(path, _TUM)
    with tum.locating():
        for name in ("time_s", "x", "y"):
            within("trajectory", name, tum[name], -LARGEST, LARGEST)
        increasing("trajectory", tum["time_s"])
        norm = np.linalg.norm(tum.data[:, 4:], axis=1)
        within("trajectory", "quaternion's norm", norm, 0.99, 1.01)
    heading = np.unwrap(2.0 * np.arctan2(tum["qz"], tum["qw"]))
    return tum["time_s"], np.column_stack((tum["x"], tum["y"], heading))


def read_landmarks(path: Path) -> tuple[NDArray[np.int64], Array]:
    """Ids (L,) and places (L, 2) of a `landmarks.csv`. Raises InputError."""
    table = Table(path, _LANDMARKS, comma=True, header=True)
    with table.locating():
        ids = whole_numbers("landmarks", "id", table["id"])
        distinct("landmarks", ids)
        for name in ("x_m", "y_m"):
            within("landmarks", name, table[name], -LARGEST, LARGEST)
    return ids, table.data[:, 1:]
