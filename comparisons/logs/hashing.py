"""What a log is known by."""

from __future__ import annotations

import hashlib

import numpy as np

from comparisons.logs.log import LandmarkMeasurements, Log


def log_hash(log: Log) -> str:
    """SHA-256 of everything that an estimator may be given: all streams but truth."""
    digest = hashlib.sha256()
    records: tuple[object, ...] = (
        log.prior,
        log.odometry,
        log.measurements,
        log.positions,
        log.known_landmarks,
        log.known_measurements,
    )
    for record in records + tuple(
        s for s in (log.scans, log.clouds, log.loop_closures) if s is not None
    ):
        if record is None:
            digest.update(b"absent")
            continue
        for name, value in sorted(vars(record).items()):
            if (
                name == "intensity"
                and isinstance(record, LandmarkMeasurements)
                and np.isnan(value).all()
            ):
                continue  # as if there were no such column, so that logs without keep their hash
            digest.update(name.encode())
            digest.update(
                np.ascontiguousarray(value).tobytes()
                if isinstance(value, np.ndarray | float)
                else repr(value).encode()  # records of plain numbers
            )
    return digest.hexdigest()
