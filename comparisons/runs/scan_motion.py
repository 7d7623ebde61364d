"""Motion from a log's raw scans: every scan through scan odometry, wheels as the guess if any."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from comparisons.logs.scans import Clouds, Scans
from comparisons.runs.motion import motion_between
from graphslam.increments import dead_reckoned
from graphslam.scan import planar
from graphslam.scan.odometry import OdometryOptions, ScanOdometry
from graphslam.scan.points import compensated, planar_points, swept_points
from graphslam.scan.registration import Registration, ScanError

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class ScanFailure:
    """A scan that gave no increment. row: in the log's stream of scans."""

    row: int
    time_s: float
    reason: str


@dataclass(frozen=True)
class ScanMotion:
    """What scan odometry made of a log. N scans were usable, the rest are `failures`.

    time_s: (N,), row: (N,) in the log's stream. pose: (N, 3) chained from the origin of the
    first. displacement: (N, 3) and covariance: (N, 3, 3) from the usable scan before, of the
    right perturbation; zero for the first. bridged: (N,) that no scan matched, so that the
    displacement is the wheels' (the first counts as bridged, too). matches: evidence where not
    bridged. wheels: (N, 3) the wheels' displacement, None without odometry.
    """

    time_s: Array
    row: Index
    pose: Array
    displacement: Array
    covariance: Array
    bridged: NDArray[np.bool_]
    matches: tuple[Registration | None, ...]
    wheels: Array | None
    failures: tuple[ScanFailure, ...]

    @property
    def breaks(self) -> int:
        """How many times the chain of scans had to be begun anew."""
        return int(self.bridged[1:].sum())


def run_scan_odometry(
    log: Log,
    options: OdometryOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    guess: bool = True,
) -> ScanMotion:
    """All scans of a log, in order. guess: begin each alignment from the wheels' motion.

    Raises InputError when the log has no scans, or none that can be used.
    """
    stream = log.clouds if log.scans is None else log.scans
    if stream is None:
        raise InputError(f"{log.name}: holds no scans")
    wheeled = len(log.odometry.time_s) > 0
    rows = _covered(log, stream.time_s) if wheeled else np.arange(len(stream.time_s))
    if not len(rows):
        raise InputError(f"{log.name}: no scan lies within the time of the odometry")
    time_s = stream.time_s[rows]
    wheels = motion_between(log, time_s) if wheeled else None
    sweep = _sweep_motion(log, stream, rows) if wheeled else None
    odometry = ScanOdometry(options)
    used: list[int] = []
    failures, poses, found, matches = [], [], [], []
    for i, row in enumerate(rows.tolist()):
        progress(i, len(rows))
        moved = wheels.displacement[i] if wheels is not None and guess else None
        points = scan_points(stream, row, None if sweep is None else sweep[i])
        try:
            increment = odometry.register(points, moved if i else np.zeros(3))
        except ScanError as error:
            failures.append(ScanFailure(row, float(time_s[i]), str(error)))
            continue
        used.append(i)
        poses.append(odometry.pose)
        found.append(increment)
        matches.append(None if increment is None else increment.match)
    if not used:
        raise InputError(
            f"{log.name}: none of {len(rows)} scans could be used; the first: {failures[0].reason}"
        )
    kept = np.array(used)
    displacement, covariance = np.zeros((len(kept), 3)), np.zeros((len(kept), 3, 3))
    over = None if wheels is None else motion_between(log, time_s[kept])
    for k, increment in enumerate(found):
        if increment is not None:
            displacement[k], covariance[k] = increment.motion, increment.covariance
        elif k and over is not None:
            displacement[k], covariance[k] = over.displacement[k], over.covariance[k]
        elif k:
            raise InputError(
                f"{log.name}: the scans lost track at {time_s[kept[k]]:.2f} s, and there is no "
                "wheel odometry to bridge the gap"
            )
    return ScanMotion(
        time_s[kept],
        rows[kept],
        dead_reckoned(np.zeros(3), displacement[1:]),
        displacement,
        covariance,
        np.array([increment is None for increment in found]),
        tuple(matches),
        None if over is None else over.displacement,
        tuple(failures),
    )


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
    mount = np.array(list(vars(stream.mount).values()))
    if sweep is None or not stream.beam_s:
        return planar_points(stream.angle_rad, stream.range_m[row], mount)
    seen = np.flatnonzero(np.isfinite(stream.range_m[row]))
    share = seen / (len(stream.angle_rad) - 1)
    scanner = np.array([planar.compose(s * sweep, mount) for s in share])
    return swept_points(stream.angle_rad[seen], stream.range_m[row, seen], scanner.reshape(-1, 3))


def _covered(log: Log, time_s: Array) -> Index:
    inside = (time_s >= log.prior.time_s) & (time_s <= log.odometry.time_s[-1])
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
