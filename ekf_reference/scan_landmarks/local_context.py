"""What a dense map holds around a scan landmark, to enrich its template (Nieto 2005, 6.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array, rotation, to_frame, to_world
from ekf_reference.dense.dense_map import DenseMap
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.scan_landmarks.templates import Template
from ekf_reference.scan_matching.sog import SumOfGaussians


@dataclass(frozen=True)
class LocalContext:
    """Reads a dense map with the layers `sog` and `occupancy`, as its landmarks now lie.

    margin_m: from the template's points to the sides of the rectangle (Fig. 6.8 b) whose Gaussians
    are taken. occupied: least occupancy of the cell that one lies in. least: fewer than so many
    do not pay.
    """

    dense: DenseMap
    margin_m: float = 5.0
    occupied: float = 0.5
    least: int = 20

    def rectangle(self, template: Template) -> Array:
        """(4, 2) in the landmark's axis, counter-clockwise."""
        low = template.shape.mean.min(axis=0) - self.margin_m
        high = template.shape.mean.max(axis=0) + self.margin_m
        return np.array(((low[0], low[1]), (high[0], low[1]), high, (low[0], high[1])))

    def around(self, template: Template, place: Array) -> SumOfGaussians | None:
        """The Gaussians in the rectangle of a landmark at a place (3,), in its axis."""
        layer, area = self.dense.layers["sog"], self.rectangle(template)
        if not isinstance(layer, Gaussians):
            raise TypeError(f"{type(layer).__name__} is no sum of Gaussians")
        placed = self.dense.regions.placed(self.dense.landmark)
        outline = to_world(place, area)
        box = np.concatenate((outline.min(axis=0), outline.max(axis=0)))
        there = layer.ellipses(placed, np.sort(placed.tree.meeting(box[None]).item))
        mean = to_frame(place, there.mean)
        inside = np.flatnonzero(((mean >= area[0]) & (mean <= area[2])).all(axis=1))
        stands = self.dense.layers["occupancy"].occupancy(there.mean[inside], placed)
        inside = inside[stands >= self.occupied]
        if len(inside) < self.least:
            return None
        turn = rotation(float(place[2]))
        spread = turn.T @ there.covariance[inside] @ turn
        return SumOfGaussians.of_equal_height(mean[inside], spread)
