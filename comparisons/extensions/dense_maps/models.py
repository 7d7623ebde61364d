"""What `result.json` and `map.json` say of dense maps."""

from __future__ import annotations

from comparisons.report.model import Model


class SurfaceErrorResult(Model):
    """What is occupied against true surfaces; None where nothing is. occupied: how much."""

    median_m: float | None
    p95_m: float | None
    occupied: int


class DenseLayerResult(Model):
    """A layer of the filter's dense map against the smoother's returns.

    See comparisons.extensions.dense_maps.check.LayerAgreement.
    """

    samples: int
    median_m: float
    p95_m: float
    missed_m: float


class DenseRegionResult(Model):
    """One region of one layer."""

    layer: str
    region: int
    samples: int
    distance_m: float


class HighLevelResult(Model):
    """High level landmarks. See comparisons.extensions.high_level.source.HighLevelRun.

    corners, pairs: of all searches, None in results of before they were counted. found: accepted by
    one. kept: seen again, and since then in the state. looks: at those within reach, by outcome,
    `seen` among them.
    """

    searches: int
    corners: int | None = None
    pairs: int | None = None
    candidates: int
    poor: int
    found: int
    kept: int
    looks: dict[str, int]


class DenseResult(Model):
    """Dense maps of filter and smoother. regions: the worst first, at most twenty.

    occupancy_share: of the cells decided in both maps, those decided alike.
    """

    agrees: bool
    layers: dict[str, DenseLayerResult]
    occupancy_share: float | None
    regions: list[DenseRegionResult]
    surface_errors: dict[str, SurfaceErrorResult]
