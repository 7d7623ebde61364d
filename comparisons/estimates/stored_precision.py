"""Whether numbers were stored in single precision, and what that does to them."""

from __future__ import annotations

import numpy as np

from comparisons.arrays import Array
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import MeasurementRecords, TraceArrays

SINGLE = 2.0**-24
"""What storing in single precision does to a number, relative to it, at the most."""
OF_STEPS = ("prior_pose", "prior_covariance", "departed", "arrived", "f", "q")
OF_RECORDS = ("pose", "landmark", "innovation", "jacobian_pose", "jacobian_other", "noise")
"""What a planar filter computes, of its trace and of each of its records."""


def records_of(trace: TraceArrays) -> tuple[MeasurementRecords, ...]:
    """Return a planar filter's records: of measurements, of new landmarks, of positions."""
    return trace.measurements[POINT], trace.initialisations[POINT], trace.positions


def figures_of(trace: TraceArrays) -> list[Array]:
    """Return all that a planar filter computes: OF_STEPS, then OF_RECORDS of each of its records.

    Args:
        trace: Of x, y, heading and points.

    Returns:
        Arrays of any shapes.
    """
    figures = [getattr(trace, name) for name in OF_STEPS]
    return figures + [getattr(r, name) for r in records_of(trace) for name in OF_RECORDS]


def stored_rounding(*arrays: Array) -> float:
    """Return SINGLE where every number is exactly one of single precision, else 0.

    Arrays of numbers that half of it could hold, such as zeros and ones, are no evidence.
    """
    values = np.concatenate([np.ravel(array) for array in arrays])
    values = values[np.isfinite(values)]
    with np.errstate(over="ignore"):
        if not (values == values.astype(np.float32)).all():
            return 0.0
        plain = values == values.astype(np.float16)
    return 0.0 if plain.all() else SINGLE


def restored(
    arrays: list[Array], rng: np.random.Generator, precision: type = np.float32
) -> list[Array]:
    """Return arrays as they may have been before they were stored in a precision.

    Every number moves within half of its last place, equal ones together, so that what is symmetric
    stays so; by one place at most where that is the last of double precision. Numbers that half
    precision could hold, such as zeros and ones, stay.
    """
    flat = np.concatenate([array.ravel() for array in arrays])
    size, which = np.unique(np.abs(flat), return_inverse=True)
    with np.errstate(over="ignore"):
        plain = size == size.astype(np.float16)
    place = np.spacing(size.astype(precision)).astype(np.float64)
    share = 1.0 if precision is np.float64 else 0.5
    moved = np.where(plain, 0.0, share * place * rng.uniform(-1.0, 1.0, len(size)))
    flat = flat + np.sign(flat) * moved[which]
    ends = np.cumsum([array.size for array in arrays])[:-1]
    return [
        part.reshape(array.shape) for part, array in zip(np.split(flat, ends), arrays, strict=True)
    ]
