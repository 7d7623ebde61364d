"""Every setting of a job in words, for its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from comparisons.checks.settings import SettingsResult
from comparisons.config import EkfConfig, JobConfig, SettingsGroup
from comparisons.documented.row import shown


class SettingLine(NamedTuple):
    """A setting of a run. Values are words; document: another value that a document states."""

    setting: str
    value: str
    default: str
    changed: bool
    document: str
    meaning: str


_INPUTS = ("job", "log.source", "log.sha256", "estimate", "times")
"""Settings that name files, and have no default to differ from."""


def setting_lines(
    config: JobConfig, settings: SettingsResult | None = None, ekf: EkfConfig | None = None
) -> list[SettingLine]:
    """Return every setting of a run, those that differ from the default first.

    settings: what documents state at other values. ekf: the filter's once nothing is left open.
    """
    stated = (
        {} if settings is None else {setting.setting: setting for setting in settings.differing}
    )
    chosen = {} if ekf is None else {f"ekf.{key}": value for key, value in ekf}
    lines = []
    for path, value, usual, meaning in _leaves(config):
        words, document = shown(value) or "none", stated.get(path)
        if value is None and chosen.get(path) is not None:
            words = f"{shown(chosen[path])} (by the log)"
        lines.append(
            SettingLine(
                path,
                words,
                "" if path in _INPUTS else shown(usual) or "none",
                path not in _INPUTS and value != usual,
                "" if document is None else f"{shown(document.document)} ({document.place})",
                meaning,
            )
        )
    return sorted(lines, key=lambda line: (not line.changed, not line.document))


def _leaves(section: SettingsGroup, below: str = "") -> Iterator[tuple[str, Any, Any, str]]:
    """Path, value, default and meaning of each setting; extensions by their names."""
    for name, field in type(section).model_fields.items():
        value, path = getattr(section, name), f"{below}{name}"
        if isinstance(value, SettingsGroup):
            yield from _leaves(value, f"{path}.")
        elif isinstance(value, Mapping) and all(
            isinstance(v, SettingsGroup) for v in value.values()
        ):
            yield path, tuple(value) or "none", "none", "features that take part besides"
            for key, part in value.items():
                yield from _leaves(part, f"{key}.")
        else:
            usual = field.get_default(call_default_factory=True)
            yield path, value, usual, field.description or ""
