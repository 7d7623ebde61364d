"""Readers of public data sets, one module each, and the choice between them."""

from __future__ import annotations

import shlex
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from comparisons.errors import InputError, shorten
from comparisons.logs.log import Log


class Reader(NamedTuple):
    """A format: the module that knows and reads it, and what it is.

    The module is imported when it is asked. robots: the format holds several. topics: the format
    names its streams, so that a user may choose.
    """

    module: str
    what: str
    robots: bool = False
    topics: bool = False

    def recognises(self, path: Path) -> bool:
        """Whether a path looks like this format."""
        return bool(import_module(self.module).recognises(path))

    def read(self, path: Path, robot: int = 1, topics: tuple[str, ...] = ()) -> Log:
        """Read a path. Raises InputError.

        robot: number of the robot, where there are several. topics: to read, where they have names.
        """
        if topics and not self.topics:
            raise InputError(
                f"{path}: is not a ROS bag, so --topic {shorten(topics[0])} names nothing in it"
            )
        read = import_module(self.module).read
        more = (robot,) * self.robots + (topics,) * self.topics
        log: Log = read(path, *more)
        return log


_HERE = "comparisons.logs.readers"
READERS: dict[str, Reader] = {
    "log-folder": Reader(
        "comparisons.logs.log_folder", "folder with log.toml, the format of this project"
    ),
    "gtsam-2d": Reader(f"{_HERE}.gtsam_2d", "text with ODOMETRY and LANDMARK lines, as in gtsam"),
    "g2o": Reader(f"{_HERE}.g2o", "g2o, TORO or iSAM text: planar poses, loops, landmarks"),
    "mrclam": Reader(f"{_HERE}.mrclam", "UTIAS MR.CLAM folder (--robot N)", robots=True),
    "acfr-car-park": Reader(
        f"{_HERE}.acfr_car_park", "ACFR car park folder: data_set.mat, beac_juan3.mat"
    ),
    "victoria-park": Reader(
        f"{_HERE}.victoria_park", "Victoria Park detections: measurements.dat and others"
    ),
    "aa3": Reader(f"{_HERE}.aa3", "Victoria Park raw scans: aa3_*.mat (--features trees)"),
    "carmen": Reader(f"{_HERE}.carmen", "CARMEN text: FLASER or ROBOTLASER1 lines"),
    "rosbag": Reader(
        f"{_HERE}.rosbag", "ROS bag: .mcap, .bag, rosbag2 (--topic; slamcheck[ros])", topics=True
    ),
    "rawlog": Reader(f"{_HERE}.rawlog", "MRPT .rawlog: range-bearing, planar scans, 2D odometry"),
}


def _not_recognised(path: Path) -> str:
    """What is said of a path that no reader takes: what it looks like, with its command."""
    shown = shlex.quote(str(path))
    if path.suffix == ".csv":
        return (
            "is a CSV file, expected a log; slamcheck new-log FOLDER --odometry FILE "
            "--measurements FILE makes one of two such files"
        )
    if path.suffix == ".tum" or (path / "trajectory.tum").is_file():
        return f"is an estimate, expected a log; say slamcheck check LOG --estimate {shown}"
    if path.suffix in (".trace", ".events"):
        return f"is a filter's trace, expected a log; say slamcheck audit {shown}"
    if (path / "config.toml").is_file():
        return f"is a folder of results, expected a log; {shown}/config.toml repeats them"
    return f"format not recognised, expected one of {', '.join(READERS)} (name it with --format)"


def read_log(
    path: Path, format_name: str | None = None, robot: int = 1, topics: tuple[str, ...] = ()
) -> Log:
    """Read a log of any known format, recognised unless it is named. Raises InputError.

    path: of a file or folder that exists, see bundled.exists.
    """
    if format_name is None:
        format_name = next((n for n, reader in READERS.items() if reader.recognises(path)), None)
        if format_name is None:
            raise InputError(f"{path}: {_not_recognised(path)}")
    if format_name not in READERS:
        raise InputError(
            f"format '{shorten(format_name)}' is unknown, expected {', '.join(READERS)}"
        )
    try:
        return READERS[format_name].read(path, robot, topics)
    except InputError as error:
        if str(path) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None
