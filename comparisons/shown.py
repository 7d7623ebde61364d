"""How a result shows itself in a notebook and as data frames, without knowing any report.

A result stands below the reports. `slamcheck`, which stands above both, names who renders.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

RENDERERS: dict[str, str] = {}
"""Who renders a result, as `module:function`: `html` for notebooks, `frame` for its tables."""


class Shown:
    """A result that a notebook shows by its verdict, its gaps and a map."""

    def _repr_html_(self) -> str:
        found: str = render("html", self)
        return found


def render(how: str, *what: object) -> Any:
    """Return a result as one of RENDERERS makes it. Raises LookupError where there is none."""
    module, _, name = RENDERERS[how].partition(":")
    return getattr(import_module(module), name)(*what)
