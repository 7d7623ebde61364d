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


READERS: dict[str, Reader] = {
    "log-folder": Reader(
        lambda path: (path / MARK).is_file(),
        lambda path, robot: read_log_folder(path),
        "this project's own format, a folder with log.toml",
    ),
    "gtsam-2d": Reader(
        gtsam_2d.recognises,
        lambda path, robot: gtsam_2d.read(path),
        "text with ODOMETRY and LANDMARK lines, as gtsam's victoria_park.txt",
    ),
    "g2o": Reader(
        g2o.recognises,
        lambda path, robot: g2o.read(path),
        "g2o text: one chain of poses, landmarks as points",
    ),
    "mrclam": Reader(mrclam.recognises, mrclam.read, "a UTIAS MR.CLAM folder; see --robot"),
    "acfr-car-park": Reader(
        acfr_car_park.recognises,
        lambda path, robot: acfr_car_park.read(path),
        "the ACFR car park folder: data_set.mat and beac_juan3.mat",
    ),
    "victoria-park": Reader(
        victoria_park.recognises,
        lambda path, robot: victoria_park.read(path),
        "Victoria Park detections: measurements.dat, inputs.dat, gps.dat",
    ),
    "aa3": Reader(
        aa3.recognises,
        lambda path, robot: aa3.read(path),
        "Victoria Park's raw scans: aa3_dr.mat, aa3_lsr2.mat, aa3_gpsx.mat; see --features trees",
    ),
    "carmen": Reader(
        carmen.recognises,
        lambda path, robot: carmen.read(path),
        "CARMEN text: FLASER or ROBOTLASER1 lines with raw scans",
    ),
    "rosbag": Reader(
        rosbag.recognises,
        lambda path, robot: rosbag.read(path),
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
    return READERS[format_name].read(path, robot)
