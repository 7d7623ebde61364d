"""Text graphs with ODOMETRY and LANDMARK lines, such as gtsam's `victoria_park.txt`.

`ODOMETRY i j dx dy dheading` and the covariance's upper triangle: pose j seen from pose i.
`LANDMARK i j x y` and the covariance's upper triangle: landmark j in the frame of pose i. Poses
and landmarks share one numbering; poses come in driving order. There are no times, so pose k
gets k seconds. iSAM's files have the same tags with square roots of informations, and are read as
graphs (graphslam.g2o).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.arrays import Array, symmetric
from comparisons.errors import InputError, shorten
from comparisons.logs.log import LandmarkMeasurements, Log, Prior
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.table import first_words, locate_rows, number_or_fail, read_text, stem

_COLUMNS = {
    "ODOMETRY": ("i", "j", "dx", "dy", "dheading", "c00", "c01", "c02", "c11", "c12", "c22"),
    "LANDMARK": ("i", "j", "x", "y", "c00", "c01", "c11"),
}
_PRIOR_SIGMA = 1e-6


def recognises(path: Path) -> bool:
    """A text file whose first record starts with one of the two tags, but for iSAM's."""
    words = first_words(path)
    return bool(words) and words[0] in _COLUMNS and not _of_isam(words)


def _of_isam(words: list[str]) -> bool:
    """Whether a line's last variance is one that only a root of an information may be.

    As a covariance it would say that a step's heading is known worse than to a radian.
    """
    try:
        return words[0] == "ODOMETRY" and float(words[-1]) > 1.0
    except ValueError:
        return False


def read(path: Path) -> Log:
    """Read the file; the prior is the origin with sigma 1e-6 (m and rad).

    A landmark's position becomes range and bearing; its variance v, equal in x and y, becomes
    sigma_r = sqrt(v) and sigma_b = sigma_r / r. Raises InputError naming the line at fault.
    """
    moves: list[list[float]] = []
    seen: list[list[float]] = []
    move_line: list[int] = []
    seen_line: list[int] = []
    pose_of: dict[int, int] = {}
    for number, tag, (i, j, *values) in _records(path):
        place = f"{path}:{number}"
        if tag == "ODOMETRY":
            if not moves:
                pose_of[i] = 0
            if pose_of.get(i) != len(moves):
                raise InputError(
                    f"{place}: departs from {i}, expected the latest pose (graphs with "
                    "loop closures are read from EDGE_SE2 lines of g2o)"
                )
            if j in pose_of:
                raise InputError(f"{place}: arrives at {j}, which is a pose already")
            pose_of[j] = len(moves) + 1
            moves.append(values)
            move_line.append(number)
        else:
            if i not in pose_of:
                raise InputError(f"{place}: seen from {i}, which is no pose so far")
            vxx, vxy, vyy = values[2:]
            if vxx <= 0 or abs(vxy) > 1e-9 * vxx or abs(vxx - vyy) > 1e-9 * vxx:
                raise InputError(
                    f"{place}: covariance {vxx:g} {vxy:g} {vyy:g} is not positive definite and "
                    "equal in every direction"
                )
            seen.append([pose_of[i], j, *values[:2], vxx])
            seen_line.append(number)
    if not moves or not seen:
        raise InputError(f"{path}: expected at least one ODOMETRY and one LANDMARK line")
    for row, number in enumerate(seen_line):
        if int(seen[row][1]) in pose_of:
            raise InputError(f"{path}:{number}: landmark {int(seen[row][1])} is a pose's number")
    order = sorted(range(len(seen)), key=lambda row: seen[row][0])
    with locate_rows(path, move_line.__getitem__):
        moved, covariance = np.split(np.array(moves), [3], axis=1)
        odometry = RelativePoses(np.arange(1.0, len(moves) + 1), moved, symmetric(covariance))
    with locate_rows(path, lambda row: seen_line[order[row]]):
        measurements = _measurements(np.array(seen)[order])
    return Log(
        name=stem(path).replace("_", "-"),
        format="gtsam-2d",
        prior=Prior(0.0, np.zeros(3), _PRIOR_SIGMA**2 * np.eye(3)),
        odometry=odometry,
        measurements=measurements,
        provenance={"file": path.name, "times": "pose numbers in place of seconds"},
    )


def _records(path: Path) -> Iterator[tuple[int, str, tuple[Any, ...]]]:
    """Line number, tag, and the values, the first two being whole numbers."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        place, columns = f"{path}:{number}", _COLUMNS.get(words[0])
        if columns is None:
            raise InputError(
                f"{place}: starts with '{shorten(words[0])}', expected ODOMETRY or LANDMARK"
            )
        if len(words) - 1 != len(columns):
            raise InputError(
                f"{place}: {len(words) - 1} values after {words[0]}, expected {len(columns)} "
                f"({', '.join(columns)})"
            )
        for name, word in zip(columns[:2], words[1:3], strict=True):
            if not (word.isascii() and word.isdigit() and len(word) <= 15):
                raise InputError(f"{place}: {name} is '{shorten(word)}', expected a whole number")
        values = (
            number_or_fail(word, path, number, name)
            for name, word in zip(columns[2:], words[3:], strict=True)
        )
        yield number, words[0], (int(words[1]), int(words[2]), *values)


def _measurements(seen: Array) -> LandmarkMeasurements:
    pose, landmark, x, y, variance = seen.T
    distance, sigma = np.hypot(x, y), np.sqrt(variance)
    safe = np.where(distance > 0, distance, np.nan)  # a zero range is reported as such
    z = np.column_stack((distance, np.arctan2(y, x)))
    sigmas = np.column_stack((sigma, np.where(distance > 0, sigma / safe, 1.0)))
    return LandmarkMeasurements.of(pose, z, sigmas, landmark.astype(np.int64))
