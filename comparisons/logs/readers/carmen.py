"""CARMEN logs (`.log`, `.clf`): text, one message per line.

Read are FLASER or, where there are any, ROBOTLASER1 lines (both the laser in front), with the
robot's odometry that they carry; ODOM lines serve where that odometry stands still throughout.
Of PARAM lines, `robot_front_laser_max` [m] and `laser_front_laser_resolution` [degrees] count.

FLASER lines name neither field of view nor maximum range. As CARMEN does, 181 and 180 beams are
taken to be 1 degree apart and 361 and 360 half a degree, from -90 degrees on, and the maximum is
80 m. Other counts need the resolution, and lie evenly about straight ahead. Ranges of zero, and
those from the maximum on, are no returns.

Times are IPC's; the logger's where most of IPC's repeat, as when they were written with six digits,
or fall back too far; and the scans' numbers where neither serves. Lines out of order by up to 0.1 s
are sorted. ODOM lines of time 0, which gmapping writes, have no time and are left out.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import InputError, shorten
from comparisons.logs.log import Log, Prior
from comparisons.logs.odometry import NOISE_TEXT, displacements, poses_at
from comparisons.logs.readers.carmen_lines import TAGS, CarmenLaserLine, LineReader
from comparisons.logs.readers.scan_odometry import PRIOR_SIGMA, no_measurements
from comparisons.logs.scans import Mount, Scans
from comparisons.logs.table import first_words, locate_rows, read_text, stem

_MOUNT_TOLERANCE = np.array([0.05, 0.05, 0.02])
_LARGEST_FALL_S = 0.1
_COLUMNS = ("IPC's", "the logger's")


class _Clock(NamedTuple):
    """column: of the times used, None for the order of lines. text: what the provenance says."""

    column: int | None
    text: str


def recognises(path: Path) -> bool:
    """A text file whose first record starts with one of the messages' names."""
    return any(word in TAGS for word in first_words(path)[:1])


def read(path: Path) -> Log:
    """Read the file; times count from the first scan, poses from the robot's there.

    Raises InputError naming the line at fault, also where the beams or the laser's place change.
    """
    reader = LineReader(path)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if words and not words[0].startswith("#"):
            reader.take(number, words)
    kind = "ROBOTLASER1" if reader.sweeps["ROBOTLASER1"] else "FLASER"
    sweeps = reader.sweeps[kind]
    if not sweeps:
        raise InputError(f"{path}: expected at least one FLASER or ROBOTLASER1 line")
    mount, grid = _mount(path, sweeps), reader.beams[kind]
    lines, times = [sweep.line for sweep in sweeps], np.array([sweep.times_s for sweep in sweeps])
    clock = _clock(lines, times)
    order, time_s, repeated, swapped = _in_order(times, clock)
    start, pose = time_s[0], np.array([sweep.poses[3:] for sweep in sweeps])[order]
    time_s = time_s - start
    source = f"the robot's pose in the {kind} lines"
    untimed = sum(row[1] == 0 for row in reader.odometry)
    if untimed > 1:
        source += ", which a mapper may have corrected: gmapping writes ODOM lines of time 0"
    if reader.odometry and not np.ptp(pose, axis=0).any():
        samples = _odometry(path, np.array(reader.odometry), clock, lines)
        sample_s = samples[:, 0] - start
        inside = (time_s >= sample_s[0]) & (time_s <= sample_s[-1])
        if not inside.any():
            raise InputError(f"{path}: no {kind} line lies within the time of the ODOM lines")
        outside, order, time_s = int(np.count_nonzero(~inside)), order[inside], time_s[inside]
        pose, source = poses_at(time_s, sample_s, samples[:, 1:]), "ODOM lines"
    else:
        outside = 0
    with locate_rows(path, lambda row: lines[order[row]]):
        scans = Scans(
            time_s=time_s,
            angle_rad=grid.angle_rad,
            range_m=np.array([grid.filled(s.angle_rad, s.range_m) for s in sweeps])[order],
            intensity=np.array([grid.filled(s.angle_rad, s.remission, 0.0) for s in sweeps])[order],
            mount=mount,
        )
    others = reader.skipped + Counter(
        {tag: len(other) for tag, other in reader.sweeps.items() if tag != kind}
    )
    provenance = {
        "file": path.name,
        "scans": "; ".join(
            filter(None, (f"{kind} lines", grid.words([len(s.angle_rad) for s in sweeps])))
        ),
        "odometry": source,
        "times": clock.text,
        "time_origin_s": f"{start:.3f}",
        "sorted": f"{swapped} {kind} lines that fell back by at most {_LARGEST_FALL_S:g} s",
        "left_out": f"{repeated} repeated scans, {outside} outside the odometry",
        "lines_passed_over": ", ".join(
            f"{count} {shorten(tag)}" for tag, count in others.most_common(20) if count
        ),
        "odometry_noise": NOISE_TEXT,
    }
    return Log(
        name=stem(path),
        format="carmen",
        prior=Prior(float(time_s[0]), np.zeros(3), PRIOR_SIGMA**2 * np.eye(3)),
        odometry=displacements(time_s, pose),
        measurements=no_measurements(),
        scans=scans,
        provenance=provenance,
    )


def _clock(lines: list[int], times: Array) -> _Clock:
    """Which of the two times (N, 2) are used, or neither where both repeat or fall back."""
    steps = np.diff(times, axis=0)
    repeating = (steps == 0).mean(axis=0) if len(steps) else np.zeros(2)
    coarse = (repeating > 0.5) | np.isnan(times).any(axis=0)
    fall = np.maximum.accumulate(times) - times
    usable = ~coarse & (fall <= _LARGEST_FALL_S).all(axis=0)
    if usable[0]:
        return _Clock(0, _COLUMNS[0])
    why = f"IPC's repeat in {100 * repeating[0]:.0f} % of the scans"
    if not coarse[0]:
        fallen = np.flatnonzero(fall[:, 0] > _LARGEST_FALL_S)
        why = f"IPC's fall back by {fall[fallen[0], 0]:.6g} s in line {lines[fallen[0]]}"
        if len(fallen) > 1:
            most = fall[fallen[1:], 0].max()
            why += f", and by up to {most:.6g} s in {len(fallen) - 1} more lines"
    if usable[1]:
        return _Clock(1, f"the logger's, since {why}")
    other = "do so, too"
    if coarse[0] != coarse[1]:
        other = "repeat" if coarse[1] else "fall back"
    if np.isnan(times[:, 1]).any():
        other = "are missing"
    return _Clock(None, f"scan numbers in place of seconds, since {why}; the logger's {other}")


def _in_order(times: Array, clock: _Clock) -> tuple[Index, Array, int, int]:
    """Rows (K,) by time, their times (K,), how many of the same time were dropped, or moved.

    times: (N, 2) of the sweeps.
    """
    if clock.column is None:
        return np.arange(len(times)), np.arange(float(len(times))), 0, 0
    time: Array = times[:, clock.column]
    swapped = int(np.count_nonzero(time < np.maximum.accumulate(time)))
    order = np.argsort(time, kind="stable")
    order = order[np.diff(time[order], prepend=-np.inf) > 0]
    return order, time[order], len(time) - len(order), swapped


def _odometry(path: Path, rows: Array, clock: _Clock, scans: list[int]) -> Array:
    """(N, 4) time, x, y, heading of ODOM lines by time, without those of none.

    rows: (M, 6) as read. scans: lines of the scans, between which ODOM lines lie evenly where times
    are scan numbers. Raises InputError where their times are no use.
    """
    if clock.column is None:
        lines = np.array((0, *scans, max(scans[-1], int(rows[-1, 0])) + 1))
        return np.column_stack(
            (np.interp(rows[:, 0], lines, np.arange(-1.0, len(scans) + 1)), rows[:, 3:])
        )
    time = rows[:, 1 + clock.column]
    lost = np.isnan(time) | (time == 0)
    lost[0] &= np.isnan(time[0]) or np.count_nonzero(lost) > 1  # a log may start at zero
    kept, time = rows[~lost], time[~lost]
    if not len(kept):
        raise InputError(
            f"{path}: no ODOM line has a time ({_COLUMNS[clock.column]}), expected some, since the "
            "robot stands still in the laser lines"
        )
    fall = np.maximum.accumulate(time) - time
    fallen = np.flatnonzero(fall > _LARGEST_FALL_S)
    if len(fallen):
        row = int(fallen[0])
        raise InputError(
            f"{path}:{int(kept[row, 0])}: time {time[row]:.6f} s follows "
            f"{time[row] + fall[row]:.6f} s, expected times to increase but for "
            f"{_LARGEST_FALL_S:g} s (cut the log where its clock was set)"
        )
    time, first = np.unique(time, return_index=True)
    return np.column_stack((time, kept[first, 3:]))


def _mount(path: Path, sweeps: list[CarmenLaserLine]) -> Mount:
    """The laser seen from the robot, which all lines must agree on."""
    laser, robot = (np.array([sweep.poses[k : k + 3] for sweep in sweeps]) for k in (0, 3))
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
            f"{path}:{sweeps[far[0]].line}: the laser's pose is {x:.4g} m forward, {y:.4g} m left, "
            f"{heading:.4g} rad of the robot's, expected {place[0]:.4g}, {place[1]:.4g}, "
            f"{place[2]:.4g} as in most lines (corrected poses? take the log as recorded)"
        )
    return Mount(*place.tolist())
