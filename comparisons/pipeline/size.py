"""Is a log too large for this machine? Asked before the work, of logs that are large.

The estimate is of the peak of a run, fitted to what benchmarks/scale.py measures (docs/scale.md);
a run is refused only where it needs more than the machine could give it.
"""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.errors import InputError
from comparisons.pipeline.prepare import Prepared

GIB = 2.0**30
BASE = 0.25 * GIB
"""Bytes of the interpreter and its libraries."""
PER_POSE, PER_MEASUREMENT = 6_000.0, 2_000.0
"""Bytes of the smoother's graph while it is eliminated, which is a run's peak on a long log."""
MATRICES = 10.0
"""Covariances of the last pose and all landmarks that a run has at once, with their copies."""
MATRICES_FULL = 11.0
"""Of a full filter, whose update makes one more."""
_CGROUP = Path("/sys/fs/cgroup")


def check_size(prepared: Prepared[Any], available: float | None = None) -> None:
    """Raise InputError where a run needs more memory than there is.

    available: bytes, by default what the machine has free; where unknown, nothing is refused.
    """
    log, timeline = prepared.log, prepared.timeline
    poses, measurements = len(timeline.epoch_time_s), len(timeline.measurement_epoch)
    landmarks = len(np.unique(log.measurements.landmark)) if prepared.labelled else 0
    need = needed(poses, measurements, landmarks, full=prepared.ekf.filter == "full")
    room = available_bytes() if available is None else available
    if room is not None and need > room:
        raise InputError(
            f"{log.name}: {poses:,} poses, {measurements:,} measurements and {landmarks:,} "
            f"landmarks need about {need / GIB:.1f} GiB of memory, and {room / GIB:.1f} GiB are "
            "free; use a part of the log, or a larger machine (docs/scale.md)"
        )


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
