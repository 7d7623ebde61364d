"""Earlier spellings, which are read for one release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from comparisons.options import below


class Renamed(NamedTuple):
    """An earlier spelling, which is read for one release.

    field: of the configuration, as it is now. was_field: empty where it is the same. option,
    was_option: the same of the command line. values: earlier values and what they are now.
    """

    field: str
    option: str
    was_field: str = ""
    was_option: str = ""
    values: Mapping[str, str] = MappingProxyType({})


_SCAN_LANDMARKS = "extensions.scan_landmarks"
RENAMED = (
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
        place = section.removeprefix("extensions.")
        notes.append(f"{place}.{was} = {_toml(value)} is now {place}.{key} = {_toml(new)}")
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
        one = next((r for r in RENAMED if option in _earlier(r)), None)
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
    for name in section.split("."):
        config[name] = dict(config[name])
        config = config[name]
    return config


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()
