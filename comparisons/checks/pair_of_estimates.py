"""Two estimates of one drive beside each other, without its log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.covariances import definite
from comparisons.errors import InputError, quoted
from comparisons.estimates.external import ExternalEstimate
from comparisons.logs.stamps import at_instants
from comparisons.plane import pose_difference, rms
from comparisons.shown import render
from comparisons.statistics import squared_distance

if TYPE_CHECKING:
    from pandas import DataFrame

Relation = Literal["independent", "filter-smoother"]


@dataclass(frozen=True, kw_only=True)
class EstimateComparison:
    """Hold what two estimates differ by.

    Attributes:
        time_s: (K,) that both have.
        difference: (K, 3) first less second: x, y [m], heading [rad], wrapped.
        sigma: (K, 3) of the covariance that the differences should have; NaN where an estimate has
            none, or where it is not positive definite.
        nees: (K,) squared differences by that covariance, 3 each; NaN as sigma.
        landmark: (L,) names of the landmarks that both have.
        landmark_difference: (L, 2) first less second [m].
        landmark_nees: (L,) as nees, 2 each.
        relation: What the covariance of a difference is: of `independent` estimates their sum; of
            a filter's and a smoother's of the same data the first's less the second's.
    """

    time_s: Array
    difference: Array
    sigma: Array
    nees: Array
    landmark: tuple[str, ...]
    landmark_difference: Array
    landmark_nees: Array
    relation: Relation

    @property
    def rms_m(self) -> float:
        """Root mean square of the positions' distances."""
        return rms(self.difference[:, :2])

    @property
    def rms_heading_rad(self) -> float:
        """Root mean square of the headings' differences."""
        return rms(self.difference[:, 2:])

    @property
    def nees_mean(self) -> float:
        """Mean of the poses' that are known; NaN where none is."""
        known = self.nees[np.isfinite(self.nees)]
        return float(known.mean()) if len(known) else float("nan")

    def __repr__(self) -> str:
        """Return the figures in one line."""
        return (
            f"<EstimateComparison: {len(self.time_s):,} poses {self.rms_m:.3g} m apart (RMS), NEES "
            f"{self.nees_mean:.3g} (expected 3); {len(self.landmark):,} landmarks "
            f"{rms(self.landmark_difference) if len(self.landmark) else 0.0:.3g} m apart>"
        )

    def to_pandas(self, table: Literal["poses", "landmarks"] = "poses") -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `poses`: time_s, dx_m, dy_m, dheading_rad, nees; `landmarks`: label, dx_m, dy_m,
                nees.

        Returns:
            One row for each time or landmark.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        found: DataFrame = render("frame", self, table)
        return found


def compare_pair(
    first: ExternalEstimate, second: ExternalEstimate, relation: Relation = "independent"
) -> EstimateComparison:
    """Return what two estimates differ by at the times and landmarks that both have.

    Args:
        first: Of a filter, where the two are a filter's and a smoother's.
        second: In the same frame, on the same clock.
        relation: What the covariance of their difference is, as of `EstimateComparison`.

    Returns:
        The differences, with their NEES where both have covariances.

    Raises:
        InputError: They share no time.
    """
    if relation not in ("independent", "filter-smoother"):
        raise InputError(f"relation is {quoted(relation)}, expected independent or filter-smoother")
    time_s = at_instants(first.time_s, second.time_s)
    shared, a, b = np.intersect1d(time_s, second.time_s, return_indices=True)
    if not len(shared):
        raise InputError(
            f"the estimates share no time: one is from {first.time_s[0]:.3f} to "
            f"{first.time_s[-1]:.3f} s, the other from {second.time_s[0]:.3f} to "
            f"{second.time_s[-1]:.3f} s"
        )
    difference = pose_difference(first.pose[a], second.pose[b])
    names, rows = _landmarks(first, second)
    apart = np.zeros((0, 2))
    if first.landmark is not None and second.landmark is not None:
        apart = first.landmark[rows[0]] - second.landmark[rows[1]]
    ours, theirs = first.landmark_covariance, second.landmark_covariance
    spread = _spread(
        _rows(first.pose_covariance, a), _rows(second.pose_covariance, b), difference, relation
    )
    return EstimateComparison(
        time_s=shared,
        difference=difference,
        sigma=np.sqrt(np.diagonal(spread, axis1=1, axis2=2)),
        nees=nees_of(difference, spread),
        landmark=names,
        landmark_difference=apart,
        landmark_nees=nees_of(
            apart, _spread(_rows(ours, rows[0]), _rows(theirs, rows[1]), apart, relation)
        ),
        relation=relation,
    )


def _landmarks(
    first: ExternalEstimate, second: ExternalEstimate
) -> tuple[tuple[str, ...], tuple[list[int], list[int]]]:
    """Names that both have, and their rows; by label where there are labels, else by id."""
    places = []
    for estimate in (first, second):
        ids = [] if estimate.landmark_id is None else np.asarray(estimate.landmark_id).tolist()
        places.append({estimate.labels.get(i, str(i)): row for row, i in enumerate(ids)})
    names = tuple(name for name in places[0] if name in places[1])
    return names, ([places[0][name] for name in names], [places[1][name] for name in names])


def _rows(covariance: Array | None, rows: Index | list[int]) -> Array | None:
    return None if covariance is None else covariance[rows]


def _spread(first: Array | None, second: Array | None, difference: Array, relation: str) -> Array:
    """(N, d, d) of differences (N, d); NaN where it is unknown or not positive definite."""
    count, size = difference.shape
    if first is None or second is None or not count:
        return np.full((count, size, size), np.nan)
    return if_definite(first + second if relation == "independent" else first - second)


def if_definite(covariance: Array) -> Array:
    """Return covariances (N, d, d), N at least 1; NaN where they are not positive definite."""
    return np.where(definite(covariance)[:, None, None], covariance, np.nan)


def nees_of(difference: Array, spread: Array) -> Array:
    """Return squared differences (N, d) by their covariances (N, d, d); NaN where these are."""
    found: Array = np.full(len(difference), np.nan)
    good = np.isfinite(spread).all(axis=(1, 2))
    found[good] = squared_distance(difference[good], spread[good])
    return found
