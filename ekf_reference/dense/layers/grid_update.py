"""What a scan does to the cells of an occupancy grid, wherever these are (Nieto 2005, 4.1)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ekf_reference.core.geometry import Index, Mask
from ekf_reference.dense.scan import Scan, Single
from ekf_reference.dense.sensor_model import InverseSensorModel, log_odds

PRIOR = 0.5
"""Of every cell; its log-odds are zero, the last term of eq. 4.7."""
_ROUGHNESS = 0.5
"""Standard deviation of where in a cell a surface lies, in cells."""
_FAR = 4.0
"""So many sigmas before a return, space is as free as it gets."""

_SLACK = 0.01
"""More of them where rounding must not decide."""


@dataclass(frozen=True)
class GridUpdate:
    """Log-odds per cell (Nieto 2005, eq. 4.7 for 2.61 and 4.6), the prior one half.

    confidence: log-odds stay between those of 1 - confidence and confidence; 1 for no bound, as
    4.7 has it. Errata: 4.7 repeats the map's term where the inverse sensor model belongs. A scan
    changes a cell once, by the return nearest in bearing: adding up all beams that cross it would
    count one look many times.
    """

    resolution_m: float = 0.2
    model: InverseSensorModel = field(default_factory=InverseSensorModel)
    confidence: float = 0.98

    def __post_init__(self) -> None:
        """Check the resolution and the confidence."""
        if not self.resolution_m > 0.0:
            raise ValueError(f"the resolution is {self.resolution_m} m, expected more than 0")
        if not 0.5 < self.confidence <= 1.0:
            raise ValueError(f"the confidence is {self.confidence}, expected above 0.5, at most 1")

    def sigma_m(self, scan: Scan) -> float:
        """Standard deviation [m] of a return's range, the cells' size included."""
        return float(np.hypot(scan.sensor.sigma_range_m, _ROUGHNESS * self.resolution_m))

    def reached(
        self, scan: Scan, ahead_m: Single, left_m: Single, radius_m: float | Single
    ) -> Mask:
        """(N,) whether a scan may change cells in discs whose middles are ahead and left (N,).

        Where it is False, `change` is zero for every cell of the disc.
        """
        if not len(scan.range_m):
            return np.zeros(len(ahead_m), dtype=bool)
        bound = scan.farthest(ahead_m, left_m, radius_m)
        distance = np.sqrt(ahead_m * ahead_m + left_m * left_m)
        margin = radius_m + (_FAR + _SLACK) * self.sigma_m(scan)
        return distance <= bound + margin

    def change(self, scan: Scan, ahead_m: Single, left_m: Single) -> Single:
        """(N,) log-odds that a scan adds to cells ahead and left (N,) of the scanner."""
        if not len(scan.range_m):
            return np.zeros(len(ahead_m), dtype=np.float32)
        sigma = self.sigma_m(scan)
        short = scan.short_of(ahead_m, left_m)
        change: Single = (short > _FAR * sigma) * np.float32(log_odds(self.model.p_free))
        close = np.flatnonzero(np.abs(short) <= _FAR * sigma)
        met = scan.beams_ahead(ahead_m[close].astype(float), left_m[close].astype(float))
        weight = self.model.probability(
            met.ahead_m, met.off_rad, sigma, scan.sensor.sigma_bearing_rad
        )
        change[close] = np.where(met.seen, log_odds(weight), 0.0)
        return change

    def add(self, odds: Single, change: Single) -> None:
        """Change log-odds (N,) in place, within bounds."""
        most = np.float32(log_odds(self.confidence))
        np.add(odds, change, out=odds)
        np.minimum(odds, most, out=odds)
        np.maximum(odds, -most, out=odds)


def unknown(count: int) -> Single:
    """Log-odds (N,) of cells that nothing is known of."""
    return np.full(count, log_odds(PRIOR), dtype=np.float32)


def known(odds: Single) -> Index:
    """Cells that anything is known of: log-odds are zero only where no scan spoke."""
    return np.flatnonzero(odds)
