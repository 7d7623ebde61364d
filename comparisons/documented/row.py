"""One constant of a document beside the one that runs use."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

Value = float | str | bool | tuple[float | str, ...] | None

Preset = Literal["recommended", "guivant-2002", "misono-2007", "nieto-2005"]
PRESETS: dict[str, str] = {name[0].upper(): name for name in get_args(Preset)[1:]}
"""Of each document, by the letter that its places begin with."""


class AnyBut(tuple[Value, ...]):
    """All values of a setting but these."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True)
class Documented:
    """A constant that a document states.

    place: document (G, M or N) and section, equation or table. what: the constant, in words.
    value: the document's, in SI units and radians. unit: of it. at: where the runs' value stands:
    a setting of a run, as `dense_maps.longest_edge_m`, which the document's preset sets to its
    value; or code, as `package.module:Class.field` or `package.module:function().name`.
    when: settings, each with the values under which the preset sets this one, or AnyBut those.
    reason: why runs use another value, with the measured figure; empty exactly where they use the
    document's. absent: what runs use where the setting is absent, in words, exactly where it may
    be. defaults: code with a default of the same constant, which runs replace. also: further code
    that has the document's value. named: the document names the constant and gives no number; the
    value is a usual one, and what the preset sets.
    """

    place: str
    what: str
    value: Value
    at: str
    unit: str = ""
    when: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    reason: str = ""
    absent: str = ""
    defaults: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    named: bool = False

    @property
    def preset(self) -> str:
        """The preset of its document."""
        return PRESETS[self.place[0]]

    @property
    def is_setting(self) -> bool:
        """A run's configuration has it."""
        return ":" not in self.at


def same(first: Value, second: Value) -> bool:
    """Whether two values are one, but for the rounding of numbers."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    numbers = [one for one in (first, second) if isinstance(one, int | float)]
    if len(numbers) == 2 and not any(isinstance(number, bool) for number in numbers):
        return math.isclose(*numbers, rel_tol=1e-9)
    return type(first) is type(second) and first == second


def shown(value: Any) -> str:
    """Return a value as a reader writes it."""
    if value is None:
        return "not given"
    if value in (math.inf, "Infinity"):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ", ".join(map(shown, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)
