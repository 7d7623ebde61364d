"""Attributes of landmarks from a layer of the dense map (Nieto 2005, section 6.4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ekf_reference.association.attributes import (
    AttributeDistances,
    AttributeEstimates,
    compared,
    population,
)
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.measurements import MeasuredAttributes, Measurements


class LayerValues(Protocol):
    """Whoever keeps a layer of the dense map, which the landmarks lie in."""

    def values_at(self, landmark_index: Index) -> tuple[Array, Array, Array]:
        """Return mean, variance (NaN: none) and count of returns around landmarks (L,) by index."""


@dataclass(frozen=True)
class LayerAttributes:
    """One attribute is read from a layer of the dense map, the others are remembered.

    The landmark's is what all scans have shown around its place, whatever its seen were
    taken for; the measurement's, in `column`, is what its own scan shows around it.
    """

    memory: AttributeEstimates
    layer: LayerValues
    column: int

    def distances(self, landmark_index: Index, seen: Measurements) -> AttributeDistances:
        """Return the distances; a return scatters as the layer's do, beside its noise."""
        own, column = seen.attributes, self.column
        others = own.value.copy()
        others[:, column] = np.nan
        remembered = MeasuredAttributes(others, own.variance)
        first = self.memory.distances(landmark_index, replace(seen, attributes=remembered))
        mean, scatter, count = self.layer.values_at(landmark_index)
        noise = own.variance[:, column].mean()  # of one return, in the layer as here
        variance = scatter + noise / np.maximum(count, 1.0)
        shown = MeasuredAttributes(own.value[:, [column]], own.variance[:, [column]])
        known = mean[:, None], variance[:, None]
        second = compared(shown, *known, population(*known))
        return AttributeDistances(
            first.nis + second.nis, first.n + second.n, first.dof + second.dof
        )
