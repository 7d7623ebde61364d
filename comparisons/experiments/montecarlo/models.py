"""`montecarlo.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from typing import Any, Literal

from comparisons.report.model import Model


class ConsistencyResult(Model):
    """See comparisons.experiments.montecarlo.statistics.Consistency."""

    anees: float | None
    band: tuple[float | None, float | None]
    place: Literal["below", "inside", "above", "not given"]
    share_above: float | None


class LastPosesResult(Model):
    """How many of the runs' last poses have a NEES within its band, and the count's band."""

    inside: int
    of: int
    band: tuple[int, int]


class MonteCarloFilterResult(Model):
    """One filter. consistency: by pose, position, heading, landmarks."""

    lost: int
    consistency: dict[str, ConsistencyResult]
    rmse_position_m: float | None
    rmse_heading_rad: float | None
    rmse_landmark_m: float | None
    last_pose_inside: LastPosesResult


class FailureResult(Model):
    """A run that an external filter failed on."""

    seed: int
    reason: str


class PairResult(Model):
    """First minus second, per run. See comparisons.experiments.montecarlo.statistics.Pair."""

    first: str
    second: str
    what: str
    mean: float | None
    interval: tuple[float | None, float | None]
    runs: int
    lower: int
    higher: int
    family_interval: tuple[float | None, float | None]
    sign_p: float | None


class MonteCarloResult(Model):
    """The whole file; the same bytes however the work was spread.

    config: repeats the study. level: of bands, intervals. failures: of external filters, by name.
    final_map: figures of landmarks are those of the last step alone, as there is an external one.
    """

    config: dict[str, Any]
    scenario: str
    description: str
    sha256: str
    runs: int
    steps: int
    recorded_steps: int
    duration_s: float
    landmarks: int
    level: float
    filters: dict[str, MonteCarloFilterResult]
    pairs: list[PairResult]
    final_map: bool
    failures: dict[str, list[FailureResult]]
