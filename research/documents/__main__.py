"""Draw figures of the source documents anew, and measure what the documents claim by them.

    python -m research.documents                          list the figures
    python -m research.documents G9 N3.12 --data FOLDER   G Guivant, M Misono, N Nieto
    python -m research.documents all --workers 1 --out figures

Exit code 0: all claims hold; 1: some do not; 2: unusable input.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from comparisons.atomic import check_replaceable
from comparisons.cli.support import (
    AGREE,
    DISAGREE,
    INTERRUPTED,
    guarded,
    print_text,
    progress_bar,
)
from comparisons.errors import note
from comparisons.experiments.montecarlo.workers import one_each_core
from research.documents.folder import CLAIMS, print_claims, write_gallery
from research.documents.interface import Sources
from research.documents.registry import FIGURES
from research.documents.runner import reproduce


def main() -> None:
    """List the figures, or reproduce those that are named."""
    parser = argparse.ArgumentParser(
        prog="python -m research.documents",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("figures", nargs="*", metavar="FIGURE|all")
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        help="folder of the real logs: victoria_park/, acfr_car_park/, mrclam/",
    )
    parser.add_argument(
        "--drives", type=int, default=10, help="simulated drives per statistical claim"
    )
    parser.add_argument("--workers", type=int, help="parallel processes; all cores if left out")
    parser.add_argument("--out", type=Path, default=Path("slamcheck-reproduction"))
    choices = parser.parse_args()
    if not choices.figures:
        _print_list()
        raise SystemExit(AGREE)
    try:
        holds = _reproduce(choices)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    raise SystemExit(AGREE if holds else DISAGREE)


def _reproduce(choices: argparse.Namespace) -> bool:
    """Write the gallery and print the claims; return whether all hold."""
    with guarded():
        check_replaceable(choices.out, CLAIMS)
        workers = one_each_core() if choices.workers is None else choices.workers
        with progress_bar() as progress:
            try:
                result = reproduce(
                    tuple(choices.figures),
                    Sources(choices.data, choices.drives),
                    workers,
                    progress,
                )
            except (KeyboardInterrupt, SystemExit):
                note(
                    f"stopped: nothing is written to {choices.out}; give fewer figures for a "
                    "shorter job"
                )
                raise
            progress("gallery", 0, 0)
            write_gallery(result, choices.out)
        print_text(lambda console: print_claims(result, choices.out, console))
    return result.holds


def _print_list() -> None:
    for figure in FIGURES:
        needs = figure.experiment.needs
        extra = f" (needs --data with {needs}/)" if needs else ""
        print(f"{figure.name:6} {figure.source}: {figure.title}{extra}")


if __name__ == "__main__":
    main()
