"""Clouds of points as PCD and PLY files, by Open3D.

PLY holds double precision and gives every bit back. PCD holds what the format's programs expect,
single precision: 24 bits of each coordinate, 4 micrometres at 50 m.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphslam.scan.open3d_library import open3d

Array = NDArray[np.float64]

SUFFIXES = (".pcd", ".ply")

_LONGEST_HEADER = 2**16
_PLY_BYTES = {
    **dict.fromkeys((b"char", b"uchar", b"int8", b"uint8"), 1),
    **dict.fromkeys((b"short", b"ushort", b"int16", b"uint16"), 2),
    **dict.fromkeys((b"int", b"uint", b"float", b"int32", b"uint32", b"float32"), 4),
    **dict.fromkeys((b"double", b"float64"), 8),
}


class CloudError(ValueError):
    """A file of points that cannot be written or read. The message, one line, says why."""


def write_cloud(path: Path, points: Array) -> None:
    """Write points (N, 3) [m] in binary, as the path's suffix says; whole or not at all.

    Raises CloudError, and Open3dMissingError where Open3D cannot be loaded.
    """
    suffix = _suffix(path)
    cloud = np.ascontiguousarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not len(cloud):
        raise CloudError(f"{path}: points have shape {cloud.shape}, expected (N, 3), N at least 1")
    if not np.isfinite(cloud).all():
        raise CloudError(f"{path}: the points hold values that are not finite")
    if suffix == ".pcd" and np.abs(cloud).max() > np.finfo(np.float32).max:
        raise CloudError(f"{path}: the points are too far away for single precision")
    library = open3d()
    if path.is_dir():
        raise CloudError(f"{path}: is a folder, expected a file to write")
    try:
        with tempfile.TemporaryDirectory(prefix=".cloud-", dir=path.parent) as folder:
            work = Path(folder) / f"cloud{suffix}"
            written = library.io.write_point_cloud(
                str(work), library.geometry.PointCloud(library.utility.Vector3dVector(cloud))
            )
            if not written:
                raise CloudError(f"{path}: cannot be written")
            work.replace(path)
    except OSError as error:
        raise CloudError(f"{path}: cannot be written ({error.strerror or error})") from None


def read_cloud(path: Path) -> Array:
    """(N, 3) points [m] of a file, rows that are no numbers among them.

    Raises CloudError, and Open3dMissingError where Open3D cannot be loaded.
    """
    _suffix(path)
    library = open3d()
    try:
        with path.open("rb") as file:
            stated = _stated_points(path, file.read(_LONGEST_HEADER))
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror or error})") from None
    cloud = library.io.read_point_cloud(
        str(path), remove_nan_points=False, remove_infinite_points=False
    )
    points = np.array(cloud.points)
    if len(points) != stated or not len(points):
        raise CloudError(f"{path}: {len(points)} of {stated} points could be read")
    return points


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise CloudError(f"{path}: expected a name ending in {' or '.join(SUFFIXES)}")
    return suffix


def _stated_points(path: Path, head: bytes) -> int:
    """The header's own count of points.

    Of a damaged file Open3D returns what it could read, zeros for the rest of a PLY, and sets
    memory aside for as many points as are stated; so a PLY's size is checked before.
    """
    ply = path.suffix.lower() == ".ply"
    key = [b"element", b"vertex"] if ply else [b"POINTS"]
    header = head.partition(b"end_header")[0] if ply else head
    lines = [line.split() for line in header.splitlines()]
    for row, word in enumerate(lines):
        if word[:-1] == key and word[-1].isdigit():
            count = int(word[-1])
            if ply and path.stat().st_size < len(header) + count * _row_bytes(lines, row + 1):
                raise CloudError(f"{path}: ends before the {count} points that it states")
            return count
    raise CloudError(f"{path}: has no header that counts its points")


def _row_bytes(lines: list[list[bytes]], begin: int) -> int:
    """The least size of a point: as its properties say in binary, digits and blanks in text."""
    size = 0
    for word in lines[begin:]:
        if word[:1] != [b"property"]:
            break
        size += _PLY_BYTES.get(word[1], 1) if len(word) == 3 else 1
    text = any(word[:2] == [b"format", b"ascii"] for word in lines)
    return 6 if text else size
