"""The folder of reproduced figures: gallery.html, claims.json, each figure as PNG and PDF."""

from __future__ import annotations

from collections import Counter
from html import escape
from pathlib import Path

from pydantic import TypeAdapter
from rich.console import Console

from comparisons.atomic import fresh_folder
from comparisons.report.html.shell import document, picture, table
from research.documents.claims import Claim, in_words
from research.documents.interface import FigureResult, ReproductionResult

CLAIMS = "claims.json"
"""By which such a folder is told from others."""


def write_gallery(result: ReproductionResult, folder: Path) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError."""
    with fresh_folder(folder, CLAIMS) as work:
        for one in result.figures:
            (work / f"{one.name}.png").write_bytes(one.png)
            (work / f"{one.name}.pdf").write_bytes(one.pdf)
        (work / "gallery.html").write_text(_gallery(result), encoding="utf-8")
        text = TypeAdapter(ReproductionResult).dump_json(result, indent=2)
        (work / CLAIMS).write_bytes(text + b"\n")


def print_claims(result: ReproductionResult, folder: Path, console: Console) -> None:
    """Print how many claims hold, each figure, every claim that does not hold, and the folder."""
    lines = [_summary(result, ",")]
    for figure in result.figures:
        lines.append(
            f"{figure.name:6} {_met(figure)} claims hold  {figure.seconds:6.1f} s  {figure.title}"
        )
        for claim in figure.claims:
            if not claim.holds:
                reported = f"{_measured(claim)}, expected {claim.asked}"
                lines.append(f"       does not hold: {claim.text}: {reported}")
                if claim.why:
                    lines.append(f"         {claim.cause}: {claim.why}")
    lines += [f"{row.name:6} skipped: {row.reason}" for row in result.skipped]
    lines.append(f"report: {folder}")
    console.print("\n".join(lines), highlight=False, markup=False)


def _gallery(result: ReproductionResult) -> str:
    """The page: every figure with what its document claims and what was measured here."""
    kind, outcome = ("agree", "all hold") if result.holds else ("disagree", "not all hold")
    contents = [(figure.name, figure.title, _met(figure)) for figure in result.figures]
    bad = [number for number, figure in enumerate(result.figures) if not figure.holds]
    parts = [
        "<h1>Figures of the source documents, reproduced</h1>",
        f'<p><span class="verdict {kind}">{outcome}</span> {_summary(result, ";")}</p>',
        '<p class="note">Claims are in our words. Environments are those of the documents as '
        "far as these describe them; where things stand in simulated ones is ours.</p>",
        table(("figure", "", "claims that hold"), contents, bad),
        *map(_figure, result.figures),
    ]
    if result.skipped:
        rows = [(s.name, s.title, s.reason) for s in result.skipped]
        parts += ["<h2>Skipped</h2>", table(("figure", "", "reason"), rows)]
    parts += ["<h2>Versions</h2>", table(("package", "version"), list(result.versions.items()))]
    return document("slamcheck: reproduced figures", parts)


def _figure(figure: FigureResult) -> str:
    shared = f", shared with {', '.join(figure.shared)}" if figure.shared else ""
    bad = [number for number, claim in enumerate(figure.claims) if not claim.holds]
    rows = [
        (
            claim.text if claim.why is None else f"{claim.text} ({claim.cause}: {claim.why})",
            _measured(claim),
            claim.asked,
            "holds" if claim.holds else "does not hold",
        )
        for claim in figure.claims
    ]
    return (
        f"<h2>{escape(figure.name)}: {escape(figure.title)}</h2>"
        f"<p>{escape(figure.says)}</p>"
        f'<p class="note">{escape(figure.source)}. Log: {escape(figure.log)}. '
        f"{figure.seconds:.1f} s{escape(shared)}.</p>"
        f"{picture(figure.title, figure.png)}{table(('claim', 'measured', 'limit', ''), rows, bad)}"
    )


def _summary(result: ReproductionResult, after: str) -> str:
    """after: what ends the count of claims."""
    failed = Counter(
        claim.cause or "not explained"
        for figure in result.figures
        for claim in figure.claims
        if not claim.holds
    )
    causes = ", ".join(f"{count} {cause}" for cause, count in sorted(failed.items()))
    return (
        f"{_met(*result.figures)} claims hold{f' (the others: {causes})' if causes else ''}"
        f"{after} {len(result.figures)} figures, "
        f"{len(result.skipped)} skipped, {result.seconds:.0f} s"
    )


def _met(*figures: FigureResult) -> str:
    claims = [claim.holds for figure in figures for claim in figure.claims]
    return f"{sum(claims)} of {len(claims)}"


def _measured(claim: Claim) -> str:
    return in_words(claim.measured, claim.unit, (claim.drives_least, claim.drives_most))
