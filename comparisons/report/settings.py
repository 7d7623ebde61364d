"""Which of a run's settings are not the documents', as rows and an entry of the result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from comparisons.config import EkfConfig, JobConfig, SettingsGroup, setting_default
from comparisons.documented.preset import differing
from comparisons.documented.row import Value, shown
from comparisons.figures import Model
from comparisons.words import SETTINGS, Row


class DifferingSetting(Model):
    """A setting of the run that a document states at another value.

    Attributes:
        setting: name of the setting.
        value: value of the run; in words where it follows from other settings.
        document: value of the document.
        place: where the document states it.
    """

    setting: str
    value: Any
    document: Value
    place: str


class SettingsResult(Model):
    """Settings of the run that are not the documents'.

    Attributes:
        preset: value of `--preset`.
        differing: settings that a document states at another value.
    """

    preset: str
    differing: list[DifferingSetting]


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

    settings: what documents state at other values. ekf: as of settings_result.
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


def settings_result(
    config: JobConfig, log_format: str | None = None, ekf: EkfConfig | None = None
) -> SettingsResult:
    """Return how a run was set.

    log_format: in which the log was read. ekf: the filter's settings once nothing is left open.
    """
    given = config.model_dump(mode="python")
    given["log"]["format"] = log_format
    if ekf is not None:
        given["ekf"] = ekf.model_dump(mode="python")
    settings = [
        DifferingSetting(
            setting=row.at,
            value=row.absent if value is None else _in_json(value),
            document=_in_json(row.value),
            place=row.place,
        )
        for row, value in differing(given, setting_default)
    ]
    return SettingsResult(preset=config.preset, differing=settings)


def _in_json(value: Any) -> Any:
    """JSON has no infinity; a configuration in it has this word, too."""
    return "Infinity" if value == math.inf else value


def settings_rows(settings: SettingsResult) -> list[Row]:
    """Return the preset, and each setting that a document states at another value."""
    return [
        Row(SETTINGS, "preset", settings.preset),
        *(
            Row(
                SETTINGS,
                setting.setting,
                shown(setting.value),
                f"{shown(setting.document)} in {setting.place}",
            )
            for setting in settings.differing
        ),
    ]
