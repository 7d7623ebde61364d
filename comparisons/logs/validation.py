"""Checks shared by the records of a log; each raises RecordError naming stream, row and value."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index, Mask
from comparisons.errors import RecordError

LARGEST = 1e10
"""Beyond this no time, length, speed or angle of a drive lies; squares of it stay finite."""
LEAST_SIGMA = 1e-7
"""Of a measurement, in whatever unit: smaller ones are mistakes."""
LARGEST_ID = 2**53
"""Beyond this whole numbers are not exact as floating point."""


class Stream:
    """Records in the order of time, columns of which are arrays of one length."""

    def chosen(self, rows: Mask | Index) -> Self:
        """The same with some of its rows; what is one for all of them stays."""
        own = cast(Any, self)
        columns = {
            field.name: value[rows]
            for field in fields(own)
            if isinstance(value := getattr(own, field.name), np.ndarray)
            and len(value) == len(own.time_s)
            and field.name != "angle_rad"
        }
        return cast(Self, replace(own, **columns))


def frozen(value: object) -> Array:
    """A read-only float64 copy."""
    array = np.array(value, dtype=float)
    array.flags.writeable = False
    return array


def check(
    record: object,
    stream: str,
    rows: str,
    gaps: tuple[str, ...] = (),
    **shapes: tuple[int, ...] | None,
) -> None:
    """Freeze the arrays; check their shapes against the stream's length, and that all are finite.

    gaps: columns in which NaN means not measured. shapes: each row's shape, None to leave alone.
    """
    kept: dict[str, NDArray[Any]] = {}
    for name in (field.name for field in fields(record)):  # type: ignore[arg-type]
        if isinstance(value := getattr(record, name), np.ndarray | list):
            ids = name in ("id", "landmark")
            kept[name] = whole_numbers(stream, name, np.array(value)) if ids else frozen(value)
            kept[name].flags.writeable = False
            object.__setattr__(record, name, kept[name])
    count = len(getattr(record, rows))
    for name, array in kept.items():
        shape = shapes.get(name, ())
        if shape is not None and array.shape != (count, *shape):
            expected = (count, *shape)
            raise RecordError(stream, None, f"{name} has shape {array.shape}, expected {expected}")
        bad = np.isinf(array) if name in gaps else ~np.isfinite(array)
        refuse(stream, bad, name, array, "a finite number")
        if name not in ("id", "landmark", "intensity"):
            refuse(stream, np.abs(array) > LARGEST, name, array, f"at most {LARGEST:g}")


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


def within(stream: str, name: str, values: Array, low: float, high: float) -> None:
    """Every value must lie in a closed interval."""
    bad = (values < low) | (values > high)
    refuse(stream, bad, name, values, f"between {low:.4g} and {high:.4g}")


def standard_deviation(stream: str, name: str, values: Array) -> None:
    """Sigmas must lie between 1e-7 and 1e6, in whatever unit: beyond that they are mistakes."""
    within(stream, name, values, LEAST_SIGMA, 1e6)


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
