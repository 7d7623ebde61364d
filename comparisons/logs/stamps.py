"""Time stamps: read from their decimals, and when two are of the same instant.

Words of a file become seconds after a start by `seconds_after`, of which every reader of text makes
its times: the start is subtracted before anything is rounded. float64 has only a quarter of a
microsecond of seconds since 1970.
"""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index

Nanoseconds = NDArray[np.int64]
_RESOLUTION_S = 1e-9
"""Of times, which float64 must have."""
_CHANCE = 1e-6
_PER_SECOND = 10**9
_WHOLE_NS = 2**63 - 1
"""The largest number of nanoseconds that int64 holds: the year 2262."""


def seconds_after(
    words: Iterable[str | Decimal], start: int | Decimal = 0, per_second: int = 1
) -> Array:
    """Return the seconds (N,) after a start, each rounded once, of times as they are written.

    words: decimal digits, or the numbers that they spell, in units of which `per_second` are a
    second. start: in seconds.
    """
    return np.array([float(Decimal(word) / per_second - start) for word in words], dtype=float)


def nanoseconds(words: Iterable[str | Decimal], per_second: int = 1) -> Nanoseconds | None:
    """Return times (N,) as they are written, in whole nanoseconds; None beyond the year 2262."""
    scale = Decimal(_PER_SECOND) / per_second
    whole = [int((Decimal(word) * scale).to_integral_value()) for word in words]
    if any(abs(one) > _WHOLE_NS for one in whole):
        return None
    return np.array(whole, dtype=np.int64)


def after_ns(time_ns: Nanoseconds, start: Decimal) -> Array:
    """Return the seconds (N,) after a start, in seconds, of nanoseconds (N,)."""
    begin = int((start * _PER_SECOND).to_integral_value())
    return np.array([(one - begin) / _PER_SECOND for one in time_ns.tolist()], dtype=float)


def resolved_by_floats(time_s: Array) -> bool:
    """Whether float64 has nanoseconds of times (N,), as it has not of seconds since 1970."""
    return bool(np.spacing(np.abs(time_s).max(initial=0.0)) <= _RESOLUTION_S)


def origin(first_s: float) -> int:
    """Return the whole seconds that a log counts from: 0 where float64 resolves nanoseconds."""
    return int(np.floor(first_s)) if np.spacing(abs(first_s)) > _RESOLUTION_S else 0


def resolved(time_s: Array) -> Array:
    """Times as epochs have them: to the nanosecond, where a float tells as much."""
    return np.where(np.spacing(np.abs(time_s)) < 1e-10, np.round(time_s, 9), time_s)


def at_instants(time_s: Array, instants_s: Array) -> Array:
    """Times (K,) as instants (J,) have them, where they are the same but for how they are written.

    A time is an instant's that lies within half of the times' last decimal, the fourth at least;
    the third, where all times are so near.
    """
    nearest = _nearest(time_s, instants_s)
    apart, told = np.abs(nearest - time_s), 2.0 * np.spacing(np.abs(time_s))
    for decimals in range(3, 10):
        near = apart <= 0.5 * 10.0**-decimals + told
        written = np.abs(time_s - np.round(time_s, decimals)) <= told
        if written.all() and (decimals > 3 or near.all()):
            break
    return np.where(near, nearest, time_s)


def rounded(time_s: Array, instants_s: Array) -> str:
    """Say that times (K,) are instants (J,) rounded to 10 ms or more; empty where it is not sure.

    It is sure where none is farther than half of the last decimal, which chance makes so less than
    once in a million times, and where they are no even steps of a clock of their own.
    """
    apart, told = np.abs(_nearest(time_s, instants_s) - time_s), 2.0 * np.spacing(np.abs(time_s))
    for decimals in range(3):
        unit, written = 10.0**-decimals, np.round(time_s, decimals)
        if (np.abs(time_s - written) > told).any():
            continue
        chance = unit * len(instants_s) / max(float(np.ptp(instants_s)), unit)
        even = np.gcd.reduce(np.diff(np.round(written / unit)).astype(np.int64)) > 1
        near = (apart <= 0.5 * unit + told).all() and (apart > told).any()
        if even or not near or chance ** len(time_s) > _CHANCE:
            break
        digits = int(np.log10(max(time_s[-1], 1.0))) + 1 + decimals
        return (
            f"the estimate's times are the log's rounded to {unit:g} s, as '%.{digits}g' does, by "
            f"up to {1e3 * apart.max():.0f} ms; write nine decimals, '%.9f'"
        )
    return ""


def since_origin(time_s: Array, start_s: float, instants_s: Array) -> Array:
    """Times (K,) after a start, as instants (J,) have those that a float of many seconds tells."""
    return as_floats_tell(time_s - start_s, start_s, instants_s)


def as_floats_tell(after_s: Array, start_s: float, instants_s: Array) -> Array:
    """Times (K,) after a start as instants (J,), where a float of both together is the same."""
    nearest = _nearest(after_s, instants_s)
    return np.where(np.abs(nearest - after_s) <= 2.0 * np.spacing(abs(start_s)), nearest, after_s)


def nearest_instants(time_s: Array, instants_s: Array) -> Index:
    """Return the rows (K,) of the instants (J,) nearest to times (K,), of two the first."""
    right = np.clip(np.searchsorted(instants_s, time_s), 1, max(len(instants_s) - 1, 1))
    left, right = right - 1, np.minimum(right, len(instants_s) - 1)
    return np.where(time_s - instants_s[left] <= instants_s[right] - time_s, left, right)


def _nearest(time_s: Array, instants_s: Array) -> Array:
    return instants_s[nearest_instants(time_s, instants_s)]
