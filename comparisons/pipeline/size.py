"""Is a log too large for this machine, or for a user who waits? Asked before the work.

The estimates are of a run's peak of memory and its time, fitted to what research/scale.py
measures (docs/limits.md); a run is refused only where it needs more memory than the machine could
give it, and announced where it takes long.
"""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.errors import InputError, note

if TYPE_CHECKING:
    from comparisons.pipeline.prepared import Prepared

GIB = 2.0**30
BASE = 0.25 * GIB
"""Bytes of the interpreter and its libraries."""
PER_POSE, PER_MEASUREMENT = 6_000.0, 2_000.0
"""Bytes of the smoother's graph while it is eliminated, which is a run's peak on a long log."""
MATRICES = 10.0
"""Covariances of the last pose and all landmarks that a run has at once, with their copies."""
MATRICES_FULL = 11.0
"""Of a full filter, whose update makes one more."""
PER_POSE_S, PER_CUBE_S = 2e-3, 5e-10
"""Seconds of one core: of a pose with nine measurements, and of the states of the map, cubed."""
PER_ENTRY_S = {"full": 9e-9, "compressed": 3.3e-10}
"""Of a pose and an entry of the map's covariance, by filter: the others update it as the first."""
LONG_S = 60.0
"""A job that takes longer is announced."""
_CGROUP = Path("/sys/fs/cgroup")


def check_size(prepared: Prepared[Any], available: float | None = None) -> None:
    """Raise InputError where a run needs more memory than there is.

    available: bytes, by default what the machine has free; where unknown, nothing is refused.
    """
    log = prepared.log
    poses, measurements, landmarks = counts(prepared)
    need = needed(poses, measurements, landmarks, full=prepared.ekf.filter == "full")
    room = available_bytes() if available is None else available
    if room is not None and need > room:
        raise InputError(
            f"{log.name}: {poses:,} poses, {measurements:,} measurements and {landmarks:,} "
            f"landmarks need about {need / GIB:.1f} GiB of memory, and {room / GIB:.1f} GiB are "
            "free; use a part of the log, or a larger machine (docs/limits.md)"
        )


def announce_time(prepared: Prepared[Any]) -> None:
    """Tell on standard error how long a run or a check takes, where that is long.

    And what takes less, or that what takes more may follow: a run may use another filter, a check
    compares an estimate that is not as the reference EKF's with other filters.
    """
    poses, measurements, landmarks = counts(prepared)
    used = "compressed" if prepared.ekf.filter.startswith("compressed") else "full"
    takes = seconds(poses, measurements, landmarks, used)
    if takes < LONG_S:
        return
    shorter, beside = seconds(poses, measurements, landmarks, "compressed"), ""
    if prepared.config.job == "check":
        beside = ", longer where the estimate is not as the reference EKF's"
    elif takes > 2 * shorter:
        beside = f"; --filter compressed takes about {_minutes(shorter)}"
    note(
        f"{prepared.log.name}: {poses:,} poses, {measurements:,} measurements and {landmarks:,} "
        f"landmarks take about {_minutes(takes)}{beside}"
    )


def seconds(poses: int, measurements: int, landmarks: int, used: str) -> float:
    """Return about how long a run takes on one core. used: `full` or `compressed`."""
    states = 3.0 + 2.0 * landmarks
    linear = PER_POSE_S * max(poses, measurements / 9.0)
    return linear + PER_ENTRY_S[used] * poses * states**2 + PER_CUBE_S * states**3


def _minutes(time_s: float) -> str:
    if time_s < LONG_S:
        return f"{time_s:.0f} s"
    return f"{time_s / 60.0:,.0f} min" if time_s < 7200.0 else f"{time_s / 3600.0:,.0f} h"


def counts(prepared: Prepared[Any]) -> tuple[int, int, int]:
    """Return poses, measurements, and landmarks: without labels, as many as a scan has at most."""
    timeline = prepared.timeline
    epoch = timeline.measurement_epoch
    if prepared.labelled:
        landmarks = len(np.unique(prepared.log.measurements.landmark))
    else:
        landmarks = int(np.bincount(epoch).max(initial=0))
    return len(timeline.epoch_time_s), len(epoch), landmarks


def needed(poses: int, measurements: int, landmarks: int, *, full: bool = False) -> float:
    """Return about how many bytes a run takes at its peak."""
    states = 3.0 + 2.0 * landmarks
    matrices = 8.0 * (MATRICES_FULL if full else MATRICES) * states**2
    return BASE + PER_POSE * poses + PER_MEASUREMENT * measurements + matrices


def available_bytes() -> float | None:
    """Return what the machine, the control group and the process' limit leave; None if unknown."""
    return min(_limits(), default=None)


def _limits() -> Iterator[float]:
    for line in _text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            yield 1024.0 * float(line.split()[1])
    for limit, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        most, now = _text(_CGROUP / limit).strip(), _text(_CGROUP / used).strip()
        if most.isdigit() and now.isdigit():
            stated = dict(
                map(str.split, _text((_CGROUP / used).with_name("memory.stat")).splitlines())
            )
            yield float(most) - float(now) + float(stated.get("inactive_file", 0.0))  # files' cache
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    if soft != resource.RLIM_INFINITY:
        yield float(soft)


def _text(path: Path) -> str:
    """Return what a file holds, nothing where it cannot be read."""
    try:
        return path.read_text(encoding="ascii")
    except OSError:
        return ""
