"""A document's preset: every setting that it states, at its value, and none of another's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from comparisons.documented.row import AnyBut, Documented, Value, same
from comparisons.documented.rows import ROWS
from comparisons.extension_names import EXTENSIONS
from comparisons.options import below, merge

Default = Callable[[str], Value]
"""The default of a run's setting `section.key`."""
SETTINGS: tuple[Documented, ...] = ROWS


def published(
    preset: str, given: Mapping[str, Any], sections: tuple[str, ...], default: Default
) -> dict[str, Any]:
    """Return given settings with a document's values where nothing was given.

    preset: of the document. sections: those that the job has; an extension's only where it takes
    part.
    """
    found = dict(given)
    for row in _of(preset):
        keys = _keys(row.at)
        there = keys[0] in sections if len(keys) == 2 else keys[1] in found.get("extensions", {})
        if there and read(found, row.at) is None and applies(row, found, default):
            stated: Any = row.value
            for key in reversed(keys):
                stated = {key: stated}
            found = merge(found, stated)
    return found


def without_documented(given: Mapping[str, Any], default: Default) -> dict[str, Any]:
    """Return given settings without those that are as the preset that they name has them.

    A file that a run wrote holds every setting; what was asked for beside the preset stays.
    """
    found = merge({}, given)
    stated = _of(given.get("preset", ""))
    for row in SETTINGS:
        *sections, key = _keys(row.at)
        section = below(found, ".".join(sections))
        if isinstance(section, dict) and key in section:
            rules = [
                one.value for one in stated if one.at == row.at and applies(one, given, default)
            ]
            usual = rules[0] if rules else default(row.at)
            if same(_plain(section[key]), usual):
                del section[key]
    return found


def differing(config: Mapping[str, Any], default: Default) -> list[tuple[Documented, Any]]:
    """Return settings of a run that its preset's document states at another value, with their own.

    Of all documents where the preset is none of theirs.
    """
    found = []
    for row in _of(config.get("preset", "")) or SETTINGS:
        value, keys = read(config, row.at), _keys(row.at)
        there = keys[0] in config if len(keys) == 2 else keys[1] in config.get("extensions", {})
        known = there and not row.named
        if known and applies(row, config, default) and not same(row.value, _plain(value)):
            found.append((row, value))
    return found


def _of(preset: str) -> tuple[Documented, ...]:
    """Return the settings of a document's preset; none of any other."""
    return tuple(row for row in SETTINGS if row.preset == preset)


def applies(row: Documented, given: Mapping[str, Any], default: Default) -> bool:
    """Whether the settings that a row depends on have one of the values that it asks for."""
    for path, values in row.when.items():
        asked = _plain(read(given, path))
        if asked is None:
            asked = _format(given) if path == "log.format" else default(path)
        if isinstance(values, AnyBut) == any(same(asked, one) for one in values):
            return False
    return True


def read(given: Mapping[str, Any], path: str) -> Any:
    """Return a setting of nested mappings, None where it is absent."""
    return below(given, ".".join(_keys(path)))


def _format(given: Mapping[str, Any]) -> str | None:
    """The format of the log that is asked for, recognised where it is not named."""
    from comparisons.logs.bundled import recognised_format

    source = read(given, "log.source")
    return recognised_format(source) if isinstance(source, str) else None


def _keys(path: str) -> list[str]:
    section, _, key = path.partition(".")
    return ["extensions", section, key] if section in EXTENSIONS else [section, key]


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
