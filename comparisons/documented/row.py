"""One constant of a document beside the one that runs use."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

Value = float | str | bool | tuple[float | str, ...] | None

PRESETS = {"G": "guivant-2002", "M": "misono-2007", "N": "nieto-2005"}
"""Of each document, by the letter that its places begin with."""


@dataclass(frozen=True)
class AnyBut:
    """All values of a setting but these."""

    values: tuple[Value, ...]


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
    when: Mapping[str, tuple[Value, ...] | AnyBut] = field(default_factory=dict)
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

    @property
    def used(self) -> Value:
        """The value that runs use by default."""
        return setting_default(self.at) if self.is_setting else in_code(self.at)

    @property
    def differs(self) -> bool:
        """Runs use another value."""
        return not same(self.value, self.used)


def same(first: Value, second: Value) -> bool:
    """Whether two values are one, but for the rounding of numbers."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(same, first, second))
    numbers = [one for one in (first, second) if isinstance(one, int | float)]
    if len(numbers) == 2 and not any(isinstance(one, bool) for one in numbers):
        return math.isclose(*numbers, rel_tol=1e-9)
    return type(first) is type(second) and first == second


def setting_default(path: str) -> Value:
    """Return the default of a run's setting `section.key`. Raises KeyError for an unknown one."""
    from comparisons.config import RunConfig
    from comparisons.extensions.registry import EXTENSIONS, config_class

    section, _, key = path.partition(".")
    if section in EXTENSIONS:
        kind: Any = config_class(section)
    else:
        kind = RunConfig.model_fields[section].annotation
    default: Value = kind.model_fields[key].get_default(call_default_factory=True)
    return default


def in_code(at: str) -> Value:
    """Return what `module:name.name` stands for: a name with () called, a field's default."""
    module, _, path = at.partition(":")
    found: Any = import_module(module)
    for name in path.split("."):
        found = _member(found, name.removesuffix("()"))
        found = found() if name.endswith("()") else found
    return tuple(map(float, found)) if isinstance(found, np.ndarray) else found


def _member(holder: Any, name: str) -> Any:
    if isinstance(holder, type) and dataclasses.is_dataclass(holder):
        fields = {one.name: one for one in dataclasses.fields(holder)}
        if name in fields and fields[name].default is not dataclasses.MISSING:
            return fields[name].default
    return getattr(holder, name)


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
