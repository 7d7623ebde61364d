"""An estimate on disk: TUM trajectory, landmarks.csv, covariances.npz, estimate.toml."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from comparisons.archive import read_archive
from comparisons.errors import InputError
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import Table, read_text
from comparisons.logs.validation import increasing, whole_numbers, within
from comparisons.runs.estimate import Array, Estimate

FILES = ("trajectory.tum", "landmarks.csv", "covariances.npz", "estimate.toml")
"""What an estimate folder holds."""

_TUM = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
_LANDMARKS = ("id", "x_m", "y_m")


class _Meta(BaseModel):
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
    path = folder / "estimate.toml"
    try:
        meta = _Meta.model_validate(tomllib.loads(read_text(path)))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    tum = Table(folder / "trajectory.tum", _TUM)
    table = Table(folder / "landmarks.csv", _LANDMARKS, comma=True, header=True)
    with tum.locating():
        increasing("trajectory", tum["time_s"])
        norm = np.linalg.norm(tum.data[:, 4:], axis=1)
        within("trajectory", "quaternion's norm", norm, 0.99, 1.01)
    heading = np.unwrap(2.0 * np.arctan2(tum["qz"], tum["qw"]))
    archive_path = folder / "covariances.npz"
    pose, joint = read_archive(archive_path, ("pose", "last_pose_and_landmarks"))
    with table.locating():
        ids = whole_numbers("landmarks", "id", table["id"])
    size = 3 + 2 * len(table)
    if pose.shape != (len(tum), 3, 3) or joint.shape != (size, size):
        raise InputError(
            f"{archive_path}: shapes {pose.shape} and {joint.shape}, expected "
            f"{(len(tum), 3, 3)} and {(size, size)}"
        )
    if not (np.isfinite(pose).all() and np.isfinite(joint).all()):
        raise InputError(f"{archive_path}: holds a value that is not a finite number")
    return Estimate(
        tum["time_s"],
        np.column_stack((tum["x"], tum["y"], heading)),
        pose,
        ids,
        table.data[:, 1:],
        joint,
        meta.information,
        meta.provenance,
    )
