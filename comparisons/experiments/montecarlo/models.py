"""`montecarlo.json`, for machines. The models are the file's documentation."""

from __future__ import annotations

from typing import Any, Literal

from comparisons.figures import Model


class ConsistencyResult(Model):
    """Average NEES over runs and time.

    See comparisons.experiments.montecarlo.statistics.Consistency.

    Attributes:
        anees: average normalised estimation error squared.
        band: its two-sided band at the study's level.
        place: where it is relative to the band.
        share_above: share of the steps whose own average over the runs is above the band.
    """

    anees: float | None
    band: tuple[float | None, float | None]
    place: Literal["below", "inside", "above", "not given"]
    share_above: float | None


class LastPosesResult(Model):
    """NEES of the runs' last poses.

    Attributes:
        inside: runs whose value is within its band.
        of: runs that have a value.
        band: band of the number of such runs.
    """

    inside: int
    of: int
    band: tuple[int, int]


class MonteCarloFilterResult(Model):
    """One filter of the study.

    Attributes:
        lost: runs in which it was lost.
        consistency: by pose, position, heading and landmarks.
        rmse_position_m: root mean square error of the positions.
        rmse_heading_rad: root mean square error of the headings.
        rmse_landmark_m: root mean square error of the landmarks.
        last_pose_inside: NEES of the last poses.
    """

    lost: int
    consistency: dict[str, ConsistencyResult]
    rmse_position_m: float | None
    rmse_heading_rad: float | None
    rmse_landmark_m: float | None
    last_pose_inside: LastPosesResult


class FailureResult(Model):
    """A run in which an external filter failed.

    Attributes:
        seed: seed of the run.
        reason: what happened.
    """

    seed: int
    reason: str


class PairResult(Model):
    """Two filters compared run by run: first minus second.

    See comparisons.experiments.montecarlo.statistics.Pair.

    Attributes:
        first: name of the first filter.
        second: name of the second filter.
        what: quantity that is compared.
        mean: average difference.
        interval: confidence interval of the average.
        runs: runs that both completed.
        lower: runs in which the first is lower.
        higher: runs in which the first is higher.
        family_interval: the interval, corrected for the number of pairs.
        sign_p: chance of such numbers if neither is lower (sign test).
    """

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
    """`montecarlo.json`: a Monte Carlo study.

    The same bytes however the work was spread.

    Attributes:
        config: all settings; they repeat the study.
        scenario: name of the scenario.
        description: what it is.
        sha256: hash of the scenario.
        runs: number of runs.
        steps: steps of a run.
        recorded_steps: steps at which figures were recorded.
        duration_s: duration of a run.
        landmarks: landmarks of the scenario.
        level: level of bands and intervals.
        filters: each filter, by name.
        pairs: each pair of filters.
        final_map: figures of landmarks are of the last step alone, since an external filter takes
            part.
        failures: failed runs of external filters, by name.
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
