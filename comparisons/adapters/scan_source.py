"""A log's raw scans as clouds in the vehicle's frame, whatever scanner they come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from comparisons.adapters.motion import motion_between
from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.scans import Clouds, Scans
from graphslam.increments import dead_reckoned
from graphslam.scan import planar
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.points import beam_noise, compensated, planar_points, swept_points

_SAMPLE = 50
"""So many scans tell how noisy they are."""


class ScanSource:
    """The scans of a log that its odometry covers; without odometry, all since the prior's time.

    row: (N,) of each in the log's stream. time_s: (N,).
    """

    def __init__(self, log: Log) -> None:
        """Raises InputError when the log has no scans, or none in the log's time."""
        stream = log.clouds if log.scans is None else log.scans
        if stream is None or not len(stream.time_s):
            raise InputError(f"{log.name}: holds no scans")
        self._stream = stream
        self.wheeled = len(log.odometry.time_s) > 0
        self.row = _covered(log, stream.time_s)
        if not len(self.row):
            span = "within the time of the odometry" if self.wheeled else "after the prior's time"
            raise InputError(f"{log.name}: no scan lies {span}")
        self.time_s = stream.time_s[self.row]
        self._sweep = _sweep_motion(log, stream, self.row) if self.wheeled else None

    def suited_options(self) -> KissIcpOptions:
        """Scan odometry's settings for the noise that the scans show."""
        if isinstance(self._stream, Clouds):
            return KissIcpOptions()
        some = self.row[:: max(1, len(self.row) // _SAMPLE)]
        noise = beam_noise(self._stream.range_m[some])
        return KissIcpOptions.for_noise(noise) if noise > 0.0 else KissIcpOptions()

    def points(self, scan: int) -> Array:
        """(M, 3) points of scan number `scan`, in the vehicle's frame at the scan's time."""
        sweep = None if self._sweep is None else self._sweep[scan]
        return scan_points(self._stream, int(self.row[scan]), sweep)


class CloudsAt(Mapping[int, Array]):
    """Clouds by the number of the pose from which they were seen, made when asked for."""

    def __init__(
        self, source: ScanSource, scan_of_pose: dict[int, int], options: KissIcpOptions
    ) -> None:
        """scan_of_pose: number of a scan by the number of its pose. options: what to leave out."""
        self._source, self._scan, self._options = source, scan_of_pose, options

    def __getitem__(self, pose: int) -> Array:
        """(M, 3) points."""
        return self._options.prepared(self._source.points(self._scan[pose]))

    def __contains__(self, pose: object) -> bool:
        """Whether there is a scan of it; nothing is made, and a blank one counts."""
        return pose in self._scan

    def __iter__(self) -> Iterator[int]:
        """Poses in order."""
        return iter(self._scan)

    def __len__(self) -> int:
        """Number of clouds."""
        return len(self._scan)


def scan_points(stream: Scans | Clouds, row: int, sweep: Array | None = None) -> Array:
    """(M, 3) points of one scan in the vehicle's frame at the scan's time.

    sweep: (3,) the vehicle's motion while the scan was taken, to compensate for.
    """
    if isinstance(stream, Clouds):
        points = stream.points(row)
        duration = _duration(stream, row)
        if sweep is None or not duration or not len(points):
            return points
        return compensated(points, stream.seconds(row), sweep, duration)
    mount = stream.mount.pose
    if sweep is None or not stream.beam_s:
        return planar_points(stream.angle_rad, stream.range_m[row], mount)
    seen = np.flatnonzero(np.isfinite(stream.range_m[row]))
    share = seen / (len(stream.angle_rad) - 1)
    scanner = np.array([planar.compose(s * sweep, mount) for s in share])
    return swept_points(stream.angle_rad[seen], stream.range_m[row, seen], scanner.reshape(-1, 3))


def _covered(log: Log, time_s: Array) -> Index:
    inside = time_s >= log.prior.time_s
    if len(log.odometry.time_s):
        inside &= time_s <= log.odometry.time_s[-1]
    return np.flatnonzero(inside)


def _duration(stream: Scans | Clouds, row: int) -> float:
    """Seconds from the first beam or point of a scan to its last."""
    if isinstance(stream, Scans):
        return stream.beam_s * (len(stream.angle_rad) - 1)
    seconds = stream.point_s[stream.first[row] : stream.first[row + 1]]
    return float(seconds.max(initial=0.0))


def _sweep_motion(log: Log, stream: Scans | Clouds, rows: Index) -> Array | None:
    """(N, 3) the wheels' motion during each scan; None where scans are of one instant."""
    duration = np.array([_duration(stream, row) for row in rows.tolist()])
    if not duration.any():
        return None
    begin = stream.time_s[rows]
    if isinstance(log.odometry, RelativePoses):
        return _shares(log, log.odometry, begin, duration)
    end = np.minimum(begin + duration, log.odometry.time_s[-1])
    instants = np.unique(np.concatenate((begin, end)))
    path = dead_reckoned(np.zeros(3), motion_between(log, instants).displacement)[1:]
    starts, ends = path[np.searchsorted(instants, begin)], path[np.searchsorted(instants, end)]
    return np.array([planar.between(a, b) for a, b in zip(starts, ends, strict=True)])


def _shares(log: Log, odometry: RelativePoses, begin: Array, duration: Array) -> Array:
    """(N, 3) the share of the displacement under way when each scan began, or of the last one.

    Relative poses are known at their own times only, and a sweep is short beside their interval.
    """
    interval = np.diff(odometry.time_s, prepend=log.prior.time_s)
    under_way = np.searchsorted(odometry.time_s, begin, side="right")
    row = np.minimum(under_way, len(interval) - 1)
    share = np.minimum(duration / interval[row], 1.0)
    result: Array = share[:, None] * odometry.displacement[row]
    return result
