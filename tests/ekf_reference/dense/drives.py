"""The full filter, driven scan by scan through a simulated log."""

from __future__ import annotations

from collections.abc import Iterator

from comparisons.logs.log import Log
from comparisons.runs.watched_run import watched_run
from ekf_reference.full_ekf import FullEkf
from ekf_reference.trace import Trace


def scans(log: Log, trace: Trace | None = None) -> Iterator[tuple[float, FullEkf]]:
    """The filter after every scan with sightings, and the scan's time [s]."""
    return watched_run(log, trace=trace)
