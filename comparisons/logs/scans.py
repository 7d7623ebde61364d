"""Raw scans as records of a log: planar sweeps of a laser, and clouds of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError
from comparisons.logs import schema
from comparisons.logs.records import LogRecord, Stream

Index = NDArray[np.int64]

_LONGEST_SWEEP_S = 10.0


@dataclass(frozen=True)
class Mount:
    """Where a planar scanner sits: forward and left of the log's pose, and which way it looks."""

    forward_m: float = 0.0
    left_m: float = 0.0
    heading_rad: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not abs(value) <= 1e3:
                raise InputError(f"scans: mount {name} is {value}, expected at most 1000")

    @property
    def pose(self) -> Array:
        """(3,) the same as a pose in the vehicle's frame."""
        return np.array((self.forward_m, self.left_m, self.heading_rad))


@dataclass(frozen=True, kw_only=True)
class Scans(Stream):
    """Planar laser scans. angle_rad: (B,) from the scanner's ahead, counter-clockwise.

    time_s: (N,) of the first beam; each next one is beam_s later, 0 when all are of one instant.
    range_m: (N, B), NaN for no return. intensity: (N, B), zero where not measured.
    """

    table = schema.SCANS

    time_s: Array
    angle_rad: Array
    range_m: Array
    intensity: Array
    mount: Mount = Mount()
    beam_s: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not abs(self.beam_s) * len(self.angle_rad) <= _LONGEST_SWEEP_S:
            raise InputError(
                f"scans: beam_s is {self.beam_s}, expected sweeps of {_LONGEST_SWEEP_S:g} s at most"
            )


@dataclass(frozen=True)
class Clouds(LogRecord):
    """Scans in three dimensions, one after the other in one table of points.

    time_s: (N,). first: (N + 1,) row of each scan's first point, and the end. point_m: (P, 3)
    forward, left and up of the log's pose as the point was measured; rows of NaN are no returns.
    point_s: (P,) when that was, in seconds after its scan's time.
    """

    table = schema.CLOUDS

    time_s: Array
    first: Index
    point_m: Array
    point_s: Array

    def __post_init__(self) -> None:
        points = len(self.point_m)
        first = np.array(self.first)
        count = len(self.time_s) + 1
        if first.shape != (count,) or first.dtype.kind not in "iu":
            raise RecordError("clouds", None, f"first must hold {count} whole numbers")
        if first[0] != 0 or first[-1] != points or (np.diff(first) < 0).any():
            raise RecordError("clouds", None, f"first must run from 0 up to {points} points")
        super().__post_init__()

    def points(self, scan: int) -> Array:
        """(M, 3) of one scan, without its missing returns."""
        rows = self._returned(scan)
        return self.point_m[rows]

    def seconds(self, scan: int) -> Array:
        """(M,) when the points of one scan were measured, after the scan's time."""
        return self.point_s[self._returned(scan)]

    def _returned(self, scan: int) -> NDArray[np.intp]:
        first, end = int(self.first[scan]), int(self.first[scan + 1])
        return first + np.flatnonzero(~np.isnan(self.point_m[first:end]).any(axis=1))
