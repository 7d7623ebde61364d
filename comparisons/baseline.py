"""Baselines: what a run of a log found, kept in a small file, and later runs held against it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from comparisons.atomic import write_whole
from comparisons.checks.agreement import ROUNDING
from comparisons.config import RunConfig, merge
from comparisons.errors import InputError
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import read_text
from comparisons.report.models import Result
from comparisons.report.result import metrics
from comparisons.settings import configure, run_options

RELATIVE = 0.02
"""Share of a value that it may change by, unless the noise floor is wider."""
LEAST = 1e-3
"""Change that never matters, in a metric's own unit."""
NOISE = 3.0
"""A tolerance is at least so many times the range over repetitions."""

_ROUNDED = ("algebra_gap", "model_gap")
_EXACT = ("ekf.landmarks", "smoother.poses")


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Metric(_Model):
    """value: of the first run; None where there was none. tolerance: largest change allowed."""

    value: float | None
    tolerance: float


class Baseline(_Model):
    """The file. config: of the run, all of which a comparison uses again.

    settings: in files of version 1, a few options by name, an empty text for one not given.
    """

    version: int = 2
    log: str
    sha256: str
    config: dict[str, Any] = Field(default_factory=dict)
    settings: dict[str, str | int | float] = Field(default_factory=dict, exclude=True)
    runs: int
    verdict: str
    metrics: dict[str, Metric]
    versions: dict[str, str]

    def config_at(self, source: str) -> RunConfig:
        """The run's configuration with the log that a name or a path gives. Raises InputError."""
        options = {name: value for name, value in self.settings.items() if value != ""}
        over = merge(self.config, {"log": {"source": source}})
        over.get("log", {}).pop("sha256", None)  # compared by compare_with, which names both logs
        return configure(RunConfig, flags=run_options(options), over=over)


@dataclass(frozen=True)
class Change:
    """One metric then and now. holds: the change is within its tolerance."""

    name: str
    then: float | str | None
    now: float | str | None
    tolerance: float
    holds: bool

    def __str__(self) -> str:
        """In one line."""
        return f"{self.name}: {_told(self.then)} then, {_told(self.now)} now" + (
            "" if self.tolerance == 0.0 else f", tolerance {self.tolerance:.3g}"
        )


def build_baseline(results: Sequence[Result], config: RunConfig) -> Baseline:
    """From repetitions of one run: the first one's values, the noise floor of all."""
    first = results[0]
    every = [metrics(result) for result in results]
    kept = {}
    for name, value in every[0].items():
        values = [v for v in (run[name] for run in every) if v is not None]
        spread = max(values) - min(values) if values else 0.0
        kept[name] = Metric(value=value, tolerance=_tolerance(name, value, spread))
    return Baseline(
        log=first.log.name,
        sha256=first.log.sha256,
        config=config.model_dump(mode="json", exclude_none=True),
        runs=len(results),
        verdict=first.verdict,
        metrics=kept,
        versions=first.versions,
    )


def compare_with(baseline: Baseline, result: Result) -> list[Change]:
    """All metrics, the verdict first. Raises InputError where the log is another one.

    A count that a baseline from before does not have may be there, as long as it is zero; a
    measure that it does not have has nothing to be compared with.
    """
    if result.log.sha256 != baseline.sha256:
        raise InputError(
            f"{result.log.name}: is not the log of the baseline ({baseline.log}): its streams "
            "differ; save a new baseline"
        )
    changes = [
        Change("verdict", baseline.verdict, result.verdict, 0.0, baseline.verdict == result.verdict)
    ]
    now = metrics(result)
    for name, kept in baseline.metrics.items():
        value = now.pop(name, None)
        changes.append(Change(name, kept.value, value, kept.tolerance, _holds(name, kept, value)))
    changes += [
        Change(name, None, value, 0.0, not value or isinstance(value, float))
        for name, value in now.items()
    ]
    return changes


def read_baseline(path: Path) -> Baseline:
    """Raises InputError."""
    try:
        kept = Baseline.model_validate_json(read_text(path))
    except ValidationError as error:
        raise InputError(f"{path}: not a baseline: {first_fault(error)}") from None
    if kept.version not in (1, 2):
        raise InputError(f"{path}: version {kept.version}, expected 1 or 2")
    try:
        kept.config_at(kept.log)
    except InputError as error:
        raise InputError(f"{path}: not a baseline: {error}") from None
    return kept


def write_baseline(baseline: Baseline, path: Path) -> None:
    """One metric a line, so that changes read well in a diff. Raises InputError."""
    text = json.dumps(baseline.model_dump(), indent=1) + "\n"
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def write_junit(changes: Sequence[Change], name: str, path: Path) -> None:
    """A test case per metric, for continuous integration. Raises InputError."""
    failed = sum(not change.holds for change in changes)
    suite = ElementTree.Element(
        "testsuite",
        name=f"slamcheck.{name}",
        tests=str(len(changes)),
        failures=str(failed),
        errors="0",
    )
    for change in changes:
        case = ElementTree.SubElement(suite, "testcase", classname=name, name=change.name)
        if not change.holds:
            ElementTree.SubElement(case, "failure", message=str(change))
    text = ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _tolerance(name: str, value: float | None, spread: float) -> float:
    if value is None or name in _EXACT:
        return 0.0
    return max(RELATIVE * abs(value), LEAST, NOISE * spread)


def _holds(name: str, kept: Metric, value: float | None) -> bool:
    if kept.value is None or value is None:
        return kept.value is value
    if any(part in name for part in _ROUNDED) and kept.value <= ROUNDING:
        return value <= ROUNDING  # either is rounding
    return math.isfinite(value) and abs(value - kept.value) <= kept.tolerance


def _told(value: float | str | None) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else f"{value:.6g}"
