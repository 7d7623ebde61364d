"""Settings of dense maps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field, field_validator

from comparisons.choices import Layer
from comparisons.config import Configured, ExtensionConfig
from ekf_reference.dense.layers.occupancy import Coarsening

if TYPE_CHECKING:
    from comparisons.extensions.dense_maps.extension import DenseMaps

_Cell = Annotated[float, Field(ge=0.01, le=10.0)]
FlipTest = Literal["joint", "ellipses"]


class Bounds(NamedTuple):
    """Bounds of regions and of what waits for one, where they depend on the landmarks."""

    known_apart_m: float
    longest_edge_m: float
    reach_m: float
    patience: int
    capacity: int


AMONG_POINTS = Bounds(0.5, 35.0, 35.0, 16, 5_000)
AMONG_SCANS = Bounds(1.5, 60.0, 50.0, 64, 20_000)
"""Of regions anchored to scan landmarks alone, which stand 20 m apart and more where points stand
5 m apart: regions are larger, and it takes longer until there are three landmarks."""


BARE: Mapping[str, Any] = {"detect_motion": False, "attribute_values": False, "coarsening": None}
"""Of a map that another extension keeps for itself."""


class DenseMapsConfig(ExtensionConfig):
    """Keep what the scanner saw between the filter's landmarks (DenseSLAM, Nieto 2005, chapter 3).

    Lengths in metres. The map is compared with the smoother's where layers are asked for; it may
    also serve others: detect_motion looks for what moves, attribute_values keeps the values that
    association goes by.
    """

    layers: tuple[Layer, ...] = Field((), description="kept, and compared with the smoother's")
    resolution_m: _Cell = Field(0.2, description="size of cells")
    d_min_m: _Cell = Field(0.2, description="least distance of two Gaussians, of two particles")
    p_occupied: float = Field(
        0.65, gt=0.5, lt=1.0, description="of a grid's cell, given one return from it"
    )
    p_free: float = Field(
        0.45, gt=0.0, lt=0.5, description="of occupancy of a grid's cell, given one look past it"
    )
    least_correlation: float = Field(
        0.9, ge=-1.0, le=1.0, description="of each two landmarks of a region"
    )
    known_apart_m: float | None = Field(
        None,
        ge=0.0,
        description="relative sigma up to which any correlation will do, 0 for none; if absent, "
        "0.5, on scan landmarks alone 1.5",
    )
    longest_edge_m: float | None = Field(
        None, description="of a region; if absent, 35, on scan landmarks alone 60"
    )
    flip_test: FlipTest = Field(
        "joint",
        description="whether a region may turn over: by its corners' joint covariance, or by the "
        "ellipse of each alone",
    )
    coarsening: Coarsening | None = Field(
        None, description="of the occupancy layer's almost empty regions"
    )
    known_m: float = Field(
        math.inf, description="the vehicle's relative sigma up to which its scans are taken in"
    )
    reach_m: float | None = Field(
        None,
        description="how far from the vehicle returns are taken in; if absent, 35, on scan "
        "landmarks alone 50",
    )
    delayed: bool = Field(True, description="keep returns until there is a region for them")
    virtual_landmarks: bool = Field(True, description="allow regions with a virtual corner")
    patience: int | None = Field(
        None,
        description="scans that returns wait for a third landmark; if absent, 16, on scan "
        "landmarks alone 64",
    )
    capacity: int | None = Field(
        None,
        description="returns that may wait; if absent, 5,000, on scan landmarks alone 20,000",
    )
    detect_motion: bool = Field(False, description="look for what moves")
    attribute_values: bool = Field(False, description="keep values for association")

    @field_validator("layers")
    @classmethod
    def _once(cls, layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
        return tuple(dict.fromkeys(layers))

    @property
    def kept_layers(self) -> tuple[str, ...]:
        """All that the map holds, for whomever."""
        values = ("values",) if self.attribute_values else ()
        return tuple(dict.fromkeys((*self.layers, *values)))

    @property
    def first_condition(self) -> str:
        """Return the rule by which pairs of landmarks may share a region, in words."""
        correlated = f"pairs with correlation >= {self.least_correlation:g}"
        apart_m = self.bounds.known_apart_m
        if apart_m <= 0.0:
            return f"{correlated} (N 3.5)"
        return f"{correlated} or relative sigma <= {apart_m:g} m (N 3.5: correlation alone)"

    @property
    def bounds(self) -> Bounds:
        """Return what was given, where nothing was that of regions among points."""
        found = self.settled().model_dump(include=set(Bounds._fields))
        return Bounds(**found)

    def check_with(self, config: Configured) -> None:
        """A map that keeps nothing is a mistake."""
        if not (self.layers or self.detect_motion or self.attribute_values):
            raise ValueError(
                "dense_maps.layers: empty, expected some of points, occupancy, particles, sog, "
                "values (--dense); --resolution alone asks for no map"
            )

    def settled(self, *, points: bool = True) -> DenseMapsConfig:
        """Return the same with nothing left open.

        points: regions are anchored to points, not to scan landmarks alone.
        """
        usual = AMONG_POINTS if points else AMONG_SCANS
        left_open = {k: v for k, v in usual._asdict().items() if getattr(self, k) is None}
        return self.model_copy(update=left_open)

    def build(self, config: Configured) -> DenseMaps:
        """Return the extension."""
        from comparisons.extensions.dense_maps.extension import DenseMaps

        return DenseMaps(self)
