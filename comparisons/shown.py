"""How a result shows itself in a notebook and as data frames, without knowing any report.

A result stands below the reports. Who renders it is named here, as extensions are, and imported
when a notebook or `to_pandas` asks.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

RENDERERS = {
    "html": "comparisons.report.notebook:html",
    "frame": "comparisons.report.tables:frame",
}
"""`html` for notebooks, `frame` for one of a result's tables."""


class Shown:
    """A result that a notebook shows by its verdict, its gaps and a map."""

    def _repr_html_(self) -> str:
        found: str = render("html", self)
        return found


def render(how: str, *what: object) -> Any:
    """Return a result as one of RENDERERS makes it."""
    module, _, name = RENDERERS[how].partition(":")
    return getattr(import_module(module), name)(*what)
