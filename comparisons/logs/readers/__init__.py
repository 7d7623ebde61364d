"""Readers of public data sets, one module each, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.log_folder import read_log_folder
from comparisons.logs.log_meta import MARK
from comparisons.logs.readers import (
    aa3,
    acfr_car_park,
    carmen,
    g2o,
    gtsam_2d,
    mrclam,
    rosbag,
    victoria_park,
)
from comparisons.logs.table import shorten


class Reader(NamedTuple):
    """How a format is known and read. read takes the path and a robot's number."""

    recognises: Callable[[Path], bool]
    read: Callable[[Path, int], Log]
    what: str


def _alone(recognises: Callable[[Path], bool], read: Callable[[Path], Log], what: str) -> Reader:
    """Of a format that holds one robot only."""
    return Reader(recognises, lambda path, robot: read(path), what)


READERS: dict[str, Reader] = {
    "log-folder": _alone(
        lambda path: (path / MARK).is_file(),
        read_log_folder,
        "this project's own format, a folder with log.toml",
    ),
    "gtsam-2d": _alone(
        gtsam_2d.recognises,
        gtsam_2d.read,
        "text with ODOMETRY and LANDMARK lines, as gtsam's victoria_park.txt",
    ),
    "g2o": _alone(
        g2o.recognises,
        g2o.read,
        "g2o text: one chain of poses, landmarks as points",
    ),
    "mrclam": Reader(mrclam.recognises, mrclam.read, "a UTIAS MR.CLAM folder; see --robot"),
    "acfr-car-park": _alone(
        acfr_car_park.recognises,
        acfr_car_park.read,
        "the ACFR car park folder: data_set.mat and beac_juan3.mat",
    ),
    "victoria-park": _alone(
        victoria_park.recognises,
        victoria_park.read,
        "Victoria Park detections: measurements.dat, inputs.dat, gps.dat",
    ),
    "aa3": _alone(
        aa3.recognises,
        aa3.read,
        "Victoria Park's raw scans: aa3_dr.mat, aa3_lsr2.mat, aa3_gpsx.mat; see --features trees",
    ),
    "carmen": _alone(
        carmen.recognises,
        carmen.read,
        "CARMEN text: FLASER or ROBOTLASER1 lines with raw scans",
    ),
    "rosbag": _alone(
        rosbag.recognises,
        rosbag.read,
        "ROS bags with LaserScan or PointCloud2: .mcap, .bag, rosbag2 folders (extra ros)",
    ),
}


def read_log(path: Path, format_name: str | None = None, robot: int = 1) -> Log:
    """Read a log of any known format, recognised unless it is named. Raises InputError."""
    try:
        found = path.exists()
    except (OSError, ValueError):  # a name too long, or with a null character
        found = False
    if not found:
        shown = shorten(str(path), 200)
        raise InputError(f"{shown}: no such file or folder (slamcheck logs lists bundled names)")
    if format_name is None:
        names = [name for name, reader in READERS.items() if reader.recognises(path)]
        if not names:
            raise InputError(
                f"{path}: format not recognised, expected one of {', '.join(READERS)} "
                "(name it with --format)"
            )
        format_name = names[0]
    if format_name not in READERS:
        raise InputError(f"format '{format_name}' is unknown, expected {', '.join(READERS)}")
    try:
        return READERS[format_name].read(path, robot)
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None
