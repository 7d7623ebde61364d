"""An estimate on disk: trajectory, landmarks, covariances, estimate.toml (docs/formats.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from comparisons.archive import read_archive
from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log_meta import first_fault, toml_text
from comparisons.logs.schema import LANDMARKS
from comparisons.logs.stamps import Nanoseconds
from comparisons.logs.table import TextTable, is_number, is_record, read_text, read_toml
from comparisons.logs.validation import LARGEST, distinct, increasing, whole_numbers, within
from ekf_reference.core.layout import Layout

SCAN_LANDMARKS = "scan_landmarks.csv"
FILES = ("trajectory.tum", "landmarks.csv", SCAN_LANDMARKS, "covariances.npz", "estimate.toml")
"""What an estimate folder holds; scan landmarks only where there are any."""

_LEAST_UP = 0.5
"""Of a planar pose's third axis, upwards."""
TUM = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw")
_ALONG = 0.5
"""Share of the way that a vehicle in the plane x, y may move along its third axis."""
_LANDMARKS = LANDMARKS.needed
_POSE_LANDMARKS = (*_LANDMARKS, "heading_rad")


class Meta(BaseModel):
    """`estimate.toml`."""

    model_config = ConfigDict(extra="forbid")
    version: Literal[1] = 1
    information: Literal["filtered", "smoothed", "fixed-lag"]
    estimator: Literal["ekf", "smoother", "other"] = "other"
    provenance: dict[str, str] = {}


def write_estimate(estimate: Estimate, folder: str | Path) -> None:
    """Write an estimate folder: trajectory, landmarks, covariances and what they are of.

    Args:
        estimate: What to write; numbers come back to the bit, headings up to rounding.
        folder: New or empty; made where it does not exist.

    Raises:
        InputError: The folder cannot be made.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    (folder / "trajectory.tum").write_text(
        tum_text(estimate.time_s, estimate.pose), encoding="utf-8"
    )
    rows = zip(map(_quoted, estimate.names), estimate.landmark.tolist(), strict=True)
    (folder / "landmarks.csv").write_text(
        ",".join(_LANDMARKS) + "\n" + "".join(f"{i},{x!r},{y!r}\n" for i, (x, y) in rows),
        encoding="utf-8",
    )
    if len(estimate.pose_landmark_id):
        rows = zip(
            estimate.pose_landmark_id.tolist(), estimate.pose_landmarks.tolist(), strict=True
        )
        lines = [",".join(_POSE_LANDMARKS), *(",".join(map(repr, (i, *at))) for i, at in rows)]
        (folder / SCAN_LANDMARKS).write_text("\n".join(lines) + "\n", encoding="utf-8")
    np.savez_compressed(
        folder / "covariances.npz",
        pose=estimate.pose_covariance,
        last_pose_and_landmarks=estimate.joint_covariance,
    )
    lines = ["version = 1", f"information = {toml_text(estimate.information)}", "", "[provenance]"]
    lines += [f"{toml_text(k)} = {toml_text(v)}" for k, v in estimate.provenance.items()]
    (folder / "estimate.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def tum_text(time_s: Array, pose: Array) -> str:
    """A trajectory as TUM lines, from times (K,) and planar poses (K, 3)."""
    half = 0.5 * pose[:, 2]
    rows = np.column_stack((time_s, pose[:, :2], np.sin(half), np.cos(half))).tolist()
    return "".join([f"{t!r} {x!r} {y!r} 0.0 0.0 0.0 {z!r} {w!r}\n" for t, x, y, z, w in rows])


def read_estimate(folder: Path) -> Estimate:
    """Read a folder. Headings are unwrapped from pose to pose. Raises InputError."""
    meta = read_meta(folder / "estimate.toml")
    time_s, poses, _ = read_trajectory(folder / "trajectory.tum")
    archive_path = folder / "covariances.npz"
    ids, landmark, labels = read_landmarks(folder / "landmarks.csv")
    pose_landmark_id, pose_landmarks = read_scan_landmarks(folder / SCAN_LANDMARKS)
    size = Layout.packed(3, len(ids), len(pose_landmark_id)).size
    pose, joint = read_archive(
        archive_path, {"pose": (len(poses), 3, 3), "last_pose_and_landmarks": (size, size)}
    )
    if not (np.isfinite(pose).all() and np.isfinite(joint).all()):
        raise InputError(f"{archive_path}: holds a value that is not a finite number")
    return Estimate(
        time_s=time_s,
        pose=poses,
        pose_covariance=pose,
        landmark_id=ids,
        landmark=landmark,
        joint_covariance=joint,
        information=meta.information,
        provenance=meta.provenance,
        pose_landmark_id=pose_landmark_id,
        pose_landmarks=pose_landmarks,
        labels=labels,
    )


def read_meta(path: Path) -> Meta:
    """`estimate.toml`. Raises InputError."""
    try:
        return Meta.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None


def read_trajectory(path: Path) -> tuple[Array, Array, Nanoseconds | None]:
    """Times (K,) and planar poses (K, 3) of a TUM file, headings unwrapped, and its exact times.

    The last are None where float64 has nanoseconds of them. Raises InputError.
    """
    tum = TextTable(path, TUM)
    with tum.locating():
        increasing("trajectory", tum["time_s"])
        within("trajectory", "time_s", tum["time_s"], -LARGEST, LARGEST)
    return tum["time_s"], planar_poses(tum, "w last"), tum.nanoseconds("time_s")


def planar_poses(table: TextTable, order: str) -> Array:
    """Poses (K, 3) of positions x, y, z and quaternions qx, qy, qz, qw. Raises InputError.

    order: in which the quaternion's numbers stand, for errors.
    """
    x, y, z, w = (table[f"q{axis}"] for axis in "xyzw")
    up = np.column_stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x**2 + y**2)))
    in_plane(table, np.column_stack([table[axis] for axis in "xyz"]), up)
    _check_order(table, up[:, 2], order)
    with table.locating():
        within("trajectory", "quaternion's norm", np.sqrt(x**2 + y**2 + z**2 + w**2), 0.99, 1.01)
        name = f"cosine of the tilt (of qx, qy, qz, qw, {order})"
        within("trajectory", name, up[:, 2], _LEAST_UP, 1.01)
    return np.column_stack((table["x"], table["y"], np.unwrap(2.0 * np.arctan2(z, w))))


def _check_order(table: TextTable, up: Array, order: str) -> None:
    """Raise InputError for quaternions that are planar if their numbers stand in the other order.

    up: (K,) of the poses' third axes, by the order in which they were read.
    """
    x, y, z, w = (table[f"q{axis}"] for axis in "xyzw")
    first, second = (y, z) if order == "w last" else (w, x)
    if (up >= _LEAST_UP).all() or (1.0 - 2.0 * (first**2 + second**2) < _LEAST_UP).any():
        return
    if order == "w last":
        move = "awk '{print $1, $2, $3, $4, $6, $7, $8, $5}' OLD > NEW"
        raise InputError(
            f"{table.path}: its quaternions look like w x y z, expected x y z w as in every TUM "
            f"file; w last: {move}"
        )
    raise InputError(f"{table.path}: its quaternions look like x y z w, expected w x y z")


def in_plane(table: TextTable, place: Array, up: Array) -> None:
    """Check that positions (K, 3) are finite and do not move along their third axes up (K, 3).

    Raises InputError.
    """
    with table.locating():
        for axis, column in zip("xyz", place.T, strict=True):
            within("trajectory", axis, column, -LARGEST, LARGEST)
    moves = np.diff(place, axis=0)
    way, along = np.linalg.norm(moves, axis=1).sum(), np.abs((moves * up[:-1]).sum(axis=1)).sum()
    if along > _ALONG * way:
        raise InputError(
            f"{table.path}: {along:.4g} of {way:.4g} m lie along the poses' third axis, as in a "
            "camera's frame (x right, y down, z ahead), expected poses with x ahead, y left, z up; "
            "replace each 4 x 4 matrix T by C T C^-1, C being 0 0 1 0 / -1 0 0 0 / 0 -1 0 0 / "
            "0 0 0 1"
        )


def read_landmarks(path: Path) -> tuple[NDArray[np.int64], Array, dict[int, str]]:
    """Read ids (L,), places (L, 2) and names by id of a `landmarks.csv`.

    Where any name is text, all are, and ids are by their order; else there are none. Raises
    InputError.
    """
    header, *lines = read_text(path).splitlines() or [""]
    words = [line.partition(",")[0] for line in lines if is_record(line)]
    numbers = all(is_number(word) for word in words if word.strip())
    if numbers or header.strip().split(",") != list(_LANDMARKS):
        return *_read_ids(path), {}
    from comparisons.logs.plain_csv import read_plain

    table = read_plain(path, _LANDMARKS)
    words = table.columns["id"].tolist()
    place = np.column_stack((table.columns["x_m"], table.columns["y_m"]))
    seen = {""}
    for row, word in enumerate(words):
        if word in seen:
            fault = f"'{shorten(word)}' appears twice" if word else "is empty"
            raise InputError(f"{path}:{table.line[row]}: id {fault}, expected each id once")
        seen.add(word)
    if not (np.abs(place) <= LARGEST).all():
        row = int(np.argwhere(~(np.abs(place) <= LARGEST))[0][0])
        raise InputError(f"{path}:{table.line[row]}: expected at most {LARGEST:g} m")
    return np.arange(len(words)), place, dict(enumerate(words))


def _read_ids(path: Path) -> tuple[NDArray[np.int64], Array]:
    try:
        return _read_table(path, "landmarks", _LANDMARKS)
    except InputError as error:
        if ": id is " not in str(error):
            raise
        reported = "by which the log's measurements.csv names the landmark (labels: in log.toml)"
        raise InputError(f"{error} {reported}") from None


def _quoted(name: str) -> str:
    """A name as CSV has it."""
    plain = not any(one in name for one in ',"#')
    return name if plain else '"' + name.replace('"', '""') + '"'


def read_scan_landmarks(path: Path) -> tuple[NDArray[np.int64], Array]:
    """Ids (Q,) and x, y, heading (Q, 3) of a `scan_landmarks.csv`, none without one.

    Raises InputError.
    """
    if not path.exists():
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    return _read_table(path, "scan_landmarks", _POSE_LANDMARKS)


def _read_table(path: Path, name: str, columns: tuple[str, ...]) -> tuple[NDArray[np.int64], Array]:
    table = TextTable(path, columns, comma=True, header=True)
    with table.locating():
        ids = whole_numbers(name, "id", table["id"])
        distinct(name, ids)
        for column in ("x_m", "y_m"):
            within(name, column, table[column], -LARGEST, LARGEST)
    return ids, table.data[:, 1:]
