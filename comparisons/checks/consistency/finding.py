"""Consistency as a check: part of `result.json`, rows of figures, and a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
from comparisons.figures import LeftOut, Model, band
from comparisons.innovations import InnovationFigures
from comparisons.statistics import BlockDeparture, Normalised
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

_NEES_BANDS = "95 % bands; the verdict: pose and landmarks at 99.9 %"
_NIS_BANDS = "95 % bands; the verdict: NIS alone, at 99.9 %"
"""A consistent filter leaves one of twenty bands of 95 %; see checks.qualifiers.inconsistencies."""


class TruthConsistencyResult(Model):
    """NEES against truth, of errors in the log's frame, additive in x, y and wrapped heading.

    Attributes:
        pose: poses over time.
        position: positions over time.
        heading: headings over time.
        landmarks: each landmark alone.
        map: all landmarks jointly.
        whole: all landmarks and the last pose jointly.
        distance: lengths of a spanning tree over landmarks and last pose, which no frame affects,
            each alone.
        distances: the same lengths jointly.
        too_short: lengths that were left out since they are too short.
        departure: block and stretch that are off, where the poses pass the limit of a verdict.
    """

    pose: Normalised | None
    position: Normalised | None
    heading: Normalised | None
    landmarks: Normalised | None
    map: Normalised | None
    whole: Normalised | None
    distance: Normalised | None
    distances: Normalised | None
    too_short: int
    departure: LeftOut[BlockDeparture | None] = None


class ConsistencyResult(Model):
    """Consistency by truth, by the filter's innovations, and by the smoother.

    Attributes:
        ekf: the filter by truth.
        smoother: the smoother by truth.
        innovations: each sensor.
        filter_against_smoother: the filter by the smoother.
    """

    ekf: TruthConsistencyResult | None
    smoother: TruthConsistencyResult | None
    innovations: list[InnovationFigures]
    filter_against_smoother: FilterAgainstSmoother | None


class ExternalConsistencyResult(Model):
    """Consistency of an external estimate's covariances, by truth and by the smoother.

    Attributes:
        truth: by truth.
        filter_against_smoother: by the smoother.
        unjudged: why there is no comparison with the smoother.
    """

    truth: TruthConsistencyResult | None
    filter_against_smoother: FilterAgainstSmoother | None
    unjudged: str


class ConsistencyFinding(Of[Consistency]):
    """What of a filter is outside its band, and what is within."""

    def __init__(self, found: Consistency, name: str = "EKF") -> None:
        """found: by truth, innovations and smoother. name: of what is judged, in rows."""
        self.value, self.name, self.remarks = found, name, found.remarks
        self.result = consistency_result(found)
        self.entries = {"consistency": self.result}
        if isinstance(found, ExternalConsistency):
            self.entries = {"consistency": external_consistency_result(found)}
        self.lines = consistency_lines(inconsistencies(found), self.result)

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
        if known.run is None:
            return _of_smoother(known)
        log, labelled = known.prepared.log, known.prepared.labelled
        smoothed, robust = None, "none"
        if known.solved is not None:
            smoothed, robust = known.smoothed, known.result.options.robust
        return ConsistencyFinding(
            check_consistency(log, known.ekf, smoothed, labelled=labelled, robust=robust)
        )


def _of_smoother(known: Known) -> ConsistencyFinding | Absent:
    labelled = known.prepared.labelled
    truth = against_truth(known.smoothed, known.prepared.log, labelled=labelled)
    if truth is None:
        return Absent(f"the log has no truth, and {known.without}")
    return ConsistencyFinding(Consistency(None, truth, (), None, gated=not labelled))


def consistency_result(c: Consistency) -> ConsistencyResult:
    """The check's figures."""
    return ConsistencyResult(
        ekf=_truth(_with_covariances(c.ekf) if isinstance(c, ExternalConsistency) else c.ekf),
        smoother=_truth(c.smoother),
        innovations=list(c.sensors),
        filter_against_smoother=c.smoothed,
    )


def _with_covariances(t: TruthConsistency | None) -> TruthConsistency | None:
    """Return what is left without poses of which no covariance was handed in."""
    if t is not None and t.poses is not None and not len(t.poses.pose.squared):
        t = replace(t, poses=None)
    return None if t is None or (t.poses is None and t.map is None) else t


def _truth(t: TruthConsistency | None) -> TruthConsistencyResult | None:
    if t is None:
        return None
    poses, mapped = t.poses, t.map
    return TruthConsistencyResult(
        pose=None if poses is None else _nees(poses.pose),
        position=None if poses is None else _nees(poses.position),
        heading=None if poses is None else _nees(poses.heading),
        landmarks=None if mapped is None else _nees(mapped.landmarks),
        map=None if mapped is None else _nees(mapped.map),
        whole=None if mapped is None or mapped.whole is None else _nees(mapped.whole),
        distance=None if mapped is None else _nees(mapped.distance),
        distances=None if mapped is None else _nees(mapped.distances),
        too_short=0 if mapped is None else mapped.skipped,
        departure=None if poses is None else poses.departure,
    )


def _nees(n: Normalised) -> Normalised | None:
    return n if n.dof else None


def external_consistency_result(c: ExternalConsistency) -> ExternalConsistencyResult:
    """An external estimate's."""
    return ExternalConsistencyResult(
        truth=consistency_result(c).ekf,
        filter_against_smoother=c.smoothed,
        unjudged=c.unjudged,
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


def nees_rows(name: str, t: TruthConsistencyResult | None, bands: str = "95 % bands") -> list[Row]:
    """Return the NEES of an estimate by truth, none without. name: whose. bands: in words."""
    if t is None:
        return []
    rows, group = [], f"{name} NEES ({bands})"
    for what, single, n in (
        ("pose", "pose: epochs", t.pose),
        ("heading", "heading: epochs", t.heading),
        ("landmarks", "landmarks", t.landmarks),
        ("landmark distance", "landmark distances", t.distance),
    ):
        if n is None:
            continue
        rows += [
            Row(group, f"{what}: NEES not computed, {why}", f"{k}") for why, k in n.unusable.items()
        ]
        if n.mean is None or n.inside is None:
            continue
        low, high = n.single_band
        shown_band = band(f"{low:.2g}", f"{high:.3g}")
        inside = low <= n.mean <= high
        rows.append(_expected(group, f"{what}, mean", n, shown_band, inside=inside))
        share = f"{single} in the band"
        rows.append(Row(group, share, f"{100.0 * n.inside:.0f} % of {n.count}"))
    for what, n in (("all landmarks jointly", t.map), ("all distances jointly", t.distances)):
        if n is not None and n.mean is not None:
            low, high = n.single_band
            shown_band = band(f"{low:.3g}", f"{high:.3g}")
            rows.append(_expected(group, what, n, shown_band, inside=low <= n.mean <= high))
    return rows


def _expected(group: str, what: str, n: Normalised, limits: str, *, inside: bool) -> Row:
    return Row(group, f"{what} (expected {n.dof})", f"{n.mean:.3g}", limits, inside)


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
            None if f.band is None else f.band[0] <= mean <= f.band[1],
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
    found, nees = [], []
    if truth is not None:
        for name, n in (("pose", truth.pose), ("map", truth.landmarks)):
            if n is not None and n.mean is not None:
                where = truth.departure if name == "pose" else None
                nees.append(f"{name} {n.mean / n.dof:.2g}{_brackets(where)}")
    if nees:
        found.append(f"NEES {', '.join(nees)}")
    for sensor in c.innovations[:1]:
        found += [f"NIS {n.mean / n.dof:.2g}" for n in sensor.nis[:1]]
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
