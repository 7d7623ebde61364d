"""CARMEN logs (`.log`, `.clf`): text, one message per line.

Read are FLASER or, where there are any, ROBOTLASER1 lines (both the laser in front), with the
robot's odometry that they carry; ODOM lines serve where that odometry stands still throughout.
Of PARAM lines, `robot_front_laser_max` [m] and `laser_front_laser_resolution` [degrees] count.

FLASER lines name neither field of view nor maximum range. As CARMEN does, 181 and 180 beams are
taken to be 1 degree apart and 361 and 360 half a degree, from -90 degrees on, and the maximum is
80 m. Other counts need the resolution, and lie evenly about straight ahead. Ranges of zero, and
those from the maximum on, are no returns.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.readers.carmen_lines import TAGS, LineReader, Sweeps
from comparisons.logs.readers.scan_odometry import poses_at, scan_log
from comparisons.logs.scans import Mount, Scans
from comparisons.logs.table import locate_rows, read_text, shorten

_MOUNT_TOLERANCE = np.array([0.05, 0.05, 0.02])


def recognises(path: Path) -> bool:
    """A text file whose first record starts with one of the messages' names."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        for line in file.read(65536).splitlines():
            if line.strip() and not line.startswith(b"#"):
                return line.split()[0].decode("ascii", "replace") in TAGS
    return False


def read(path: Path) -> Log:
    """Read the file; times count from the first scan, poses from the robot's there.

    Raises InputError naming the line at fault, also where the beams or the laser's place change.
    """
    reader = LineReader(path)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            reader.take(number, words)
    kind = "ROBOTLASER1" if reader.sweeps["ROBOTLASER1"].line else "FLASER"
    sweeps = reader.sweeps[kind]
    if not sweeps.line:
        raise InputError(f"{path}: expected at least one FLASER or ROBOTLASER1 line")
    mount = _mount(path, sweeps)
    start = sweeps.time[0]
    time_s, pose = np.array(sweeps.time) - start, np.array(sweeps.robot)
    inside = np.ones(len(time_s), dtype=bool)
    source = f"the robot's pose in the {kind} lines"
    if reader.odometry and not np.ptp(pose, axis=0).any():
        samples = np.array(reader.odometry)
        sample_s = samples[:, 0] - start
        inside = (time_s >= sample_s[0]) & (time_s <= sample_s[-1])
        if not inside.any():
            raise InputError(f"{path}: no {kind} line lies within the time of the ODOM lines")
        time_s = time_s[inside]
        pose, source = poses_at(time_s, sample_s, samples[:, 1:]), "ODOM lines"
    kept = np.flatnonzero(inside)
    with locate_rows(path, lambda row: sweeps.line[kept[row]]):
        scans = Scans(
            time_s=time_s,
            angle_rad=sweeps.angle,
            range_m=np.array(sweeps.ranges)[inside],
            intensity=np.array(sweeps.remissions)[inside],
            mount=mount,
        )
    others = reader.skipped + Counter(
        {tag: len(other.line) for tag, other in reader.sweeps.items() if tag != kind}
    )
    provenance = {
        "file": path.name,
        "scans": f"{kind} lines",
        "odometry": source,
        "time_origin_s": f"{start:.3f}",
        "left_out": f"{sweeps.repeated} repeated scans, {np.count_nonzero(~inside)} outside the "
        "odometry",
        "lines_passed_over": ", ".join(
            f"{count} {shorten(tag)}" for tag, count in others.most_common(20) if count
        ),
    }
    return scan_log(path.stem, "carmen", time_s, pose, provenance, scans=scans)


def _mount(path: Path, sweeps: Sweeps) -> Mount:
    """The laser seen from the robot, which all lines must agree on."""
    laser, robot = np.array(sweeps.laser), np.array(sweeps.robot)
    offset = (laser[:, :2] - robot[:, :2]) @ np.array([1.0, 1j]) * np.exp(-1j * robot[:, 2])
    turn = np.angle(np.exp(1j * (laser[:, 2] - robot[:, 2])))
    # Numbers are printed to a few digits only: the middle of all is better than the first.
    middle = np.angle(np.exp(1j * turn).sum())
    seen = np.column_stack(
        (offset.real, offset.imag, middle + np.angle(np.exp(1j * (turn - middle))))
    )
    place = np.median(seen, axis=0)
    far = np.flatnonzero((np.abs(seen - place) > _MOUNT_TOLERANCE).any(axis=1))
    if len(far):
        x, y, heading = seen[far[0]]
        raise InputError(
            f"{path}:{sweeps.line[far[0]]}: the laser's pose is {x:.4g} m forward, {y:.4g} m left, "
            f"{heading:.4g} rad of the robot's, expected {place[0]:.4g}, {place[1]:.4g}, "
            f"{place[2]:.4g} as in most lines (a log with corrected poses?)"
        )
    return Mount(*place.tolist())
