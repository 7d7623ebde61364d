"""`gallery.html`: every figure with what its document claims and what was measured here."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from comparisons.experiments.reproduction.models import (
    ClaimResult,
    FigureResult,
    ReproductionResult,
)
from comparisons.report.html.shell import document, picture, table

_HEAD = ("claim", "measured", "limit", "")


def gallery(result: ReproductionResult, pictures: Mapping[str, bytes]) -> str:
    """The whole page. pictures: PNG by the figure's name."""
    claims = [claim for figure in result.figures for claim in figure.claims]
    met = sum(claim.holds for claim in claims)
    kind, outcome = ("agree", "all hold") if result.holds else ("disagree", "not all hold")
    parts = [
        "<h1>Figures of the source documents, reproduced</h1>",
        f'<p><span class="verdict {kind}">{outcome}</span> '
        f"{met} of {len(claims)} claims hold; {len(result.figures)} figures, "
        f"{len(result.skipped)} skipped, {result.seconds:.0f} s</p>",
        '<p class="note">Claims are in our words. Environments are those of the documents as '
        "far as these describe them; where things stand in simulated ones is ours.</p>",
        _contents(result),
        *(_figure(figure, pictures[figure.name]) for figure in result.figures),
    ]
    if result.skipped:
        rows = [(s.name, s.title, s.reason) for s in result.skipped]
        parts += ["<h2>Skipped</h2>", table(("figure", "", "reason"), rows)]
    parts += ["<h2>Versions</h2>", table(("package", "version"), list(result.versions.items()))]
    return document("slamcheck: reproduced figures", parts)


def reported(claim: ClaimResult) -> str:
    """The number beside its limit."""
    return f"{_measured(claim)}, expected {claim.relation} {_number(claim.limit, claim.unit)}"


def _contents(result: ReproductionResult) -> str:
    rows, bad = [], []
    for number, figure in enumerate(result.figures):
        met = sum(claim.holds for claim in figure.claims)
        rows.append((figure.name, figure.title, f"{met} of {len(figure.claims)}"))
        if not figure.holds:
            bad.append(number)
    return table(("figure", "", "claims that hold"), rows, bad)


def _figure(figure: FigureResult, png: bytes) -> str:
    shared = f", shared with {', '.join(figure.shared)}" if figure.shared else ""
    rows = [
        (
            claim.text if claim.why is None else f"{claim.text} ({claim.why})",
            _measured(claim),
            f"{claim.relation} {_number(claim.limit, claim.unit)}",
            "holds" if claim.holds else "does not hold",
        )
        for claim in figure.claims
    ]
    bad = [number for number, claim in enumerate(figure.claims) if not claim.holds]
    return (
        f"<h2>{escape(figure.name)}: {escape(figure.title)}</h2>"
        f"<p>{escape(figure.says)}</p>"
        f'<p class="note">{escape(figure.source)}. Log: {escape(figure.log)}. '
        f"{figure.seconds:.1f} s{escape(shared)}.</p>"
        f"{picture(figure.title, png)}{table(_HEAD, rows, bad)}"
    )


def _measured(claim: ClaimResult) -> str:
    return "none" if claim.measured is None else _number(claim.measured, claim.unit)


def _number(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".rstrip()
