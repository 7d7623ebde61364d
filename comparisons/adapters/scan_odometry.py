"""Motion from a log's raw scans: every scan through scan odometry, wheels as the guess if any."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.motion import motion_between
from comparisons.adapters.scan_source import CloudsAt, ScanSource
from comparisons.arrays import Array, Index
from comparisons.errors import InputError
from comparisons.logs.log import Log
from graphslam.increments import dead_reckoned
from graphslam.scan.odometry import KissIcpOptions, ScanOdometry
from graphslam.scan.registration import Registration, ScanError


@dataclass(frozen=True)
class ScanFailure:
    """A scan that gave no increment. row: in the log's stream of scans."""

    row: int
    time_s: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class ScanMotion:
    """What scan odometry made of a log. N scans were usable, the rest are `failures`.

    time_s: (N,), row: (N,) in the log's stream. pose: (N, 3) chained from the origin of the
    first. displacement: (N, 3) and covariance: (N, 3, 3) from the usable scan before, of the
    right perturbation; zero for the first. bridged: (N,) that no scan matched, so that the
    displacement is the wheels' (the first counts as bridged, too). matches: evidence where not
    bridged. wheels: (N, 3) the wheels' displacement, None without odometry. guessed: whether each
    alignment began from these. scan: (N,) numbers in the source, which gives the points.
    """

    time_s: Array
    row: Index
    pose: Array
    displacement: Array
    covariance: Array
    bridged: NDArray[np.bool_]
    matches: tuple[Registration | None, ...]
    wheels: Array | None
    guessed: bool
    failures: tuple[ScanFailure, ...]
    source: ScanSource
    scan: Index
    options: KissIcpOptions

    def clouds(self, pose_time_s: Array) -> CloudsAt:
        """The clouds by number of the pose among those at times (K,) that a scan belongs to."""
        poses = np.searchsorted(pose_time_s, self.time_s)
        scans = dict(zip(poses.tolist(), self.scan.tolist(), strict=True))
        return CloudsAt(self.source, scans, self.options)

    @property
    def breaks(self) -> int:
        """How many times the chain of scans had to be initialised again."""
        return int(self.bridged[1:].sum())

    @property
    def remarks(self) -> list[str]:
        """What did not go as it should, in sentences."""
        remarks = []
        if self.failures:
            remarks.append(
                f"{len(self.failures)} scans gave no increment; the first, row "
                f"{self.failures[0].row}: {self.failures[0].reason}"
            )
        if self.breaks:
            remarks.append(f"{self.breaks} gaps are bridged by the wheels' motion")
        return remarks

    @property
    def lacks(self) -> str:
        """Why its path is no evidence, in words; empty where scans or wheels hold all of it.

        Across a lost scan the next alignment begins from constant velocity, where no wheels guess,
        and may end on the wrong surfaces.
        """
        if self.guessed or not self.failures:
            return ""
        return (
            f"{len(self.failures)} of {len(self.source.row)} scans were lost without the wheels' "
            f"motion as a guess (restarts: {self.breaks})"
        )


def run_scan_odometry(
    log: Log,
    options: KissIcpOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    guess: bool = True,
) -> ScanMotion:
    """All scans of a log, in order. guess: begin each alignment from the wheels' motion.

    Raises InputError when the log has no scans, or none that can be used.
    """
    source = ScanSource(log)
    rows, time_s = source.row, source.time_s
    wheels = motion_between(log, time_s) if source.wheeled else None
    odometry = ScanOdometry(options or source.suited_options())
    used: list[int] = []
    failures, found, matches = [], [], []
    for i, row in enumerate(rows.tolist()):
        progress(i, len(rows))
        moved = wheels.displacement[i] if wheels is not None and guess else None
        try:
            increment = odometry.register(source.points(i), moved if i else np.zeros(3))
        except ScanError as error:
            failures.append(ScanFailure(row, float(time_s[i]), str(error)))
            continue
        used.append(i)
        found.append(increment)
        matches.append(None if increment is None else increment.match)
    if not used:
        raise InputError(
            f"{log.name}: none of {len(rows)} scans could be used; the first: {failures[0].reason}"
        )
    kept = np.array(used)
    displacement, covariance = np.zeros((len(kept), 3)), np.zeros((len(kept), 3, 3))
    over = wheels
    if wheels is not None and failures:
        over = motion_between(log, time_s[kept])
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
        time_s=time_s[kept],
        row=rows[kept],
        pose=dead_reckoned(np.zeros(3), displacement[1:]),
        displacement=displacement,
        covariance=covariance,
        bridged=np.array([increment is None for increment in found]),
        matches=tuple(matches),
        wheels=None if over is None else over.displacement,
        guessed=guess and wheels is not None,
        failures=tuple(failures),
        source=source,
        scan=kept,
        options=odometry.options,
    )
