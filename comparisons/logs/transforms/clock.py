"""A log's times as float64 has them on the clock of its file."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from operator import attrgetter
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Log
from comparisons.logs.schema import STREAMS
from comparisons.logs.stamps import resolved


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
    for stream in STREAMS:
        record = attrgetter(stream.field)(log)
        if record is not None and record.table.times:
            times = {name: by_floats(getattr(record, name)) for name in record.table.times}
            changed[stream.field] = replace(record, **times)
    prior_s = float(by_floats(np.array([log.prior.time_s]))[0])
    poses = changed.pop("truth.poses", None)
    return replace(
        log,
        prior=replace(log.prior, time_s=prior_s),
        truth=replace(log.truth, poses=poses),
        **changed,
    )
