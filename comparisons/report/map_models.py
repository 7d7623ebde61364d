"""`map.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from comparisons.extensions.dense_maps.models import SurfaceErrorResult
from comparisons.report.model import Model
from comparisons.report.models import (
    AccuracyResult,
    EkfResult,
    LogResult,
)


class LayerResult(Model):
    """A layer. samples: cells, points or Gaussians held; occupied: those above 0.8."""

    samples: int
    occupied: int


class ReturnsResult(Model):
    """What became of the scanner's returns.

    late: fused after a wait. outside: where no region can be. waiting: still, at the end. lost:
    from the waiting room, which was full, or with a landmark.
    """

    scans: int
    returns: int
    fused: int
    late: int
    outside: int
    waiting: int
    lost: int


class ClosingResult(Model):
    """The update that moved the regions the most."""

    time_s: float
    shift_m: float


class DynamicResult(Model):
    """Where something moves.

    places: connected ones. cells, area_m2: flagged. fast, slow: of these, by what showed them
    first. compared: pairs of maps; deformed: pairs that could not be, since the region's landmarks
    had moved against each other. landmarks: ids of those in the map that stand in such a place.
    """

    places: int
    cells: int
    area_m2: float
    fast: int
    slow: int
    compared: int
    deformed: int
    landmarks: list[int]


class MapResult(Model):
    """`map.json`: a dense map between the filter's landmarks, points and pieces of scans."""

    log: LogResult
    ekf: EkfResult
    accuracy: AccuracyResult | None
    scan_landmarks: int
    regions: int
    resolution_m: float
    returns: ReturnsResult
    layers: dict[str, LayerResult]
    surface_errors: dict[str, SurfaceErrorResult]
    closing: ClosingResult | None
    dynamic: DynamicResult | None
    remarks: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]
