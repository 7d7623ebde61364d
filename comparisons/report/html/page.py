"""`report.html`: verdict and causes first, then the map, figures, pictures and landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from comparisons.compare import Comparison
from comparisons.report.consistency_result import consistency_rows
from comparisons.report.html.drawing import Drawing
from comparisons.report.html.look import SCRIPT
from comparisons.report.html.shell import document, picture, table
from comparisons.report.models import AccuracyResult, Result
from comparisons.report.plots import EKF_COLOUR, SMOOTHER_COLOUR, ellipses

_PICTURES = {
    "consistency.png": "Consistency",
    "correlation.png": "Correlation",
    "dense.png": "Dense maps",
}
_SIGMAS = 3.0


def page(comparison: Comparison, result: Result, pictures: Path) -> str:
    """The whole page. pictures: the folder with those that have been drawn."""
    name = escape(result.log.name)
    parts = [
        f"<h1>{name}</h1>",
        f'<p><span class="verdict {result.verdict}">{result.verdict}</span> '
        f"{escape(result.log.format)}, {result.log.duration_s:.0f} s</p>",
        _causes(result),
        "<h2>Map</h2>",
        '<p class="note">Wheel to zoom, drag to move, double click for all; rest on a landmark '
        "for its name and difference.</p>",
        '<div id="layers" class="layers"></div>',
        _map(comparison).svg(),
        "<h2>Figures</h2>",
        table(("", ""), _figures(result)),
        *_embedded(pictures),
        _landmarks(result),
        "<h2>Time and versions</h2>",
        table(("stage", "s"), [(k, f"{v:.2f}") for k, v in result.seconds.items()]),
        table(("package", "version"), list(result.versions.items())),
    ]
    return document(f"{result.log.name}: {result.verdict}", parts, SCRIPT)


def _causes(result: Result) -> str:
    shown = [
        f'<div class="cause"><b>{escape(c.gap)}</b>: {escape(c.evidence)}'
        f'<div class="hint">{escape(c.hint)}</div></div>'
        for c in result.causes
    ]
    shown += [f'<p class="note">{escape(remark)}</p>' for remark in result.remarks]
    return "".join(shown)


def _map(c: Comparison) -> Drawing:
    ekf, smoothed = c.ekf.estimate, c.smoothed
    truth, positions = c.log.truth, c.log.positions
    walls = np.empty((0, 4)) if truth.surfaces is None else truth.surfaces.segment
    drawing = Drawing.of(
        ekf.pose[:, :2],
        smoothed.pose[:, :2],
        ekf.landmark,
        smoothed.landmark,
        walls[:, :2],
        walls[:, 2:],
    )
    if len(walls):
        drawing.links("true surfaces", "#9a9a9a", walls[:, :2], walls[:, 2:])
    if truth.poses is not None:
        drawing.path("truth", "#9a9a9a", truth.poses.pose[:, :2])
    if positions is not None:
        drawing.dots("GPS", "#b08d57", positions.position_m)
    blocks = c.agreement.landmarks
    for name, colour, estimate, dashes in (
        ("smoother", SMOOTHER_COLOUR, smoothed, ""),
        ("EKF", EKF_COLOUR, ekf, "5 3"),
    ):
        drawing.path(f"{name} trajectory", colour, estimate.pose[:, :2], dashes)
        labels = [
            f"{name}, landmark {i}: {b.difference_m:.3f} m apart, {b.distance:.2g} sigma"
            for i, b in zip(estimate.landmark_id.tolist(), blocks, strict=True)
        ]
        outline = ellipses(estimate.landmark, estimate.landmark_covariances(), _SIGMAS, 32)
        drawing.outlines(f"{name} landmarks, 3 sigma", colour, outline, labels)
        drawing.dots(f"{name} landmarks", colour, estimate.landmark, labels)
    drawing.links("differences", "#7b4fa3", ekf.landmark, smoothed.landmark)
    if c.dense_check is not None:
        for name, layer in c.dense_check.layers.items():
            drawing.dots(f"dense {name}", "#1b3a4b", layer.point)
    return drawing


def _figures(result: Result) -> list[tuple[str, str]]:
    gaps, ekf, smoother = result.agreement, result.ekf, result.smoother
    rows = [
        ("records", ", ".join(f"{n:,} {name}" for name, n in result.log.records.items())),
        ("EKF", f"{ekf.filter}, {ekf.landmarks} landmarks, association {ekf.association}"),
        (
            "smoother",
            f"error {smoother.error:.2f}, chi-square {smoother.chi2:.0f} for {smoother.dof} "
            f"degrees of freedom, optimum {'proven' if smoother.proven else 'not proven'}",
        ),
    ]
    for name, sigma, covariance in (
        ("algebra gap", gaps.algebra_gap_sigma, gaps.algebra_gap_covariance),
        ("model gap", gaps.model_gap_sigma, gaps.model_gap_covariance),
        ("linearisation gap", gaps.linearisation_gap_sigma, gaps.linearisation_gap_covariance),
    ):
        rows.append((name, f"{_number(sigma)} sigma, {_number(covariance)} in covariance"))
    rows.append(("optimism", _number(gaps.optimism)))
    rows.append(("landmarks apart (RMS)", f"{gaps.landmark_difference_rms_m:.3f} m"))
    rows += consistency_rows(result.consistency)
    if result.accuracy is not None:
        rows.append(("EKF's accuracy", _accuracy(result.accuracy.ekf)))
        rows.append(("smoother's accuracy", _accuracy(result.accuracy.smoother)))
    return rows


def _accuracy(accuracy: AccuracyResult) -> str:
    shown = {k: v for k, v in accuracy.model_dump().items() if v is not None}
    return ", ".join(f"{name.replace('_', ' ')} {_number(v)}" for name, v in shown.items())


def _landmarks(result: Result) -> str:
    head = ("landmark", "apart [m]", "sigma", "least variance", "largest variance", "")
    heads = "".join(f"<th><button>{escape(name)}</button></th>" for name in head)
    rows = []
    for row in result.agreement.landmarks:
        cells = (
            str(row.id),
            f"{row.difference_m:.3f}",
            f"{row.distance_sigma:.2f}",
            _number(row.variance_ratio_least),
            _number(row.variance_ratio_largest),
            "agrees" if row.agrees else "disagrees",
        )
        shown = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        rows.append(f'<tr class="{"" if row.agrees else "bad"}">{shown}</tr>')
    return (
        f'<h2>Landmarks</h2><div class="scroll"><table class="sortable"><thead><tr>{heads}</tr>'
        f"</thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _embedded(folder: Path) -> list[str]:
    shown = []
    for file, title in _PICTURES.items():
        if (folder / file).exists():
            shown.append(f"<h2>{title}</h2>{picture(title, (folder / file).read_bytes())}")
    return shown


def _number(value: float | Mapping[str, float] | None) -> str:
    if value is None or not isinstance(value, int | float) or not np.isfinite(value):
        return "none"
    return f"{value:.3g}"
