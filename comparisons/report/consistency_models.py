"""The part of `result.json` that says whether the filter is as sure as it may be."""

from __future__ import annotations

from comparisons.report.model import Model


class NeesResult(Model):
    """Normalised errors squared, each with `dof`. See checks.consistency.normalised.

    mean: `dof` is right. Over time, and over landmarks of one run, the values are correlated: no
    band holds for their average. single_band: 95 % of single values lie in it; inside: the share
    that do. last: the last value. unusable: errors without one, by reason.
    """

    dof: int
    count: int
    mean: float | None
    last: float | None
    single_band: tuple[float, float]
    inside: float | None
    unusable: dict[str, int]


class TruthConsistencyResult(Model):
    """NEES against truth, of errors in the log's frame, additive in x, y and wrapped heading.

    pose, position, heading: over the epochs. landmarks: each alone; map: jointly; whole: with the
    last pose. distance, distances: lengths of a spanning tree over landmarks and last pose, which
    no frame touches, each alone and jointly; too_short: those left out.
    """

    pose: NeesResult | None
    position: NeesResult | None
    heading: NeesResult | None
    landmarks: NeesResult | None
    map: NeesResult | None
    whole: NeesResult | None
    distance: NeesResult | None
    distances: NeesResult | None
    too_short: int


class NisResult(Model):
    """An average of normalised innovations squared, with its own 95 % band."""

    name: str
    dof: int
    count: int
    mean: float
    band: tuple[float, float]
    reading: str


class WhitenessResult(Model):
    """See comparisons.checks.consistency.innovations.Whiteness. band: half widths, lag by lag."""

    component: str
    order: str
    autocorrelation: list[float]
    band: list[float]
    p_value: float
    mean: float
    mean_band: float


class InnovationResult(Model):
    """One sensor's innovations. See comparisons.checks.consistency.innovations."""

    sensor: str
    nis: list[NisResult]
    whiteness: list[WhitenessResult]
    unusable: int


class FilterAgainstSmootherResult(Model):
    """Filtered poses against smoothed ones. See comparisons.checks.consistency.filter_smoother.

    squared_per_dof: 1 is right; inside: share of the epochs in their single 95 % band. least_ratio:
    smallest variance of the filter over the smoother's, at least_ratio_s; surer_epochs: how many
    have one clearly below 1, from surer_since_s on.
    """

    epochs: int
    squared_per_dof: float | None
    inside: float | None
    least_ratio: float | None
    least_ratio_s: float | None
    surer_epochs: int
    surer_since_s: float | None
    unusable: dict[str, int]


class ConsistencyResult(Model):
    """By truth for both estimators, by the filter's innovations, by the smoother."""

    ekf: TruthConsistencyResult | None
    smoother: TruthConsistencyResult | None
    innovations: list[InnovationResult]
    filter_against_smoother: FilterAgainstSmootherResult | None
