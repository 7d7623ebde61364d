"""Settings of dense maps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, field_validator

from comparisons.config import Configured, ExtensionConfig, setting
from comparisons.options import SCANS, Option
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation
from ekf_reference.dense.layers.occupancy import Coarsening

_Cell = Annotated[float, Field(ge=0.01, le=10.0)]
FlipTest = Literal["joint", "ellipses"]
Layer = Literal["points", "occupancy", "particles", "sog"]


class Bounds(NamedTuple):
    """Bounds of regions and of what waits for one, where they depend on the landmarks."""

    known_apart_m: float
    longest_edge_m: float
    reach_m: float
    patience: int
    capacity: int


AMONG_POINTS = Bounds(
    0.5, 35.0, 35.0, DelayedInitialisation.patience, DelayedInitialisation.capacity
)
AMONG_SCANS = Bounds(1.5, 60.0, 50.0, 64, 20_000)
"""Of regions anchored to scan landmarks alone, which stand 20 m apart and more where points stand
5 m apart: regions are larger, and it takes longer until there are three landmarks."""


BARE: Mapping[str, Any] = {"detect_motion": False, "coarsening": None}
"""Of a map that another extension keeps for itself."""


class DenseMapsConfig(ExtensionConfig):
    """Dense map in triangles of the filter's landmarks (DenseSLAM, Nieto 2005, chapter 3).

    Lengths in metres. The map is compared with the smoother's where layers are asked for; it may
    also look for what moves: detect_motion.
    """

    extension = "comparisons.extensions.dense_maps.extension:DenseMaps"
    layers: tuple[Layer, ...] = setting(
        (),
        "Layers to build and to compare with those of the smoother. sog: sum of Gaussians",
        Option(
            "--dense",
            SCANS,
            "Dense map layer (repeatable): points, occupancy, particles or sog (sum of Gaussians).",
            jobs=("run",),
        ),
        Option(
            "--layer",
            SCANS,
            "Map layer (repeatable): points, occupancy, particles or sog (sum of Gaussians). "
            "[occupancy]",
            jobs=("map",),
        ),
    )
    resolution_m: _Cell = setting(
        0.2,
        "Cell size in metres",
        Option("--resolution", SCANS, "Cell size of the dense map in metres. [0.2]", metavar="M"),
    )
    d_min_m: _Cell = setting(0.2, "Least distance of two Gaussians or particles in metres")
    thinned: bool = setting(True, "Drop particles and Gaussians that have come to lie on others")
    p_occupied: float = setting(
        0.65, "Probability that a grid cell is occupied, given one return", gt=0.5, lt=1.0
    )
    p_free: float = setting(
        0.45, "Probability that a grid cell is occupied, given one ray through it", gt=0.0, lt=0.5
    )
    confidence: float = setting(
        0.98,
        "Bound of the probability that a cell or a particle is occupied, and that it is free; "
        "1: none",
        gt=0.5,
        le=1.0,
    )
    least_weight: float = setting(
        0.3, "Weight below which a particle is dropped; 0: none is", ge=0.0, lt=0.5
    )
    least_correlation: float = setting(
        0.9, "Least correlation of any two landmarks of a region", ge=-1.0, le=1.0
    )
    known_apart_m: float | None = setting(
        None,
        "Relative sigma in metres below which two landmarks may share a region at any "
        "correlation; 0: none. Default: 0.5, on scan landmarks alone 1.5",
        ge=0.0,
    )
    longest_edge_m: float | None = setting(
        None, "Longest edge of a region in metres. Default: 35, on scan landmarks alone 60"
    )
    flip_test: FlipTest = setting(
        "joint",
        "Test whether a triangle may flip. joint: joint covariance of its corners; "
        "ellipses: the error ellipse of each corner",
    )
    coarsening: Coarsening | None = setting(
        None, "Coarser cells in almost empty regions of the occupancy layer. Default: none"
    )
    known_m: float = setting(
        math.inf, "Greatest relative sigma of the vehicle, in metres, at which its scans are mapped"
    )
    reach_m: float | None = setting(
        None,
        "Greatest range of mapped returns in metres. Default: 35, on scan landmarks alone 50",
        gt=0.0,
        le=1e4,
    )
    delayed: bool = setting(True, "Buffer returns until a region for them exists")
    virtual_landmarks: bool = setting(True, "Allow regions with a virtual landmark as a corner")
    patience: int | None = setting(
        None,
        "Number of scans for which buffered returns wait for a third landmark. "
        "Default: 16, on scan landmarks alone 64",
    )
    capacity: int | None = setting(
        None, "Greatest number of buffered returns. Default: 5000, on scan landmarks alone 20000"
    )
    detect_motion: bool = setting(False, "Detect moving objects (set by --dynamic)")

    @field_validator("layers")
    @classmethod
    def _once(cls, layers: tuple[Layer, ...]) -> tuple[Layer, ...]:
        return tuple(dict.fromkeys(layers))

    @property
    def first_condition(self) -> str:
        """Return the rule by which pairs of landmarks may share a region, in words."""
        correlated = f"pairs with correlation >= {self.least_correlation:g}"
        apart_m = self.bounds.known_apart_m
        if apart_m <= 0.0:
            return f"{correlated} (Nieto 2005, 3.5)"
        return (
            f"{correlated} or relative sigma <= {apart_m:g} m (Nieto 2005, 3.5: correlation alone)"
        )

    @property
    def bounds(self) -> Bounds:
        """Return what was given, where nothing was that of regions among points."""
        found = self.settled().model_dump(include=set(Bounds._fields))
        return Bounds(**found)

    def check_with(self, config: Configured) -> None:
        """A map that keeps nothing is a mistake."""
        if not (self.layers or self.detect_motion):
            raise ValueError(
                "dense_maps.layers: empty, expected some of points, occupancy, particles, sog "
                "(--dense); --resolution alone asks for no map"
            )

    def settled(self, *, points: bool = True) -> DenseMapsConfig:
        """Return the same with nothing left open.

        points: regions are anchored to points, not to scan landmarks alone.
        """
        usual = AMONG_POINTS if points else AMONG_SCANS
        left_open = {k: v for k, v in usual._asdict().items() if getattr(self, k) is None}
        return self.model_copy(update=left_open)
