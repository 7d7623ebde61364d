"""Which of a run's settings are not the documents', as rows and an entry of the result."""

from __future__ import annotations

import math
from typing import Any

from comparisons.config import EkfConfig, JobConfig
from comparisons.documented.preset import differing
from comparisons.documented.row import Value, shown
from comparisons.extensions.interface import Row
from comparisons.report.model import Model


class DifferingSetting(Model):
    """A setting of the run, and what the document at `place` states in its place.

    value: in words where it follows from other settings.
    """

    setting: str
    value: Any
    document: Value
    place: str


class SettingsResult(Model):
    """How the run was set. differing: settings that a document states at another value."""

    preset: str
    differing: list[DifferingSetting]


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
    found = [
        DifferingSetting(
            setting=row.at,
            value=row.absent if value is None else _in_json(value),
            document=_in_json(row.value),
            place=row.place,
        )
        for row, value in differing(given)
    ]
    return SettingsResult(preset=config.preset, differing=found)


def _in_json(value: Any) -> Any:
    """JSON has no infinity; a configuration in it has this word, too."""
    return "Infinity" if value == math.inf else value


def settings_rows(settings: SettingsResult) -> list[Row]:
    """Return the preset, and each setting that a document states at another value."""
    return [
        Row("Settings", "preset", settings.preset),
        *(
            Row("Settings", one.setting, shown(one.value), f"{shown(one.document)} in {one.place}")
            for one in settings.differing
        ),
    ]
