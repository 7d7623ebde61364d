"""Checks shared by the records of a log; each raises RecordError naming stream, row and value."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Mask
from comparisons.errors import RecordError
from comparisons.logs.schema import ANY, SIGMA, ArrayField, Limits, RecordTable

LARGEST = 1e10
"""Beyond this no time, length, speed or angle of a drive lies; squares of it stay finite."""
LARGEST_ID = 2**53
"""Beyond this whole numbers are not exact as floating point."""


def frozen(value: object) -> Array:
    """A read-only float64 copy."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def check(record: object, table: RecordTable) -> None:
    """Freeze a record's arrays, and check them as its table declares.

    Raises:
        RecordError: Of the first fault: a shape, a number that is not finite or beyond `LARGEST`,
            times that fall, a value outside its limits, a covariance, an id that comes twice.
    """
    arrays = [_array(record, table.name, part) for part in table.fields]
    lengths: dict[int | str, int] = {"N": len(arrays[0])}
    for place, part in enumerate(table.fields):
        if not len(arrays[place]) and part.is_optional:
            arrays[place] = frozen(np.full(lengths["N"], np.nan))
        object.__setattr__(record, part.name, arrays[place])
    for part, array in zip(table.fields, arrays, strict=True):
        _check_shape(table.name, part, array, lengths)
        bad = np.isinf(array) if part.has_gaps else ~np.isfinite(array)
        refuse(table.name, bad, part.name, array, "a finite number")
        if part.is_bounded:
            refuse(table.name, np.abs(array) > LARGEST, part.name, array, f"at most {LARGEST:g}")
    if table.order:
        increasing(table.name, arrays[0], equal=table.order == "not falling")
    for part, array in zip(table.fields, arrays, strict=True):
        _check_values(table.name, part, array)


def _array(record: object, stream: str, part: ArrayField) -> NDArray[Any]:
    value = getattr(record, part.name)
    if not part.is_whole:
        return frozen(value)
    array = whole_numbers(stream, part.name, np.array(value))
    array.flags.writeable = False
    return array


def _check_shape(
    stream: str, part: ArrayField, array: NDArray[Any], lengths: dict[int | str, int]
) -> None:
    """lengths: of axes by name; those without a length take that of the array."""
    if array.ndim == len(part.shape):
        for axis, length in zip(part.shape, array.shape, strict=True):
            lengths.setdefault(axis, length)
    expected = tuple(axis if isinstance(axis, int) else lengths.get(axis) for axis in part.shape)
    if array.shape != expected:
        raise RecordError(stream, None, f"{part.name} has shape {array.shape}, expected {expected}")


def _check_values(stream: str, part: ArrayField, array: NDArray[Any]) -> None:
    if part.is_covariance:
        _check_covariance(stream, part, array)
        return
    for column in part.columns if len(part.shape) == 1 else ():
        if column.limits != ANY:
            refuse_outside(stream, part.name, array, column.limits)
        if column.is_distinct:
            distinct(stream, array)


def _check_covariance(stream: str, part: ArrayField, covariance: Array) -> None:
    if part.has_gaps:
        unknown = np.asarray(np.isnan(covariance))
        missing = np.asarray(unknown.all(axis=(1, 2)))
        partial = np.flatnonzero(unknown.any(axis=(1, 2)) & ~missing)
        if len(partial):
            raise RecordError(stream, int(partial[0]), f"{part.name} is nan in part")
        covariance = np.where(missing[:, None, None], np.eye(covariance.shape[-1]), covariance)
    positive_definite(stream, covariance, singular=part.is_singular)


def refuse(stream: str, bad: Mask, name: str, values: NDArray[Any], expected: str) -> None:
    """Raise RecordError for the first of the values that is bad, if any is."""
    if bad.any():
        at = tuple(np.argwhere(bad)[0].tolist())
        raise RecordError(stream, at[0], f"{name} is {values[at]}, expected {expected}")


def whole_numbers(stream: str, name: str, values: NDArray[Any]) -> NDArray[np.int64]:
    """Ids as integers; a fraction, or a number too large to be exact, is an error."""
    if values.dtype.kind not in "iuf":
        raise RecordError(stream, None, f"{name} is not numeric")
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(values) < LARGEST_ID) | (values != np.round(values))
    refuse(stream, bad, name, values, "a whole number below 2^53")
    return values.astype(np.int64)


def distinct(stream: str, ids: NDArray[np.int64]) -> None:
    """No id may appear twice."""
    values, first = np.unique(ids, return_index=True)
    if len(values) < len(ids):
        row = int(np.setdiff1d(np.arange(len(ids)), first)[0])
        raise RecordError(stream, row, f"id {ids[row]} appears twice")


def increasing(stream: str, time_s: Array, *, equal: bool = False) -> None:
    """Times must not run backwards, nor repeat unless `equal`."""
    steps = np.diff(time_s)
    bad = np.flatnonzero(steps < 0 if equal else steps <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        raise RecordError(
            stream,
            row,
            f"time {time_s[row]:.6f} s follows {time_s[row - 1]:.6f} s, expected times to increase",
        )


def refuse_outside(stream: str, name: str, values: NDArray[Any], limits: Limits) -> None:
    """Every value must lie within limits."""
    bad = (values < limits.low) | (values > limits.high)
    refuse(stream, bad, name, values, limits.expected)


def within(stream: str, name: str, values: Array, low: float, high: float) -> None:
    """Every value must lie in a closed interval."""
    refuse_outside(stream, name, values, Limits(low, high))


def standard_deviation(stream: str, name: str, values: Array) -> None:
    """Sigmas must lie between 1e-7 and 1e6, in whatever unit: beyond that they are mistakes."""
    refuse_outside(stream, name, values, SIGMA)


def positive_definite(stream: str, covariance: Array, *, singular: bool = False) -> None:
    """Covariances (N, d, d) must be symmetric, eigenvalues above zero (or zero, if `singular`)."""
    scale = np.abs(covariance).max(axis=(1, 2), initial=0.0)
    skew = np.abs(covariance - covariance.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    least = np.linalg.eigvalsh(covariance)[:, 0]
    wrong = least < -1e-12 * scale if singular else least <= 0.0
    bad = np.flatnonzero((skew > 1e-9 * scale) | wrong)
    if len(bad):
        raise RecordError(
            stream,
            int(bad[0]),
            "covariance is not positive definite, expected a symmetric one with positive variances",
        )
