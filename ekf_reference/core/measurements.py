"""The sightings of one instant, as every filter and association rule takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index


@dataclass(frozen=True)
class MeasuredAttributes:
    """What m sightings tell of their landmarks besides where they are: A attributes, in any units.

    value: (m, A), NaN where not measured. variance: (m, A). Without columns, of any number of
    sightings.
    """

    value: Array
    variance: Array

    def take(self, rows: Index) -> MeasuredAttributes:
        """Some of them."""
        if not self.value.shape[1]:
            return self
        return MeasuredAttributes(self.value[rows], self.variance[rows])


NOT_MEASURED = MeasuredAttributes(np.zeros((1, 0)), np.zeros((1, 0)))


@dataclass(frozen=True)
class Sightings:
    """m detections of landmarks.

    z: (m, 2) range [m] and bearing [rad]. noise: (m, 2, 2), R. identity: (m,) labels, negative
    where the sensor gave none. time_s: when. attributes: what else was measured.
    """

    z: Array
    noise: Array
    identity: NDArray[np.int64]
    time_s: float = 0.0
    attributes: MeasuredAttributes = NOT_MEASURED

    def __len__(self) -> int:
        """M."""
        return len(self.z)

    def take(self, rows: Index) -> Sightings:
        """Some of them."""
        columns = self.z[rows], self.noise[rows], self.identity[rows]
        return Sightings(*columns, self.time_s, self.attributes.take(rows))
