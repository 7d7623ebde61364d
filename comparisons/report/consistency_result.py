"""Consistency as a part of `result.json`, and as rows for a terminal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.checks.consistency.consistency import Consistency, ExternalConsistency
from comparisons.checks.consistency.filter_smoother import FilterAgainstSmoother
from comparisons.checks.consistency.innovations import SensorInnovations
from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.checks.consistency.normalised import Normalised
from comparisons.report.models import (
    ConsistencyResult,
    ExternalConsistencyResult,
    FilterAgainstSmootherResult,
    InnovationResult,
    NeesResult,
    NisResult,
    TruthConsistencyResult,
    WhitenessResult,
)


def consistency_result(c: Consistency) -> ConsistencyResult:
    """The check's figures."""
    return ConsistencyResult(
        ekf=_truth(c.ekf),
        smoother=_truth(c.smoother),
        innovations=[_innovations(sensor) for sensor in c.sensors],
        filter_against_smoother=_smoothed(c.smoothed),
    )


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
    )


def _nees(n: Normalised) -> NeesResult | None:
    if not n.dof:
        return None
    return NeesResult(
        dof=n.dof,
        count=len(n.squared),
        mean=n.mean,
        last=float(n.squared[-1]) if len(n.squared) else None,
        single_band=n.single_band,
        inside=n.inside,
        unusable=dict(n.faults),
    )


def external_consistency_result(c: ExternalConsistency) -> ExternalConsistencyResult:
    """An external estimate's."""
    truth = c.truth
    if truth is not None and truth.poses is not None and not len(truth.poses.pose.squared):
        truth = replace(truth, poses=None)
    none = truth is None or (truth.poses is None and truth.map is None)
    return ExternalConsistencyResult(
        truth=None if none else _truth(truth),
        filter_against_smoother=_smoothed(c.smoothed),
        unjudged=c.unjudged,
    )


def _innovations(s: SensorInnovations) -> InnovationResult:
    return InnovationResult(
        sensor=s.sensor,
        nis=[
            NisResult(name=n.name, dof=n.dof, count=n.count, mean=n.mean, band=n.band,
                      reading=n.reading)
            for n in s.nis
        ],
        whiteness=[
            WhitenessResult(
                component=w.component,
                order=w.order,
                autocorrelation=w.coefficient.tolist(),
                band=w.band.tolist(),
                p_value=w.p_value,
                mean=w.mean,
                mean_band=w.mean_band,
            )
            for w in s.whiteness
        ],
        unusable=s.unusable,
    )  # fmt: skip


def _smoothed(f: FilterAgainstSmoother | None) -> FilterAgainstSmootherResult | None:
    if f is None:
        return None
    worst = int(np.argmin(f.ratio)) if len(f.ratio) else None
    return FilterAgainstSmootherResult(
        epochs=len(f.time_s),
        squared_per_dof=f.mean_per_dof,
        band=f.band,
        inside=f.inside,
        least_ratio=None if worst is None else float(f.ratio[worst]),
        least_ratio_s=None if worst is None else float(f.time_s[worst]),
        overconfident_epochs=len(f.overconfident),
        overconfident_since_s=float(f.time_s[f.overconfident[0]]) if len(f.overconfident) else None,
        unusable=dict(f.faults),
    )


def consistency_rows(c: ConsistencyResult) -> list[tuple[str, str]]:
    """NEES of both estimators where there is truth, NIS per sensor, and filter against smoother."""
    rows = [*nees_rows("EKF NEES", c.ekf), *nees_rows("smoother NEES", c.smoother)]
    for sensor in c.innovations:
        shown = (
            f"{n.name} {n.mean:.3g} of {n.dof} (band {n.band[0]:.3g}-{n.band[1]:.3g})"
            for n in sensor.nis
        )
        rows.append(("NIS", ", ".join(shown)))
        rows.append(("whiteness", _whiteness_row(sensor)))
    return [*rows, *smoothed_rows("EKF", c.filter_against_smoother)]


def nees_rows(name: str, truth: TruthConsistencyResult | None) -> list[tuple[str, str]]:
    """NEES of one estimator, where there is truth."""
    return [] if truth is None else [(name, _nees_row(truth))]


def smoothed_rows(name: str, f: FilterAgainstSmootherResult | None) -> list[tuple[str, str]]:
    """A filter against the smoother, where that can be judged."""
    if f is None or f.squared_per_dof is None or f.least_ratio is None:
        return []
    shown_here = (
        f"poses' difference squared {f.squared_per_dof:.3g} per dof, of 1 (P_{name} - P_smoother"
        + (f"; band {f.band[0]:.2g}-{f.band[1]:.3g}" if f.band else "")
        + f"); least variance ratio {f.least_ratio:.3g} at {f.least_ratio_s:.1f} s"
    )
    return [(f"{name} - smoother", shown_here)]


def _whiteness_row(sensor: InnovationResult) -> str:
    shown = (
        f"{w.component} by {w.order} {w.autocorrelation[0]:.2g} (band {w.band[0]:.2g}, "
        f"p {w.p_value:.2g})"
        for w in sensor.whiteness
    )
    return "correlation with the next: " + (", ".join(shown) or "too few to tell")


def _nees_row(t: TruthConsistencyResult) -> str:
    parts = []
    for name, n in (("pose", t.pose), ("heading", t.heading), ("landmark", t.landmarks),
                    ("distance", t.distance)):  # fmt: skip
        if n is not None and n.mean is not None and n.inside is not None:
            low, high = n.single_band
            without = [f"; {count} {fault}" for fault, count in n.unusable.items()]
            parts.append(
                f"{name} {n.mean:.3g} of {n.dof} ({100.0 * n.inside:.0f} % of {n.count} in "
                f"{low:.2g}-{high:.3g}{''.join(without)})"
            )
        elif n is not None:
            parts.append(f"{name} none ({', '.join(n.unusable)})")
    for name, n in (("map", t.map), ("all distances", t.distances)):
        if n is not None and n.mean is not None:
            low, high = n.single_band
            parts.append(f"{name} {n.mean:.3g} of {n.dof} (band {low:.3g}-{high:.3g})")
    return ", ".join(parts)
