"""Baselines: what was found on a log, kept in a small file, and what is found later beside it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin
from xml.etree import ElementTree

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from comparisons.atomic import Kind, begins, write_whole
from comparisons.checks.agreement import LandmarkAgreement
from comparisons.checks.consistency.finding import (
    ConsistencyResult,
    ExternalConsistencyResult,
)
from comparisons.checks.grade import GRADES
from comparisons.config import CheckConfig, RunConfig
from comparisons.errors import InputError
from comparisons.figures import finite, kept_fields
from comparisons.logs.log_meta import first_fault
from comparisons.logs.table import read_text
from comparisons.options import merge
from comparisons.report.check import CheckResult
from comparisons.report.models import Result, metrics
from comparisons.settings import configure
from comparisons.statistics import Nis, NormalisedFigures
from comparisons.words import Cause

Found = Result | CheckResult
"""What `slamcheck run` or `slamcheck check` found."""
Side = Literal["less", "more", "nominal", "same", "count", "left out"]
"""Which change of a figure is for the better: less, more, nearer to its nominal value, or none. A
count is the same as none where it is zero. Figures that are left out are in no baseline."""
State = Literal["holds", "better", "new", "broken"]


class Judged(NamedTuple):
    """How a figure is judged, and why."""

    side: Side
    reason: str


SIDES: Mapping[str, Judged] = {
    # A name, or the end of one from a dot on; the longest that fits counts.
    "smoother.distance_sigma": Judged("left out", "of incremental methods, by their settings"),
    "smoother.error": Judged("same", "the optimum of the same log: any change is the smoother's"),
    "chi2": Judged("same", "as the error"),
    "rank": Judged("left out", "follows from the counts of poses and landmarks"),
    "iterations": Judged("left out", "the way to the optimum, not the optimum"),
    "newton_decrement": Judged("less", "distance that is left to the optimum"),
    "chance_missed": Judged("less", "chance of a better minimum that was not found"),
    "hops": Judged("left out", "the way to the optimum; its risk is in `chance_missed`"),
    "departure.time_s": Judged("left out", "where a difference begins, not how large it is"),
    "random_starts": Judged("left out", "as hops"),
    "*_limit_sigma": Judged("left out", "follows from the log's prior"),
    "*_gap_sigma": Judged("less", "a difference that should not be there"),
    "*_gap_covariance": Judged("less", "a difference that should not be there"),
    "optimism": Judged("nominal", "variances of the filter over the smoother's: 1"),
    "pessimism": Judged("nominal", "as optimism"),
    "variance_ratio_*": Judged("nominal", "as optimism"),
    "mean": Judged("nominal", "NEES and NIS have an expected value: their degrees of freedom"),
    "squared_per_dof": Judged("nominal", "as NEES, per degree of freedom: 1"),
    "landmark_difference_rms_m": Judged("less", "distance from the optimum"),
    "rms_m": Judged("less", "distance from the optimum"),
    "rms_heading_rad": Judged("less", "distance from the optimum"),
    "difference_*": Judged("less", "distance from the optimum"),
    "distance_sigma": Judged("less", "distance from the optimum"),
    "largest_sigma": Judged("less", "distance from the nearest reference"),
    "outside": Judged("less", "poses that contradict their own covariance"),
    "ate_*": Judged("less", "an error"),
    "rpe_*": Judged("less", "an error"),
    "landmark_rmse_*": Judged("less", "an error"),
    "gps_median_*": Judged("less", "an error"),
    "gps_rms_*": Judged("less", "an error"),
    "coverage": Judged("more", "share of the log that was estimated"),
    "landmarks_found": Judged("more", "true landmarks that the map holds"),
    "landmarks.agreeing": Judged("more", "landmarks that agree with the smoother's"),
    "global_update_spared": Judged("same", "a setting's effect: less is exact, more is quick"),
    **{
        name: Judged("count", "other data were used, for better or worse")
        for name in (
            *("landmarks", "landmarks.count", "landmarks_true", "poses", "dof"),
            *("rejected", "ambiguous", "candidate", "dynamic", "deactivated", "cut_off"),
            *("fixes_fused", "fixes_rejected", "fixes_in_streaks", "longest_streak"),
            *("fixes_rejected_by_smoother", "global_updates"),
            *("rejected_measurements", "rejected_positions"),
            *("trace.steps", "trace.updates", "trace.initialised", "trace.positions"),
        )
    },
}
"""How each figure is judged. Words are exact, but for the grade and a verdict that becomes `agree`,
which are better."""

RELATIVE = 0.02
"""Share of a value that it may change by, unless the noise floor is wider."""
LEAST = 1e-3
"""Change that never matters, in a metric's own unit."""
NOISE = 3.0
"""A tolerance is at least so many times the range over repetitions."""

_EXACT = ("ekf.landmarks", "smoother.poses", "landmarks.count", "landmarks.agreeing")
_METRIC = re.compile(r'\{\s+("value": .*),\s+("tolerance": .*)\s+\}')
_WHICH = ("source", "sha256")
_APART = ("settings", "log", "consistency")
"""Parts of a check's result that hold no figures of the estimate, or are read on their own."""
_GONE = ("scan_slam.enriched",)
"""Figures that earlier baselines have."""


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


def judged_by(name: str) -> Judged | None:
    """How a figure is judged by the table; None where it is not in it."""
    parts = name.split(".")
    for end in (".".join(parts[i:]) for i in range(len(parts))):
        for pattern, judged in SIDES.items():
            if fnmatchcase(end, pattern):
                return judged
    return None


def figures(found: Found) -> dict[str, float | None]:
    """What a baseline keeps, by name; None where a log or an estimate has no such figure."""
    if isinstance(found, Result):
        kept = metrics(found)
    else:
        kept = {}
        for path in number_paths(CheckResult):
            value: Any = found
            for part in path:
                value = getattr(value, part, None)
            kept[".".join(path)] = finite(value)
        kept |= _of_landmarks(found.landmarks)
    kept |= _of_consistency(found.consistency)
    return {name: value for name, value in kept.items() if not _left_out(name)}


def number_paths(kind: type, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Return where a result has numbers, in its parts as well, but in no lists."""
    for name, hint in kept_fields(kind).items():
        for one in get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,):
            if one in (int, float):
                yield (*above, name)
            elif isinstance(one, type) and name not in _APART:
                yield from number_paths(one, (*above, name))


def build_baseline(results: Sequence[Found], config: RunConfig | CheckConfig) -> Baseline:
    """From repetitions of one run: the first one's values, the noise floor of all."""
    first = results[0]
    every = [figures(result) for result in results]
    kept = {}
    for name, value in every[0].items():
        values = [v for v in (run[name] for run in every) if v is not None]
        spread = max(values) - min(values) if values else 0.0
        kept[name] = Metric(value=value, tolerance=_tolerance(name, value, spread))
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
    for name, value in figures(found).items():
        old = baseline.metrics.get(name)
        kept[name] = Metric(value=value, tolerance=_tolerance(name, value, 0.0))
        if old is not None and old.tolerance != _tolerance(name, old.value, 0.0):
            kept[name] = Metric(value=value, tolerance=old.tolerance)
    return baseline.model_copy(
        update={
            "version": Baseline.model_fields["version"].default,
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
    then; but a count may only be there as long as it is zero.
    """
    if isinstance(found, CheckResult) != baseline.of_estimate:
        jobs = ("slamcheck run", "an estimate")
        then_of, now_of = jobs if not baseline.of_estimate else jobs[::-1]
        raise InputError(f"{found.log.name}: is of {now_of}, expected {then_of}, as the baseline's")
    if found.log.sha256 != baseline.sha256:
        raise InputError(
            f"{found.log.name}: is not the log of the baseline ({baseline.log}"
            f"{', another of this name' if found.log.name == baseline.log else ''}): its streams "
            "differ, or slamcheck 0.2 or older saved it; save a new baseline: slamcheck baseline "
            f"save LOG NEW.json{' --estimate PATH' if baseline.of_estimate else ''}"
        )
    return changes_of(
        baseline,
        _all_words(found),
        figures(found),
        lambda name: _rounding(name, found),
        _expected(found),
    )


def changes_of(
    baseline: Baseline,
    now: Mapping[str, str | None],
    values: Mapping[str, float | None],
    rounding: Callable[[str], float | None] = lambda _: None,
    expected: Mapping[str, float] | None = None,
) -> list[Change]:
    """Return every word and figure of a baseline beside those of now.

    rounding: what rounding explains of a figure, by its name. expected: nominal values of averages;
    of other figures that have one it is 1.
    """
    then = _all_words(baseline)
    changes = [
        Change(name, then[name], now.get(name), 0.0, _word_state(name, then[name], now.get(name)))
        for name in then
    ]
    none = Metric(value=None, tolerance=0.0)
    for name in dict.fromkeys((*baseline.metrics, *values)):
        kept = baseline.metrics.get(name, none)
        value = values.get(name)
        nominal = (expected or {}).get(name, 1.0)
        state = _state(name, kept, value, rounding(name), nominal)
        changes.append(Change(name, kept.value, value, kept.tolerance, state))
    return changes


def read_baseline(path: Path) -> Baseline:
    """Raises InputError."""
    text = read_text(path)
    try:
        version = _Versioned.model_validate_json(text).version
        if version in (1, 2):
            raise InputError(
                f"{path}: version {version} of slamcheck 0.1, which 0.2 reads; save a new one"
            )
        if version not in (3, 4):
            raise InputError(f"{path}: version {version}, expected 3 or 4")
        kept = Baseline.model_validate_json(text)
    except ValidationError as error:
        raise InputError(f"{path}: not a baseline: {first_fault(error)}") from None
    there = {name: metric for name, metric in kept.metrics.items() if name not in _GONE}
    kept = kept.model_copy(update={"metrics": there})
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
    why = "\n".join(f"{one.gap}: {one.evidence}; {one.hint}" for one in causes)
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


def _tolerance(name: str, value: float | None, spread: float) -> float:
    if value is None or name in _EXACT:
        return 0.0
    return max(RELATIVE * abs(value), LEAST, NOISE * spread)


def _rounding(name: str, found: Found) -> float | None:
    """What rounding explains of a gap; None for other figures."""
    gaps = found.agreement if isinstance(found, Result) else found.trace
    limits = {"algebra_gap": "algebra_limit_sigma", "model_gap": "model_limit_sigma"}
    of = next((limit for gap, limit in limits.items() if gap in name), None)
    return None if of is None or gaps is None else float(getattr(gaps, of))


def _state(
    name: str, kept: Metric, value: float | None, rounding: float | None, nominal: float
) -> State:
    judged = judged_by(name)
    side = judged.side if judged else "same"
    then = kept.value
    if side == "count":
        then, value = then or 0.0, value or 0.0
    if then is None or value is None:
        return "holds" if then is value else "broken" if value is None else "new"
    if rounding is not None and then <= rounding:
        return "holds" if value <= rounding else "broken"  # either is rounding
    if not math.isfinite(value):
        return "broken"
    if abs(value - then) <= kept.tolerance:
        return "holds"
    if side == "nominal":
        return "better" if abs(value - nominal) < abs(then - nominal) else "broken"
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


def _all_words(one: Baseline | Found) -> dict[str, str | None]:
    words = one.words if isinstance(one, Baseline) else _words(one)
    return {"verdict": one.verdict, **words}


def _kept_config(config: RunConfig | CheckConfig) -> dict[str, Any]:
    """All settings but which log and which estimate, which each comparison is given."""
    kept = config.model_dump(mode="json", exclude_none=True)
    for section, name in ((kept, "estimate"), (kept, "times"), *((kept["log"], n) for n in _WHICH)):
        section.pop(name, None)
    return kept


def _of_landmarks(rows: Sequence[LandmarkAgreement]) -> dict[str, float | None]:
    """Return figures of all landmarks together; those without any are None."""
    found: dict[str, float | None] = {
        "landmarks.count": len(rows),
        "landmarks.agreeing": sum(row.agrees for row in rows),
    }
    least, largest = (
        [value for row in rows if (value := finite(getattr(row, name))) is not None]
        for name in ("variance_ratio_least", "variance_ratio_largest")
    )
    squares = [r.difference_m**2 for r in rows]
    found["landmarks.difference_rms_m"] = float(np.sqrt(np.mean(squares))) if rows else None
    found["landmarks.distance_sigma"] = max((r.distance_sigma for r in rows), default=None)
    found["landmarks.variance_ratio_least"] = min(least, default=None)
    found["landmarks.variance_ratio_largest"] = max(largest, default=None)
    return found


def _of_consistency(
    found: ConsistencyResult | ExternalConsistencyResult,
) -> dict[str, float | None]:
    """Averages of the NEES and NIS, and of the estimate's poses against the smoother's."""
    kept: dict[str, float | None] = {name: one.mean for name, one in _averages(found)}
    if found.filter_against_smoother is not None:
        squared = found.filter_against_smoother.squared_per_dof
        kept["filter_against_smoother.squared_per_dof"] = squared
    return {f"consistency.{name}": value for name, value in kept.items()}


def _averages(
    found: ConsistencyResult | ExternalConsistencyResult,
) -> Iterator[tuple[str, Nis | NormalisedFigures]]:
    """Return what has a mean and the degrees of freedom that this should be, by name."""
    if isinstance(found, ConsistencyResult):
        name, truth = "ekf", found.ekf
        for sensor in found.innovations:
            yield from ((f"innovations.{sensor.sensor}.{one.name}.mean", one) for one in sensor.nis)
    else:
        name, truth = "truth", found.truth
    for part in () if truth is None else type(truth).model_fields:
        one = getattr(truth, part)
        if getattr(one, "mean", None) is not None:
            yield f"{name}.{part}.mean", one


def _expected(found: Found) -> dict[str, float]:
    """Return the nominal value of each average."""
    return {f"consistency.{name}": float(one.dof) for name, one in _averages(found.consistency)}


def _left_out(name: str) -> bool:
    judged = judged_by(name)
    return judged is not None and judged.side == "left out"


def _side_in_words(change: Change) -> str:
    if isinstance(change.then, str) or isinstance(change.now, str):
        orders = {"grade": "in order of grades", "verdict": "agree is better"}
        return orders.get(change.name, "any change counts")
    judged = judged_by(change.name)
    if judged is not None and judged.side in ("less", "more"):
        return f"{judged.side} is better"
    if judged is not None and judged.side == "nominal":
        return "nearer to its nominal value is better"
    return "any change counts"


def _reported(value: float | str | None) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else f"{value:.6g}"
