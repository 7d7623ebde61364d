"""Consistency as a check: part of `result.json`, rows of figures, and a line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from comparisons.checks.check import Check
from comparisons.checks.consistency.consistency import (
    Consistency,
    ExternalConsistency,
    check_consistency,
    external_consistency,
    inconsistencies,
)
from comparisons.checks.consistency.filter_smoother import FilterAgainstSmoother
from comparisons.checks.consistency.nees import TruthConsistency, against_truth
from comparisons.checks.finding import Absent, Of
from comparisons.figures import Model, band
from comparisons.innovations import InnovationFigures
from comparisons.statistics import BlockDeparture
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

_NEES_BANDS = "95 % bands; the verdict: pose and landmarks at 99.9 %"
_NIS_BANDS = "95 % bands; the verdict: NIS alone, at 99.9 %"
"""A consistent filter leaves one of twenty bands of 95 %; see checks.qualifiers.inconsistencies."""


class ConsistencyResult(Model):
    """Consistency by truth, by the filter's innovations, and by the smoother.

    Attributes:
        ekf: the filter by truth.
        smoother: the smoother by truth.
        innovations: each sensor.
        filter_against_smoother: the filter by the smoother.
    """

    ekf: TruthConsistency | None
    smoother: TruthConsistency | None
    innovations: list[InnovationFigures]
    filter_against_smoother: FilterAgainstSmoother | None


class ExternalConsistencyResult(Model):
    """Consistency of an external estimate's covariances, by truth and by the smoother.

    Attributes:
        truth: by truth.
        filter_against_smoother: by the smoother.
        unjudged: why there is no comparison with the smoother.
    """

    truth: TruthConsistency | None
    filter_against_smoother: FilterAgainstSmoother | None
    unjudged: str


class ConsistencyFinding(Of[Consistency]):
    """What of a filter is outside its band, and what is within."""

    def __init__(self, consistency: Consistency, name: str = "EKF") -> None:
        """found: by truth, innovations and smoother. name: of what is judged, in rows."""
        self.name, self.result = name, consistency_result(consistency)
        super().__init__(
            consistency, remarks=consistency.remarks, entries={"consistency": self.result}
        )
        if isinstance(consistency, ExternalConsistency):
            self.entries = {"consistency": external_consistency_result(consistency)}
        self.lines = consistency_lines(inconsistencies(consistency), self.result)

    def rows(self) -> Sequence[Row]:
        """Return NEES of both estimators, NIS by sensor, and the filter by the smoother."""
        c, name = self.result, self.name
        return [
            *nees_rows(name[:1].upper() + name[1:], c.ekf, _NEES_BANDS),
            *nees_rows("Smoother", c.smoother),
            *innovation_rows(c.innovations),
            *smoothed_rows(name, c.filter_against_smoother),
        ]


class CheckConsistency(Check):
    """Is the filter as sure as it may be, by truth, by its innovations, by the smoother?"""

    name = "consistency"
    needs = "innovations; truth for the NEES; the batch smoother, without a kernel, for the rest"
    errs = "1 of 1,000 sound runs by NIS, 5 of 520 by filter against smoother"
    figures = (("consistency", ConsistencyResult),)

    def find(self, known: Known) -> ConsistencyFinding | Absent:
        """Return the statistics that the log allows; they have no say in the verdict."""
        if known.given is not None:
            return ConsistencyFinding(external_consistency(known, known.given), "estimate")
        log, labelled = known.prepared.log, known.prepared.labelled
        if known.run is None:
            truth = against_truth(known.smoothed, log, labelled=labelled)
            if truth is None:
                return Absent(f"the log has no truth, and {known.without}")
            return ConsistencyFinding(Consistency(None, truth, (), None, gated=not labelled))
        smoothed, robust = None, "none"
        if known.solved is not None:
            smoothed, robust = known.smoothed, known.result.options.robust
        return ConsistencyFinding(
            check_consistency(log, known.ekf, smoothed, labelled=labelled, robust=robust)
        )


def consistency_result(c: Consistency) -> ConsistencyResult:
    """The check's figures, without errors of which no covariance was handed in."""
    judged = c.ekf is not None and (c.ekf.pose is not None or c.ekf.map is not None)
    return ConsistencyResult(
        ekf=c.ekf if judged else None,
        smoother=c.smoother,
        innovations=list(c.sensors),
        filter_against_smoother=c.smoothed,
    )


def external_consistency_result(c: ExternalConsistency) -> ExternalConsistencyResult:
    """An external estimate's."""
    return ExternalConsistencyResult(
        truth=consistency_result(c).ekf, filter_against_smoother=c.smoothed, unjudged=c.unjudged
    )


def innovation_rows(innovations: Sequence[InnovationFigures]) -> list[Row]:
    """Return NIS and the first autocorrelation of each sensor and component."""
    rows = list[Row]()
    for sensor in innovations:
        group = f"Innovations of {sensor.sensor} ({_NIS_BANDS})"
        rows += sensor.nis_rows(group)
        rows += [
            Row(
                group,
                f"lag-1 autocorrelation, {w.component} by {w.order}",
                f"{w.autocorrelation[0]:.2g}",
                band(f"{-w.band[0]:.2g}", f"{w.band[0]:.2g}"),
                abs(w.autocorrelation[0]) <= w.band[0],
            )
            for w in sensor.whiteness
        ]
    return rows


def nees_rows(name: str, t: TruthConsistency | None, bands: str = "95 % bands") -> list[Row]:
    """Return the NEES of an estimate by truth, none without. name: whose. bands: in words."""
    if t is None:
        return []
    rows, group = [], f"{name} NEES ({bands})"
    for what, single, n, digits in (
        ("pose", "pose: epochs", t.pose, 2),
        ("heading", "heading: epochs", t.heading, 2),
        ("landmarks", "landmarks", t.landmarks, 2),
        ("landmark distance", "landmark distances", t.distance, 2),
        ("all landmarks jointly", "", t.map, 3),
        ("all distances jointly", "", t.distances, 3),
    ):
        if n is None:
            continue
        if single:
            rows += [
                Row(group, f"{what}: NEES not computed, {why}", f"{count}")
                for why, count in n.unusable.items()
            ]
        if n.mean is None or n.inside is None:
            continue
        (low, high), of = n.single_band, what if not single else f"{what}, mean"
        limits, inside = band(f"{low:.{digits}g}", f"{high:.3g}"), n.single_band.holds(n.mean)
        rows.append(Row(group, f"{of} (expected {n.dof})", f"{n.mean:.3g}", limits, inside))
        if single:
            share = f"{100.0 * n.inside:.0f} % of {n.count}"
            rows.append(Row(group, f"{single} in the band", share))
    return rows


def smoothed_rows(name: str, f: FilterAgainstSmoother | None) -> list[Row]:
    """Return a filter compared with the smoother, where that can be judged. name: of the filter."""
    if f is None or f.squared_per_dof is None or f.least_ratio is None:
        return []
    group, mean = f"Poses over time, {name} minus smoother (95 % band)", f.squared_per_dof
    limits = "" if f.band is None else band(f"{f.band[0]:.2g}", f"{f.band[1]:.3g}")
    return [
        Row(
            group,
            f"d^T (P_{name} - P_smoother)^-1 d per degree of freedom (expected 1)",
            f"{mean:.3g}",
            limits,
            None if f.band is None else f.band.holds(mean),
        ),
        Row(group, f"smallest variance ratio, {name} over smoother", f"{f.least_ratio:.3g}"),
        Row(group, "time of the smallest variance ratio", f"{f.least_ratio_s:.1f} s"),
        Row(
            group,
            "epochs where the filter is more certain than the smoother",
            f"{f.overconfident_epochs} of {f.epochs}",
        ),
    ]


def consistency_lines(
    inconsistent: Sequence[str] | None, c: ConsistencyResult
) -> list[tuple[str, str]]:
    """Return a line: what is outside its band, or else the figures, if any, per dof."""
    if inconsistent:
        return [("consistency", f"outside, per dof: {'; '.join(map(_brief, inconsistent))}")]
    truth, smoothed = c.ekf, c.filter_against_smoother
    found = []
    if truth is not None:
        nees = [
            f"{name} {n.mean / n.dof:.2g}{_brackets(where)}"
            for name, n, where in (
                ("pose", truth.pose, truth.departure), ("map", truth.landmarks, None),
            )
            if n is not None and n.mean is not None
        ]  # fmt: skip
        found += [f"NEES {', '.join(nees)}"] if nees else []
    for sensor in c.innovations[:1]:
        found += [f"NIS {n.mean / n.expected:.2g}" for n in sensor.nis[:1]]
    if smoothed is not None and smoothed.squared_per_dof is not None:
        value = f"{smoothed.squared_per_dof:.2g}{_brackets(smoothed.departure)}"
        found.append(f"vs smoother {value}")
    return [("consistency", f"per dof, expect 1: {'; '.join(found)}")] if found else []


def _brackets(departure: BlockDeparture | None) -> str:
    """In which block an average is off, and when, where it is."""
    return "" if departure is None else f" ({departure.words})"


def _brief(figure: str) -> str:
    """Shorten what checks.qualifiers says of a figure: the value, then its band in brackets."""
    for long, short in (
        (" per degree of freedom", ""),
        ("NEES of the landmarks", "NEES map"),
        ("NEES of the ", "NEES "),
        ("filter-smoother difference", "vs smoother"),
        ("filter more certain than the smoother", "more certain than smoother"),
        ("NIS of ", "NIS "),
        (", limit ", " (<= "),
        (", band ", " ("),
    ):
        figure = figure.replace(long, short)
    return f"{figure})" if "(" in figure else figure
