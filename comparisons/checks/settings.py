"""Which of a job's settings are not the documents'."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from comparisons.checks.check import About
from comparisons.checks.finding import JobPart
from comparisons.config import Configured, EkfConfig, JobConfig, setting_default
from comparisons.documented.preset import differing
from comparisons.documented.row import Value, shown
from comparisons.figures import Model
from comparisons.words import SETTINGS, Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known


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

    def rows(self) -> list[Row]:
        """Return the preset, and each setting that a document states at another value."""
        return [
            Row(SETTINGS, "preset", self.preset),
            *(
                Row(
                    SETTINGS,
                    setting.setting,
                    shown(setting.value),
                    f"{shown(setting.document)} in {setting.place}",
                )
                for setting in self.differing
            ),
        ]


class AboutSettings(About):
    """Which settings are not the documents'?"""

    name = "settings"
    needs = "a configuration"
    figures = (("settings", SettingsResult),)

    def find(self, known: Known) -> JobPart[SettingsResult]:
        """Return the preset, and what a document states at another value."""
        prepared = known.prepared
        ekf = prepared.ekf if isinstance(prepared.config, Configured) else None
        return JobPart("settings", settings_result(prepared.config, known.log.format, ekf))


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
