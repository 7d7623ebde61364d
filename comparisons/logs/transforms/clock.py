"""A log's times as float64 has them on the clock of its file."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Log
from comparisons.logs.stamps import resolved

_STREAMS = ("odometry", "measurements", "positions", "known_measurements", "scans", "clouds")


def file_start(log: Log) -> Decimal:
    """Return what a log's times count from, by the clock of its file; 0 if by the same."""
    return Decimal(log.provenance.get("time_origin_s", "0"))


def timed_by_floats(log: Log) -> Log:
    """Return the log with the times that a filter has which reads its file's stamps as float64.

    Seconds since 1970 have a resolution of a quarter of a microsecond, so that steps have other
    lengths.
    """
    start = file_start(log)

    def by_floats(time_s: Array) -> Array:
        stamps = [float(start + Decimal(one)) for one in time_s.tolist()]
        return resolved(np.array([float(Decimal(stamp) - start) for stamp in stamps]))

    changed: dict[str, Any] = {}
    for name in _STREAMS:
        stream = getattr(log, name)
        if stream is not None:
            changed[name] = replace(stream, time_s=by_floats(stream.time_s))
    prior_s = float(by_floats(np.array([log.prior.time_s]))[0])
    poses = log.truth.poses
    if poses is not None:
        poses = replace(poses, time_s=by_floats(poses.time_s))
    return replace(
        log,
        prior=replace(log.prior, time_s=prior_s),
        truth=replace(log.truth, poses=poses),
        **changed,
    )
