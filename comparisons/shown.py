"""How a result shows itself in a notebook and as data frames, without knowing any report.

A result stands below the reports. Who renders it is named here, as extensions are, and imported
when a notebook or `to_pandas` asks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pkgutil import resolve_name
from typing import Any, cast

import numpy as np

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


class Brief:
    """A data class whose text is one line: arrays by their shapes, collections by their sizes."""

    def __repr__(self) -> str:
        """Return the class and its fields."""
        found = {field.name: getattr(self, field.name) for field in fields(cast(Any, self))}
        return brief(type(self).__name__, found)


def brief(name: str, found: Mapping[str, object]) -> str:
    """Return the one line of a class of a name with the values of its fields."""
    return f"{name}({', '.join(f'{one}={_brief(value)}' for one, value in found.items())})"


def _brief(value: object) -> str:
    """One line of a field's value."""
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, tuple | list | dict | Mapping) and len(value):
        return f"<{len(value):,} in {type(value).__name__}>"
    plain = value is None or isinstance(value, str | int | float | np.number | tuple | list)
    return repr(value) if plain else f"<{type(value).__name__}>"


def render(how: str, *what: object) -> Any:
    """Return a result as one of RENDERERS makes it."""
    return resolve_name(RENDERERS[how])(*what)
