"""Clouds of points as PCD and PLY files, by Open3D.

PLY holds double precision and gives every bit back. PCD holds what the format's programs expect,
single precision: 24 bits of each coordinate, 4 micrometres at 50 m.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from graphslam.arrays import Array
from graphslam.scan.libraries import open3d

SUFFIXES = (".pcd", ".ply")

_LONGEST_HEADER = 2**16
_TEXT_ROW = 6
"""Three digits and what parts them."""
_MOST_COMPRESSED = 100
"""LZF makes at most 264 bytes of 3."""
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

    Raises CloudError, and MissingLibraryError where Open3D cannot be loaded.
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

    Raises CloudError, and MissingLibraryError where Open3D cannot be loaded.
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
    """The header's own count of points, if the file is as large as it says.

    Of a damaged file Open3D returns what it could read, zeros for the rest of a PLY, and first
    sets memory aside for as many points as are stated.
    """
    ply = path.suffix.lower() == ".ply"
    header = head.partition(b"end_header" if ply else b"DATA")[0]
    lines = [line.split() for line in header.splitlines()]
    key = [b"element", b"vertex"] if ply else [b"POINTS"]
    counts = [int(word[-1]) for word in lines if word[:-1] == key and word[-1].isdigit()]
    if not counts:
        raise CloudError(f"{path}: has no header that counts its points")
    if ply:
        text = [b"format", b"ascii", b"1.0"] in lines
        least = _TEXT_ROW if text else _ply_row(lines)
    else:
        kind = head[len(header) : len(header) + 40].split()[1:2]
        least = _TEXT_ROW if kind == [b"ascii"] else _pcd_row(lines)
        if kind == [b"binary_compressed"]:
            least /= _MOST_COMPRESSED
    if path.stat().st_size < len(header) + counts[0] * least:
        raise CloudError(f"{path}: ends before the {counts[0]} points that it states")
    return counts[0]


def _ply_row(lines: list[list[bytes]]) -> float:
    """Bytes of a point in binary; lists count as 1."""
    begin = next(row for row, word in enumerate(lines) if word[:2] == [b"element", b"vertex"])
    size = 0
    for word in lines[begin + 1 :]:
        if word[:1] != [b"property"]:
            break
        size += _PLY_BYTES.get(word[1], 1) if len(word) == 3 else 1
    return size


def _pcd_row(lines: list[list[bytes]]) -> float:
    """Bytes of a point in binary, those of three floats where the header does not say."""
    stated = {word[0]: word[1:] for word in lines if len(word) > 1}
    sizes = [int(n) for n in stated.get(b"SIZE", ()) if n.isdigit()]
    counts = [int(n) for n in stated.get(b"COUNT", ()) if n.isdigit()] or [1] * len(sizes)
    return max(sum(n * k for n, k in zip(sizes, counts, strict=False)), 12)
