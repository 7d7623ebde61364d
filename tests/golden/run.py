"""Golden runs as baselines; `python -m tests.golden.run [CASE ...]` keeps them anew."""

import json
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.baseline import (
    Baseline,
    Change,
    Metric,
    changes_of,
    figures,
    read_baseline,
    write_baseline,
)
from comparisons.figures import Number
from comparisons.report.check import CheckResult
from comparisons.report.models import Result
from tests.commands import slamcheck
from tests.golden.cases import CASES, make_logs, with_before, words

KEPT = Path(__file__).parent / "kept"
MODELS: dict[str, type[Result | CheckResult]] = {"result.json": Result, "check.json": CheckResult}
"""Results whose figures are those of the product's own baselines, and those of extensions."""
LEFT_OUT = frozenset(
    {"config", "settings", "schema", "log", "seconds", "cpu_s", "scans_per_second", "versions"}
    | {"files", "starts", "minima", "id", "stated_noise"}
    | {"rank", "iterations", "hops", "random_starts"}
)
"""Keys that are no results, or the way to the optimum, or say of the log what its estimates do not
depend on."""
TOLERANCE = 1e-4
"""Share of a figure by which a processor's rounding may move it, and of LEAST where it is less."""
LEAST = 0.1
ROUNDING = 1e-6
"""What is below is rounding, and may be any."""


def run_case(name: str, work: Path) -> Baseline:
    """Run a case, and what comes before it, in a folder for all; look at what it left."""
    if not (work / "short").exists():
        make_logs(work)
    for one in with_before([name]):
        if one == name or not (work / one).exists():
            done = slamcheck(*words(one, work), cwd=work)
            assert done.returncode in (0, 1, 3), f"{one} ended with {done}"
    return baseline_of(work / name, done.returncode)


def baseline_of(folder: Path, code: int) -> Baseline:
    """Return the words and figures of a result, with the tolerances of golden runs."""
    (path,) = folder.glob("*.json")
    found = json.loads(path.read_text(encoding="utf-8"))
    values: dict[str, float | None] = {}
    more = found
    if path.name in MODELS:
        result = MODELS[path.name].model_validate(found)
        kept = figures(result).items()
        values = {name: one.value for name, one in kept if name.split(".")[0] not in LEFT_OUT}
        more = result.model_extra or {}
    values |= _summed_up(more)
    log = found.get("log", found)
    return Baseline(
        log=log.get("name", ""),
        sha256=log["sha256"],
        runs=1,
        verdict=found.get("verdict", ""),
        words={
            "exit code": str(code),
            "grade": found.get("grade"),
            "causes": ", ".join(cause["gap"] for cause in found.get("causes", ())),
        },
        metrics={name: _metric(v) for name, v in values.items() if v is not None},
        versions={},
    )


def differences(kept: Baseline, now: Baseline) -> list[Change]:
    """Return what does not hold; what is better or new does not, either."""
    values = {name: Number(metric.value) for name, metric in now.metrics.items()}
    changes = changes_of(kept, {"verdict": now.verdict, **now.words}, values)
    if kept.sha256 != now.sha256:
        changes.insert(0, Change("log", kept.sha256, now.sha256, 0.0, "broken"))
    return [change for change in changes if change.state != "holds"]


def _metric(value: float) -> Metric:
    """Counts are exact. Digits that no processor shares are not kept."""
    if isinstance(value, int):
        return Metric(value=value, tolerance=0.0)
    if abs(value) < ROUNDING:
        return Metric(value=0.0, tolerance=ROUNDING)
    tolerance = TOLERANCE * max(abs(value), LEAST)
    return Metric(value=float(f"{value:.7g}"), tolerance=float(f"{tolerance:.2g}"))


def _summed_up(found: dict[str, Any]) -> dict[str, float]:
    """Return numbers by name; those of a list together as their root mean square."""
    together = defaultdict(list)
    for name, value in _numbers(found):
        together[name].append(value)
    return {
        name: values[0] if len(values) == 1 else float(np.sqrt(np.mean(np.square(values))))
        for name, values in together.items()
    }


def _numbers(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            whole = f"{name}.{key}".removeprefix(".")
            if key not in LEFT_OUT:
                yield from _numbers(inner, whole)
    elif isinstance(value, list):
        if value and isinstance(value[0], dict):
            yield f"{name}.count", len(value)
        for inner in value:
            yield from _numbers(inner, name)
    elif isinstance(value, int | float):
        yield name, value


def main(names: list[str]) -> None:
    """Keep some cases, or all, anew. A figure that holds stays as it was."""
    with tempfile.TemporaryDirectory() as work:
        for name in with_before(names or CASES):
            now, path = run_case(name, Path(work)), KEPT / f"{name}.json"
            kept = read_baseline(path) if path.exists() else now
            changes = differences(kept, now)
            moved = {change.name for change in changes}
            steady = {n: m for n, m in kept.metrics.items() if n in now.metrics and n not in moved}
            write_baseline(now.model_copy(update={"metrics": now.metrics | steady}), path)
            print(name, *map(str, changes), sep="\n  ", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
