"""The folder of reproduced figures: gallery.html, claims.json, each figure as PNG and PDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from comparisons.atomic import fresh_folder
from comparisons.experiments.reproduction.gallery import gallery, reported
from comparisons.experiments.reproduction.interface import Claim, Reproduced, Skipped
from comparisons.experiments.reproduction.models import (
    ClaimResult,
    FigureResult,
    ReproductionResult,
    SkippedResult,
)
from comparisons.experiments.reproduction.registry import FIGURES
from comparisons.figures import finite, package_versions

CONTENTS = frozenset(
    {"gallery.html", "claims.json"}
    | {f"{figure.name}.{kind}" for figure in FIGURES for kind in ("png", "pdf")}
)
"""What the folder holds; a folder with nothing else may be replaced by the next."""


def build_result(
    found: Sequence[Reproduced | Skipped], drives: int, seconds: float
) -> ReproductionResult:
    """The figures' numbers. seconds: spent on everything."""
    done = [_figure(r) for r in found if isinstance(r, Reproduced)]
    skipped = [
        SkippedResult(
            name=r.figure.name, title=r.figure.title, source=r.figure.source, reason=r.reason
        )
        for r in found
        if isinstance(r, Skipped)
    ]
    # Figures of one experiment share its time.
    cpu_s = sum(r.cpu_s / (1 + len(r.shared)) for r in found if isinstance(r, Reproduced))
    return ReproductionResult(
        holds=all(figure.holds for figure in done),
        drives=drives,
        seconds=round(seconds, 3),
        cpu_s=round(cpu_s, 3),
        figures=done,
        skipped=skipped,
        versions=package_versions(),
    )


def write_gallery(
    found: Sequence[Reproduced | Skipped], result: ReproductionResult, folder: Path
) -> None:
    """Write everything; the folder appears whole or not at all. Raises InputError."""
    pictures = {r.figure.name: r.png for r in found if isinstance(r, Reproduced)}
    with fresh_folder(folder, CONTENTS) as work:
        for r in found:
            if isinstance(r, Reproduced):
                (work / f"{r.figure.name}.png").write_bytes(r.png)
                (work / f"{r.figure.name}.pdf").write_bytes(r.pdf)
        (work / "gallery.html").write_text(gallery(result, pictures), encoding="utf-8")
        text = result.model_dump_json(indent=2) + "\n"
        (work / "claims.json").write_text(text, encoding="utf-8")


def print_claims(result: ReproductionResult, folder: Path, console: Console) -> None:
    """Print how many claims hold, each figure, every claim that does not hold, and the folder."""
    claims = [claim for figure in result.figures for claim in figure.claims]
    met = sum(claim.holds for claim in claims)
    lines = [
        f"{met} of {len(claims)} claims hold, {len(result.figures)} figures, "
        f"{len(result.skipped)} skipped, {result.seconds:.0f} s"
    ]
    for figure in result.figures:
        met = sum(claim.holds for claim in figure.claims)
        lines.append(
            f"{figure.name:6} {met} of {len(figure.claims)} claims hold  "
            f"{figure.seconds:6.1f} s  {figure.title}"
        )
        for claim in figure.claims:
            if not claim.holds:
                lines.append(f"       does not hold: {claim.text}: {reported(claim)}")
                if claim.why:
                    lines.append(f"         {claim.why}")
    lines += [f"{row.name:6} skipped: {row.reason}" for row in result.skipped]
    lines.append(f"report: {folder}")
    console.print("\n".join(lines), highlight=False, markup=False)


def _figure(found: Reproduced) -> FigureResult:
    figure = found.figure
    return FigureResult(
        name=figure.name,
        title=figure.title,
        source=figure.source,
        says=figure.says,
        log=found.log,
        seconds=round(found.seconds, 3),
        cpu_s=round(found.cpu_s, 3),
        shared=list(found.shared),
        holds=found.holds,
        claims=[_claim(claim) for claim in found.claims],
    )


def _claim(claim: Claim) -> ClaimResult:
    return ClaimResult(
        text=claim.text,
        measured=finite(claim.measured),
        relation=claim.relation,
        limit=claim.limit,
        unit=claim.unit,
        holds=claim.holds,
        why=None if claim.holds else claim.why or None,
    )
