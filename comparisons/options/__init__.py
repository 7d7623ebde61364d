"""An option of the command line, as metadata of the setting that it sets (see config.setting).

    gate: float = setting(9.21, "Gate of a measurement", Option("--gate", ESTIMATORS), gt=0.0)

`make settings` gathers the options of all settings in `options/table.py`, which help reads: the
classes of the settings take longer to load than help may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

from comparisons.errors import InputError, quoted, shorten

ABSENT = None
"""A setting that takes its section away."""
ESTIMATORS, SCANS = "Estimators", "Scans and dense maps"
GRADE, FRONT_END, JOB = "Estimate", "Scan front end", "Log, settings and report"
SWITCH: Mapping[Any, Any] = {True: {}, False: ABSENT}
"""Of an extension that is there or not."""


class Where(NamedTuple):
    """Where a setting has an effect: a field of the configuration has a value, in words."""

    field: str
    value: Any
    words: str


@dataclass(frozen=True, eq=False)
class Option:
    """What a setting does not say of its option.

    panel: of the help, empty where no command lists the option. help: a line for it, the default in
    brackets; where empty, the setting's description. `slamcheck config` describes every option by
    its setting. jobs: commands that have it, all whose configuration has the setting where empty.
    settings: of a section, what each word stands for, ABSENT to take the section away. text: of a
    list, given as one text. within: what must be asked for as well, for a setting of a section that
    the option alone does not add. where: where another value than the default has an effect. off: a
    switch that has a --no- form.
    """

    option: str
    panel: str = ""
    help: str = ""
    _: KW_ONLY
    metavar: str | None = None
    jobs: tuple[str, ...] = ()
    settings: Mapping[Any, Any] | None = None
    text: bool = False
    within: str = ""
    where: Where | None = None
    off: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Flag(Option):
    """An option with what its setting says of it.

    field: dotted path in the configuration. kind: of a value. words: that it may be. many: may be
    repeated. neutral: the setting's default, which may be given where its section is not.
    """

    field: str
    kind: type = str
    words: tuple[str, ...] = ()
    many: bool = False
    neutral: Any = None

    @property
    def name(self) -> str:
        """As a parameter of the command's function."""
        return self.option.lstrip("-").replace("-", "_") + "_"

    def lay_over(self, config: dict[str, Any], value: Any) -> None:
        """Put a value that was given into nested mappings. Raises InputError."""
        if self.settings is not None and value not in self.settings:
            known = " or ".join(map(str, self.settings))
            raise InputError(f"{self.option} is {quoted(value)}, expected {known}")
        section, _, key = self.field.rpartition(".")
        if self.within and below(config, section) is None:
            if value == self.neutral:
                return
            given = self.option if value is True else f"{self.option} {shorten(value)}"
            raise InputError(f"{given} goes with {self.within}")
        into = config
        for part in section.split(".") if section else ():
            into = into.setdefault(part, {})
        found = value if self.settings is None else self.settings[value]
        if self.settings is not None and found is ABSENT:
            into.pop(key, None)
        elif isinstance(found, Mapping) and isinstance(into.get(key), dict):
            into[key].update(found)
        else:
            into[key] = dict(found) if isinstance(found, Mapping) else found

    def read(self, config: Mapping[str, Any]) -> tuple[Any, frozenset[str]]:
        """Return the value that nested mappings have, None for none, and the paths it stands at."""
        found = below(config, self.field)
        if self.settings is None:
            return found, frozenset({self.field})
        for value, stands_for in self.settings.items():
            if isinstance(found, Mapping) and isinstance(stands_for, Mapping):
                if stands_for.items() <= found.items():
                    paths = (f"{self.field}.{key}" for key in stands_for)
                    return value, frozenset({self.field, *paths})
            elif stands_for == found is not ABSENT:
                return value, frozenset({self.field})
        return None, frozenset()


def below(config: Mapping[str, Any], path: str) -> Any:
    """Return what nested mappings have at a dotted path, None where it is absent."""
    found: Any = config
    for part in filter(None, path.split(".")):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Put nested mappings over others; lists and values replace what they lie on."""
    found = dict(base)
    for key, value in over.items():
        below = found.get(key)
        if isinstance(value, Mapping):  # a copy all the way down, for flags are laid over it
            value = merge(dict(below) if isinstance(below, Mapping) else {}, value)
        found[key] = value
    return found
