"""What `result.json` says of single scan landmarks as two matchers align them."""

from __future__ import annotations

from comparisons.report.model import Model


class LandmarkMatchingResult(Model):
    """How the filter's alignments of a scan landmark differ from the smoother's own.

    common: scans that both aligned it with. distance_sigma: root of the mean squared distance over
    3, by the sum of both covariances. shift: x, y, heading, weighted mean, in the vehicle's frame.
    worst: the same of the one farthest apart.
    """

    id: int
    common: int
    distance_sigma: float | None
    shift_m: tuple[float, float]
    shift_rad: float
    worst_time_s: float
    worst_m: tuple[float, float]
    worst_rad: float
    worst_sigma: float | None
    contradicts: bool
