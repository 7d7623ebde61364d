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


class CloudError(ValueError):
    """A file of points that cannot be written. The message, one line, says why."""


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


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise CloudError(f"{path}: expected a name ending in {' or '.join(SUFFIXES)}")
    return suffix
