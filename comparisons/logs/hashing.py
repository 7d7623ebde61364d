"""What a log is known by."""

from __future__ import annotations

import hashlib
from dataclasses import fields

import numpy as np

from comparisons.logs.log import LandmarkMeasurements, Log
from comparisons.logs.schema import STREAMS

_BITS = 30
"""Of a column's largest number, so many bits count; times count in full.

The last bits of a log that is simulated or converted depend on the processor: its sine and
arctangent round otherwise. 2^-30 is a tenth of a micrometre in 100 m. The chance that a rounding
error crosses the border between two roundings is below 1e-4 a log, over the bundled logs.
"""
_LEAST_BITS, _LEAST = 36, -40
"""Nor does less count than 2^-36 of an array's largest number, nor than 2^-40: a column of zeros
that are computed is rounding."""

_EACH = ("odometry", "measurements", "positions", "known_landmarks", "known_measurements")
"""Streams whose absence counts. A log without any other has the hash that it had before these."""


def log_hash(log: Log) -> str:
    """SHA-256 of everything that an estimator may be given: all streams but truth.

    Equal on all processors: what they round otherwise does not count.
    """
    digest = hashlib.sha256()
    records = [log.prior, *(getattr(log, field) for field in _EACH)]
    others = [one for one in STREAMS if not one.is_truth and one.field not in _EACH]
    others.sort(key=lambda stream: not stream.is_archived)
    present = (getattr(log, stream.field) for stream in others)
    for record in (*records, *(record for record in present if record is not None)):
        if record is None:
            digest.update(b"absent")
            continue
        for name in sorted(field.name for field in fields(record)):
            value = getattr(record, name)
            if (
                name == "intensity"
                and isinstance(record, LandmarkMeasurements)
                and np.isnan(value).all()
            ):
                continue  # as if there were no such column, so that logs without keep their hash
            digest.update(name.encode())
            if isinstance(value, np.ndarray) and value.dtype.kind == "f" and name[-2:] != "_s":
                value = _rounded(value[None] if record is log.prior else value)
            digest.update(
                np.ascontiguousarray(value).tobytes()
                if isinstance(value, np.ndarray | float)
                else repr(value).encode()  # records of plain numbers
            )
    return digest.hexdigest()


def _rounded(values: np.ndarray) -> np.ndarray:
    """Rows of numbers, each column to a power of two; zero without a sign, one NaN for all."""
    finite = np.where(np.isfinite(values), np.abs(values), 0.0)
    largest = finite.max(axis=0, initial=0.0)
    whole = _exponent(largest.max(initial=0.0)) - _LEAST_BITS
    exponent = np.maximum(_exponent(largest) - _BITS, max(int(whole), _LEAST))
    rounded: np.ndarray = np.ldexp(np.rint(np.ldexp(values, -exponent)), exponent) + 0.0
    rounded[np.isnan(rounded)] = np.nan
    return rounded


def _exponent(largest: np.ndarray) -> np.ndarray:
    """Of the power of two above; a number that is one but for its last bits counts as above."""
    return np.frexp(largest * (1.0 + 2.0**-20))[1]
