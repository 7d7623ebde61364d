"""Lines of CARMEN logs: words to numbers, with errors that name line, value and expectation."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, shorten
from comparisons.logs.readers.beams import BeamGrid
from comparisons.logs.table import number_or_fail
from comparisons.logs.validation import LARGEST

TAGS = frozenset(
    ("PARAM", "SYNC", "ODOM", "TRUEPOS", "FLASER", "RLASER", "LASER3", "LASER4", "NMEAGGA",
     "NMEARMC", *(f"{kind}LASER{i}" for kind in ("ROBOT", "RAW") for i in range(1, 6)))
)  # fmt: skip
"""Names of messages that CARMEN's logger knows."""

_RESOLUTION_RAD = {180: np.pi / 180, 181: np.pi / 180, 360: np.pi / 360, 361: np.pi / 360}
_MAXIMUM_M = 80.0
_MOST_BEAMS = 100_000


Times = tuple[float, float]
"""IPC's and the logger's, the latter NaN where the line has none."""


class CarmenLaserLine(NamedTuple):
    """One laser line. line: its number from 1.

    times_s: in the log's own seconds. angle_rad, range_m, remission: (B,). maximum_m: ranges from
    there on are none, and NaN once the line is taken. poses: (6,) x, y [m], heading [rad] of the
    laser, then of the robot.
    """

    line: int
    times_s: Times
    angle_rad: Array
    range_m: Array
    maximum_m: float
    remission: Array
    poses: Array


class LineReader:
    """The records of the lines read so far.

    odometry: rows of line, both times, x, y, heading. skipped: how many lines of each name were
    passed over.
    """

    def __init__(self, path: Path) -> None:
        """path: for errors only."""
        self.path = path
        self.sweeps: dict[str, list[CarmenLaserLine]] = {"FLASER": [], "ROBOTLASER1": []}
        self.beams: dict[str, BeamGrid] = {}
        self.odometry: list[list[float]] = []
        self.skipped: Counter[str] = Counter()
        self.maximum_m = _MAXIMUM_M
        self.resolution_rad: float | None = None

    def take(self, number: int, words: list[str]) -> None:
        """One line's words. Raises InputError naming the line."""
        tag = words[0]
        if tag == "FLASER":
            self._flaser(number, words)
        elif tag == "ROBOTLASER1":
            self._robotlaser(number, words)
        elif tag == "ODOM":
            self._odom(number, words)
        elif tag == "PARAM" and len(words) > 2 and words[1] == "robot_front_laser_max":
            self.maximum_m = self._above_zero(number, words[2], words[1])
        elif tag == "PARAM" and len(words) > 2 and words[1] == "laser_front_laser_resolution":
            self.resolution_rad = np.deg2rad(self._above_zero(number, words[2], words[1]))
        else:
            self.skipped[tag if tag in TAGS else "unknown"] += 1

    def _flaser(self, number: int, words: list[str]) -> None:
        """num_readings, ranges, laser pose, robot pose, time, host, logger's time."""
        count = self._count(number, words, 1, "num_readings", least=1)
        self._length(number, words, 2 + count + 7)
        ranges = self._numbers(number, words[2 : 2 + count], "range")
        poses = self._numbers(number, words[2 + count : 8 + count], "pose")
        times = self._times(number, words, 8 + count)
        step = _RESOLUTION_RAD.get(count)
        first = -np.pi / 2
        if step is None:
            if self.resolution_rad is None:
                raise InputError(
                    f"{self.path}:{number}: num_readings is {count}, expected "
                    f"{', '.join(map(str, _RESOLUTION_RAD))}, or a line before it with PARAM "
                    "laser_front_laser_resolution"
                )
            step = self.resolution_rad
            first = -step * (count - 1) / 2
        angle = first + step * np.arange(count, dtype=np.float64)
        nothing = np.zeros(count)
        self._add(
            "FLASER", CarmenLaserLine(number, times, angle, ranges, self.maximum_m, nothing, poses)
        )

    def _robotlaser(self, number: int, words: list[str]) -> None:
        """Configuration, ranges, remissions, laser pose, robot pose, five more, time, host, ..."""
        count = self._count(number, words, 8, "num_readings", least=1)
        more = self._count(number, words, 9 + count, "num_remissions", least=0)
        rest = 10 + count + more
        self._length(number, words, rest + 12)
        first, view, step, maximum = (
            self._number(number, words[2 + i], name)
            for i, name in enumerate(
                ("start_angle", "field_of_view", "angular_resolution", "maximum_range")
            )
        )
        for name, value in (("angular_resolution", step), ("maximum_range", maximum)):
            if not value > 0:
                raise InputError(f"{self.path}:{number}: {name} is {value:g}, expected above 0")
        if abs(first) > 2 * np.pi or view > 2 * np.pi + step:
            raise InputError(
                f"{self.path}:{number}: start_angle is {first:g} and field_of_view {view:g}, "
                "expected radians of one turn"
            )
        if abs(step * (count - 1) - view) > 1.5 * step:
            raise InputError(
                f"{self.path}:{number}: field_of_view is {view:g}, expected {count} beams times "
                f"angular_resolution {step:g}"
            )
        ranges = self._numbers(number, words[9 : 9 + count], "range")
        if more not in (0, count):
            raise InputError(
                f"{self.path}:{number}: num_remissions is {more}, expected 0 or {count}"
            )
        remissions = self._numbers(number, words[10 + count : rest], "remission")
        poses = self._numbers(number, words[rest : rest + 6], "pose")
        times = self._times(number, words, rest + 11)
        angle = first + step * np.arange(count, dtype=np.float64)
        shown = remissions if more else np.zeros(count)
        self._add(
            "ROBOTLASER1", CarmenLaserLine(number, times, angle, ranges, maximum, shown, poses)
        )

    def _odom(self, number: int, words: list[str]) -> None:
        """Pose, tv, rv, accel, time, host, logger's time."""
        self._length(number, words, 8)
        times = self._times(number, words, 7)
        self.odometry.append([number, *times, *self._numbers(number, words[1:4], "pose")])

    def _add(self, kind: str, sweep: CarmenLaserLine) -> None:
        sweeps, number = self.sweeps[kind], sweep.line
        angle, ranges = sweep.angle_rad, sweep.range_m
        before = sweeps[-1] if sweeps else sweep
        grid = self.beams.setdefault(kind, BeamGrid(angle))
        if (ranges < 0).any():
            raise InputError(
                f"{self.path}:{number}: range is {ranges[ranges < 0][0]:g}, expected 0 or more"
            )
        if not grid.take(angle):
            expected, first = grid.angle_rad, sweeps[0]
            raise InputError(
                f"{self.path}:{number}: {len(angle)} beams from {angle[0]:.4g} to {angle[-1]:.4g} "
                f"rad, expected {len(expected)} from {expected[0]:.4g} to "
                f"{expected[-1]:.4g} as in line {first.line}, or some of them in a row"
            )
        measured = (ranges > 0) & (ranges < sweep.maximum_m)
        found = np.where(measured, ranges, np.nan)
        if len(before.angle_rad) == len(angle):
            angle = before.angle_rad  # one array for all of them: logs are long
        sweeps.append(sweep._replace(angle_rad=angle, range_m=found))

    def _count(self, number: int, words: list[str], at: int, name: str, least: int) -> int:
        word = words[at] if at < len(words) else ""
        most = min(len(words) - at - 1, _MOST_BEAMS)
        fits = word.isascii() and word.isdigit() and len(word) <= 7
        if not fits or not least <= int(word) <= most:
            raise InputError(
                f"{self.path}:{number}: {name} is '{shorten(word)}', expected a whole number from "
                f"{least} on, with as many values after it (here {max(most, 0)})"
            )
        return int(word)

    def _length(self, number: int, words: list[str], least: int) -> None:
        """Up to the time, with or without host and logger's time."""
        if not least <= len(words) <= least + 2:
            raise InputError(
                f"{self.path}:{number}: {len(words)} words, expected {least} to {least + 2} for "
                f"{words[0]} with these counts"
            )

    def _times(self, number: int, words: list[str], at: int) -> Times:
        """IPC's, the host between them, the logger's."""
        try:
            logger = float(words[at + 2])
        except (ValueError, IndexError):
            logger = np.nan
        usable = abs(logger) <= LARGEST
        return self._number(number, words[at], "time"), logger if usable else np.nan

    def _numbers(self, number: int, words: list[str], name: str) -> Array:
        try:
            values = np.array(words, dtype=float)
        except ValueError:
            values = np.full(1, np.nan)
        if not (np.abs(values) <= LARGEST).all():
            values = np.array([self._number(number, word, name) for word in words])
        return values

    def _number(self, number: int, word: str, name: str) -> float:
        value = number_or_fail(word, self.path, number, name)
        if abs(value) > LARGEST:
            raise InputError(
                f"{self.path}:{number}: {name} is {value:g}, expected at most {LARGEST:g}"
            )
        return value

    def _above_zero(self, number: int, word: str, name: str) -> float:
        value = self._number(number, word, name)
        if not value > 0:
            raise InputError(f"{self.path}:{number}: {name} is {value:g}, expected above 0")
        return value
