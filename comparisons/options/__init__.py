"""An option of the command line, as metadata of the setting that it sets (see config.setting).

    gate: float = setting(9.21, "Gate of a measurement", Option("--gate", ESTIMATORS), gt=0.0)

`make settings` gathers the options of all settings in `options/table.py`, which help reads: the
classes of the settings take longer to load than help may. Earlier spellings are read for one
release.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from comparisons.errors import InputError

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
            raise InputError(f"{self.option} is {value!r}, expected {known}")
        section, _, key = self.field.rpartition(".")
        if self.within and below(config, section) is None:
            if value == self.neutral:
                return
            given = self.option if value is True else f"{self.option} {value}"
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


class Renamed(NamedTuple):
    """An earlier spelling, which is read for one release.

    field: of the configuration, as it is now. was_field: empty where it is the same. option,
    was_option: the same of the command line, empty where it has none. values: earlier values and
    what they are now.
    """

    field: str
    option: str = ""
    was_field: str = ""
    was_option: str = ""
    values: Mapping[str, str] = MappingProxyType({})


_SCAN_LANDMARKS = "extensions.scan_landmarks"
RENAMED = (
    Renamed(field="preset", option="--preset", values={"as-published": "nieto-2005"}),
    Renamed(field="log.sigmas", values={"calibrated": "log"}),
    Renamed(field="ekf.association", option="--association", values={"agreed": "consensus"}),
    Renamed(
        field=f"{_SCAN_LANDMARKS}.template_extraction",
        was_field=f"{_SCAN_LANDMARKS}.pieces",
        option="--template-extraction",
        was_option="--pieces",
        values={"joined": "whole-scan", "single": "per-segment"},
    ),
    Renamed(
        field=f"{_SCAN_LANDMARKS}.merge_landmarks",
        was_field=f"{_SCAN_LANDMARKS}.fuse",
        option="--merge-landmarks",
        was_option="--fuse-landmarks",
    ),
    Renamed(
        field="extensions.own_matching",
        option="--smoother-matcher",
        values={"own": "generalised-icp"},
    ),
)
"""Every earlier spelling, of the command line, of `config.toml` and of Python."""

UNUSED = {
    "extensions.dense_maps.attribute_values": False,
    f"{_SCAN_LANDMARKS}.map_aided_matching": False,
    f"{_SCAN_LANDMARKS}.templates": "bare",
}
"""Settings that there were, with the value of one that was not used, as earlier files have it."""


def renamed_settings(config: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return nested mappings with earlier keys and values as they are now, and notes of it.

    A key that stands beside its earlier spelling is kept, one that is gone and was not used is not.
    """
    found, notes = dict(config), list[str]()
    for one in RENAMED:
        section, _, key = one.field.rpartition(".")
        was = (one.was_field or one.field).rpartition(".")[2]
        old = below(config, section)
        if not isinstance(old, Mapping) or was not in old:
            continue
        value = old[was]
        new = one.values.get(value, value) if isinstance(value, str) else value
        if was == key and new == value:
            continue
        into = _copied(found, section)
        del into[was]
        into.setdefault(key, new)
        place = f"{section}.".removeprefix("extensions.").lstrip(".")
        notes.append(f"{place}{was} = {_toml(value)} is now {place}{key} = {_toml(new)}")
    for path, unused in UNUSED.items():
        section, _, key = path.rpartition(".")
        if below(found, path) == unused:
            del _copied(found, section)[key]
    return found, notes


def renamed_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a command line's words with earlier options and values as they are now, and notes."""
    found, notes, rest = list[str](), list[str](), list(words)
    while rest:
        word = rest.pop(0)
        if word == "--":
            return [*found, word, *rest], notes
        option, equals, value = word.partition("=")
        one = next((r for r in RENAMED if r.option and option in _earlier(r)), None)
        if one is None:
            found.append(word)
            continue
        given = [option]
        if one.values and (equals or rest):
            given.append(value if equals else rest.pop(0))
        now = [f"--no-{one.option[2:]}" if option.startswith("--no-") else one.option]
        if len(given) > 1:
            now.append(one.values.get(given[1], given[1]))
        if now != given:
            notes.append(f"{' '.join(given)} is now {' '.join(now)}")
        found += now
    return found, notes


def _earlier(one: Renamed) -> tuple[str, ...]:
    """Return the options that may be spelt as they were."""
    was = one.was_option
    return (was, f"--no-{was[2:]}") if was else (one.option,)


def _copied(config: dict[str, Any], section: str) -> dict[str, Any]:
    """Return a section of nested mappings, copied there and on the way to it."""
    for name in filter(None, section.split(".")):
        config[name] = dict(config[name])
        config = config[name]
    return config


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()
