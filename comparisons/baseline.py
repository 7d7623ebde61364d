"""Baselines: what was found on a log, kept in a small file, and what is found later beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from comparisons.atomic import Kind, begins, write_whole
from comparisons.checks.grade import GRADES
from comparisons.config import CheckConfig, RunConfig
from comparisons.errors import InputError, outdated_format, quoted, shorten
from comparisons.figures import Number, Side
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import read_text
from comparisons.options import merge
from comparisons.report.check import CheckResult
from comparisons.report.models import Result, found_numbers
from comparisons.settings import configure
from comparisons.words import Cause

Found = Result | CheckResult
"""What `slamcheck run` or `slamcheck check` found."""
State = Literal["holds", "better", "new", "broken"]

RELATIVE = 0.02
"""Share of a value that it may change by, unless the noise floor is wider."""
LEAST = 1e-3
"""Change that never matters, in a metric's own unit."""
NOISE = 3.0
"""A tolerance is at least so many times the range over repetitions."""

_METRIC = re.compile(r'\{\s+("value": .*),\s+("tolerance": .*)\s+\}')
_WHICH = ("source", "sha256")


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Metric(_Model):
    """value: of the first run; None where there was none. tolerance: largest change allowed."""

    value: float | None
    tolerance: float = Field(ge=0.0)


class _Versioned(BaseModel):
    """What a file of any version says of itself."""

    version: int = 4


class Baseline(_Versioned, _Model):
    """The file. config: of the run or check, all of which a comparison uses again.

    words: of a check, as its grade.
    """

    log: str
    sha256: str
    config: dict[str, Any] = Field(default_factory=dict)
    runs: int
    verdict: str
    words: dict[str, str | None] = Field(default_factory=dict)
    metrics: dict[str, Metric]
    versions: dict[str, str]

    @property
    def of_estimate(self) -> bool:
        """Whether it keeps what a check found of an estimate, not what a run found."""
        return bool(self.config.get("job") == "check")

    def config_at(self, source: str) -> RunConfig | CheckConfig:
        """The configuration with the log that a name or a path gives. Raises InputError."""
        over = merge(self.config, {"log": {"source": source}})
        over.get("log", {}).pop("sha256", None)  # compared by compare_with, which names both logs
        if self.of_estimate:
            return configure(CheckConfig, over=over)
        return configure(RunConfig, over=over)


@dataclass(frozen=True)
class Change:
    """One figure or word then and now. state: new is what the baseline does not have."""

    name: str
    then: float | str | None
    now: float | str | None
    tolerance: float
    state: State
    _: KW_ONLY
    side: Side | None = None

    @property
    def holds(self) -> bool:
        """Nothing got worse."""
        return self.state != "broken"

    def __str__(self) -> str:
        """In one line."""
        reported = f"{self.name}: {_reported(self.then)} then, {_reported(self.now)} now"
        if self.tolerance:
            reported += f", tolerance {self.tolerance:.3g}"
        return f"{reported} ({_side_in_words(self)})"


def figures(found: Found) -> dict[str, Number]:
    """What a baseline keeps, by name: what has a side."""
    every = found_numbers(found)
    return {name: number for name, number in every.items() if number.side not in (None, "left out")}


def build_baseline(results: Sequence[Found], config: RunConfig | CheckConfig) -> Baseline:
    """From repetitions of one run: the first one's values, the noise floor of all."""
    first = results[0]
    every = [figures(result) for result in results]
    kept = {}
    for name, number in every[0].items():
        values = [run[name].value for run in every if name in run]
        some = [value for value in values if value is not None]
        spread = max(some) - min(some) if some else 0.0
        kept[name] = Metric(value=number.value, tolerance=_tolerance(number, spread))
    return Baseline(
        log=first.log.name,
        sha256=first.log.sha256,
        config=_kept_config(config),
        runs=len(results),
        verdict=first.verdict,
        words=_words(first),
        metrics=kept,
        versions=first.versions,
    )


def updated(baseline: Baseline, found: Found, config: RunConfig | CheckConfig) -> Baseline:
    """Return the baseline with what was found now.

    A tolerance that was computed from its value is computed from the new one; any other, by hand
    or from repetitions, stays. config: for files that have none.
    """
    kept = {}
    for name, number in figures(found).items():
        old = baseline.metrics.get(name)
        tolerance = _tolerance(number)
        if old is not None and old.tolerance != _tolerance(number._replace(value=old.value)):
            tolerance = old.tolerance
        kept[name] = Metric(value=number.value, tolerance=tolerance)
    return baseline.model_copy(
        update={
            "config": baseline.config or _kept_config(config),
            "verdict": found.verdict,
            "words": _words(found),
            "metrics": kept,
            "versions": found.versions,
        }
    )


def compare_with(baseline: Baseline, found: Found) -> list[Change]:
    """All figures, the verdict first. Raises InputError where log or job is another one.

    What a baseline from before does not have is new, and so is what an estimate now has more than
    then; but a `count` may only be there as long as it is zero.
    """
    if isinstance(found, CheckResult) != baseline.of_estimate:
        jobs = ("slamcheck run", "an estimate")
        then_of, now_of = jobs if not baseline.of_estimate else jobs[::-1]
        raise InputError(f"{found.log.name}: is of {now_of}, expected {then_of}, as the baseline's")
    if found.log.sha256 != baseline.sha256:
        raise InputError(
            f"{found.log.name}: is not the log of the baseline ({shorten(baseline.log)}"
            f"{', another of this name' if found.log.name == baseline.log else ''}): its streams "
            "differ; save a new baseline: slamcheck baseline save "
            f"LOG NEW.json{' --estimate PATH' if baseline.of_estimate else ''}"
        )
    return changes_of(baseline, _all_words(found), figures(found))


def changes_of(
    baseline: Baseline, now: Mapping[str, str | None], found: Mapping[str, Number]
) -> list[Change]:
    """Return every word and figure of a baseline beside those of now."""
    then = _all_words(baseline)
    changes = [
        Change(name, then[name], now.get(name), 0.0, _word_state(name, then[name], now.get(name)))
        for name in then
    ]
    none = Metric(value=None, tolerance=0.0)
    for name in dict.fromkeys((*baseline.metrics, *found)):
        kept, number = baseline.metrics.get(name, none), found.get(name, Number(None))
        state = _state(kept, number)
        changes.append(
            Change(name, kept.value, number.value, kept.tolerance, state, side=number.side)
        )
    return changes


def read_baseline(path: Path) -> Baseline:
    """Raises InputError."""
    text = read_text(path)
    try:
        version = _Versioned.model_validate_json(text).version
        if version in (1, 2, 3):
            mend = "save a new one with slamcheck baseline save"
            raise outdated_format(path, f"a baseline of version {version}", mend)
        if version != 4:
            raise InputError(f"{path}: version {quoted(version)}, expected 4")
        kept = Baseline.model_validate_json(text)
    except ValidationError as error:
        raise InputError(f"{path}: not a baseline: {first_fault(error)}") from None
    try:
        kept.config_at(kept.log)
    except InputError as error:
        raise InputError(f"{path}: not a baseline: {error}") from None
    return kept


def _is_baseline(path: Path) -> bool:
    try:
        read_baseline(path)
    except InputError:
        return False
    return True


BASELINE = Kind("a baseline", _is_baseline)
JUNIT = Kind("an earlier report", begins(rb"(<\?xml [^>]*\?>\s*)?<testsuite name=\"slamcheck\."))


def write_baseline(baseline: Baseline, path: Path) -> None:
    """One metric a line, so that changes read well in a diff. Raises InputError."""
    text = _METRIC.sub(r"{\1, \2}", json.dumps(baseline.model_dump(), indent=1)) + "\n"
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), BASELINE)


def write_junit(
    changes: Sequence[Change], name: str, path: Path, causes: Sequence[Cause] = ()
) -> None:
    """A test case per metric, for continuous integration. Raises InputError.

    causes: of the verdict; they stand with what is worse in words.
    """
    why = "\n".join(f"{cause.gap}: {cause.evidence}; {cause.hint}" for cause in causes)
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
            failure = ElementTree.SubElement(case, "failure", message=str(change))
            failure.text = why if isinstance(change.then, str) else ""
        elif change.state != "holds":
            ElementTree.SubElement(case, "system-out").text = f"{change.state}: {change}"
    text = ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), JUNIT)


def _tolerance(number: Number, spread: float = 0.0) -> float:
    if number.value is None or number.exact:
        return 0.0
    return max(RELATIVE * abs(number.value), LEAST, NOISE * spread)


def _state(kept: Metric, number: Number) -> State:
    then, value, side = kept.value, number.value, number.side
    if side == "count":
        then, value = then or 0.0, value or 0.0
    if then is None or value is None:
        return "holds" if then is value else "broken" if value is None else "new"
    if number.rounding is not None and then <= number.rounding:
        return "holds" if value <= number.rounding else "broken"  # either is rounding
    if abs(value - then) <= kept.tolerance:
        return "holds"
    if side == "nominal":
        return "better" if abs(value - number.nominal) < abs(then - number.nominal) else "broken"
    return "better" if side == ("less" if value < then else "more") else "broken"


def _word_state(name: str, then: str | None, now: str | None) -> State:
    if then == now:
        return "holds"
    if name == "grade" and then in GRADES and now in GRADES:
        return "better" if GRADES.index(now) > GRADES.index(then) else "broken"
    return "better" if name == "verdict" and now == "agree" else "broken"


def _words(found: Found) -> dict[str, str | None]:
    """What a check says in words, and what it was asked."""
    if isinstance(found, Result):
        return {}
    names = ("grade", "required", "information", "association_by")
    return {name: getattr(found, name) for name in names}


def _all_words(baseline: Baseline | Found) -> dict[str, str | None]:
    words = baseline.words if isinstance(baseline, Baseline) else _words(baseline)
    return {"verdict": baseline.verdict, **words}


def _kept_config(config: RunConfig | CheckConfig) -> dict[str, Any]:
    """All settings but which log and which estimate, which each comparison is given."""
    kept = config.model_dump(mode="json", exclude_none=True)
    for section, name in ((kept, "estimate"), (kept, "times"), *((kept["log"], n) for n in _WHICH)):
        section.pop(name, None)
    return kept


def _side_in_words(change: Change) -> str:
    if isinstance(change.then, str) or isinstance(change.now, str):
        orders = {"grade": "in order of grades", "verdict": "agree is better"}
        return orders.get(change.name, "any change counts")
    if change.side in ("less", "more"):
        return f"{change.side} is better"
    if change.side == "nominal":
        return "nearer to its nominal value is better"
    return "any change counts"


def _reported(value: float | str | None) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else f"{value:.6g}"
