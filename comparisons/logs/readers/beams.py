"""Scans of one scanner that do not all have the same number of beams, such as 180 beside 181."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from comparisons.arrays import Array

_TOLERANCE_RAD = 1e-3


class BeamGrid:
    """The directions of a scanner's beams: those of the widest scan, of which others lack an end.

    Attributes:
        angle_rad: (B,).
    """

    def __init__(self, angle_rad: Array) -> None:
        """angle_rad: of the first scan."""
        self.angle_rad = angle_rad

    def take(self, angle_rad: Array) -> bool:
        """Return whether a scan's beams (C,) are some of the grid's in a row, or the reverse."""
        if _first_common(angle_rad, self.angle_rad) is not None:
            return True
        if _first_common(self.angle_rad, angle_rad) is None:
            return False
        self.angle_rad = angle_rad
        return True

    def filled(self, angle_rad: Array, values: Array, nothing: float = np.nan) -> Array:
        """Return values (C,) of a scan's beams as values of the grid's (B,)."""
        if len(values) == len(self.angle_rad):
            return values
        begin = _first_common(angle_rad, self.angle_rad)
        if begin is None:
            raise ValueError("a scan whose beams are not the grid's")
        found = np.full(len(self.angle_rad), nothing)
        found[begin : begin + len(values)] = values
        return found

    def words(self, counts: Sequence[int]) -> str:
        """Return how many scans have fewer beams; counts: of each scan. Empty where none has."""
        few, most = sorted(set(counts) - {len(self.angle_rad)}), len(self.angle_rad)
        parts = [f"{counts.count(n)} of {len(counts)} scans have {n} beams" for n in few]
        return f"{', '.join(parts)} of {most}: the others are no returns" if parts else ""


def _first_common(angle_rad: Array, wide: Array) -> int | None:
    """The beam of a wider scan that is the first of a scan's; None unless all its beams are."""
    begin = int(np.abs(wide - angle_rad[0]).argmin())
    part = wide[begin : begin + len(angle_rad)]
    same = len(part) == len(angle_rad) and np.allclose(
        part, angle_rad, rtol=0.0, atol=_TOLERANCE_RAD
    )
    return begin if same else None
