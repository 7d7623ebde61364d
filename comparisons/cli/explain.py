"""`slamcheck explain`: what a check asks and finds, and what a cause means."""

from __future__ import annotations

from typing import Annotated

import typer

from comparisons.cli.support import AGREE, guarded


def explain(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A check, a cause, or faults; none lists them all."),
    ] = None,
) -> None:
    """Say what a check asks, needs and finds, what a cause means, or how faults are composed.

    \b
    Examples:
      slamcheck explain
      slamcheck explain truth_gap
      slamcheck explain linearisation
      slamcheck explain faults
    """
    with guarded():
        from comparisons.report.explain import explanation, overview

        typer.echo(overview() if name is None else explanation(name))
        raise SystemExit(AGREE)
