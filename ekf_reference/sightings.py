"""The sightings of one instant, as every filter and association rule takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sightings:
    """m detections of landmarks.

    z: (m, 2) range [m] and bearing [rad]. noise: (m, 2, 2), R. identity: (m,) labels, negative
    where the sensor gave none. time_s: when.
    """

    z: Array
    noise: Array
    identity: NDArray[np.int64]
    time_s: float = 0.0

    def __len__(self) -> int:
        """M."""
        return len(self.z)

    def take(self, rows: NDArray[np.intp]) -> Sightings:
        """Some of them."""
        return Sightings(self.z[rows], self.noise[rows], self.identity[rows], self.time_s)
