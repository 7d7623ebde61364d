"""The measurements of one instant, and the interface of the rules that associate them."""

from dataclasses import KW_ONLY, dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index, Mask
from ekf_reference.core.landmark_types import POINT, LandmarkKind, MeasurementModel
from ekf_reference.core.state import KalmanState

REJECTED = -1
"""Not used: without a label, or a label that the gate contradicts."""
AMBIGUOUS = -2
"""Not used: too far from every landmark to join it, too near to start another, or beaten to it."""
CANDIDATE = -3
"""Not used yet: it may become a landmark (see association.landmark_initiation)."""
DYNAMIC = -4
"""Not used: of something that moves (see association.dynamic_rejection)."""


@dataclass(frozen=True)
class MeasuredAttributes:
    """The A attributes of m measurements, in any units, that tell landmarks apart.

    value: (m, A), NaN where not measured. variance: (m, A). A = 0 serves any m.
    """

    value: Array
    variance: Array

    def take(self, rows: Index) -> Self:
        """Return some rows.

        Args:
            rows: (k,) of the measurements.

        Returns:
            Attributes of these.
        """
        if not self.value.size:
            return self
        return replace(self, value=self.value[rows], variance=self.variance[rows])


NOT_MEASURED = MeasuredAttributes(np.zeros((1, 0)), np.zeros((1, 0)))


@dataclass(frozen=True)
class Measurements:
    """m measurements of landmarks of one kind.

    z: (m, w), of points range [m] and bearing [rad], of poses x, y [m] and heading [rad] in the
    vehicle's frame. noise: (m, w, w), R. identity: (m,) labels, negative where the sensor gave
    none. kind: of the landmarks. time_s: when. attributes: what else was measured. closed: landmark
    indices they cannot be of.
    """

    z: Array
    noise: Array
    identity: NDArray[np.int64]
    _: KW_ONLY
    kind: LandmarkKind = POINT
    time_s: float = 0.0
    attributes: MeasuredAttributes = NOT_MEASURED
    closed: tuple[int, ...] = ()

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.z)

    def take(self, rows: Index) -> Self:
        """Return some rows.

        Args:
            rows: (k,) of the measurements.

        Returns:
            These, of the same instant.
        """
        own = {name: getattr(self, name)[rows] for name in ("z", "noise", "identity")}
        return replace(self, **own, attributes=self.attributes.take(rows))


class Association(Protocol):
    """Contract of all association rules."""

    def assign(self, state: KalmanState, model: MeasurementModel, seen: Measurements) -> Index:
        """Find the landmark of each measurement.

        Args:
            state: The filter's, after the prediction; not to be changed.
            model: How these landmarks are measured.
            seen: Measurements of one instant.

        Returns:
            (m,) landmark indices of the state, or negative codes of what is not used. Indices from
            the present landmark count upward name new landmarks, in order.
        """


class DynamicGuard(Protocol):
    """Tells where things move."""

    def is_dynamic(self, point: Array) -> Mask:
        """Tell which points lie in a dynamic region.

        Args:
            point: (N, 2) east, north [m].

        Returns:
            (N,) which.
        """
