"""Fixtures for pytest: logs from a folder, the verdict on each, and baselines.

With `slam_logs = path/to/logs` among pytest's settings:

    def test_my_filter(slam_log, slam_check):
        assert slam_check(slam_log).outcome == "agree"
        assert slam_check(slam_log, estimate="output/mine.tum").outcome == "agree"

A test that fails shows verdict, causes and the folder of its report (docs/regression-gates.md).
Nothing heavy is imported before a test asks for it.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import pytest

from slamcheck._packages import check_packages

if TYPE_CHECKING:
    from comparisons.baseline import Found
    from comparisons.config import CheckConfig, RunConfig
    from comparisons.logs.log import Log
    from comparisons.pipeline.clock import Progress
    from comparisons.pipeline.solve import Solution
    from comparisons.report.job import Report

P = ParamSpec("P")
T = TypeVar("T")


class Outcome(str):
    """`agree`, `disagree` or `unverified`, and what it is the outcome of."""

    of: LogJudgement

    def __new__(cls, value: str, of: LogJudgement) -> Outcome:
        """Return the word, which knows more."""
        self = super().__new__(cls, value)
        self.of = of
        return self


@dataclass(frozen=True, kw_only=True)
class LogJudgement:
    """What was found on a log.

    title: log and estimate. report: of the job; folder: where it goes if the test fails; shown: the
    same, in words.
    """

    title: str
    report: Report[Any, Any]
    folder: Path
    shown: str

    @property
    def result(self) -> Found:
        """What `result.json` or `check.json` has."""
        found: Found = self.report.result
        return found

    @property
    def outcome(self) -> Outcome:
        """`agree`, `disagree` or `unverified`."""
        return Outcome(self.result.verdict, self)

    @property
    def causes(self) -> list[Any]:
        """Why, each with `gap`, `evidence` and `hint`."""
        return list(self.result.causes)

    @property
    def remarks(self) -> list[str]:
        """What else there is to know."""
        return list(self.result.remarks)

    def __bool__(self) -> bool:
        """`agree`, so that an assertion without a comparison is none that always holds."""
        return self.outcome == "agree"

    def __repr__(self) -> str:
        """Return verdict and causes by name."""
        causes = ", ".join(cause.gap for cause in self.result.causes)
        return f"<{self.title}: {self.outcome}{causes and f' ({causes})'}>"

    def lines(self) -> list[str]:
        """Return the first cause, the verdict and the report's folder; pytest cuts what is long."""
        from comparisons.report.terminal import in_short
        from comparisons.words import cause_name

        found, grade, lines = self.result, "", list[str]()
        if value := getattr(found, "grade", None):
            grade = f", grade {value}, required {getattr(found, 'required', None)}"
        for cause in found.causes[:1]:
            lines += [in_short(cause), f"  hint: {cause.hint}"]
        lines.append(f"{self.title}: {found.verdict}{grade}")
        if others := [cause_name(cause.gap) for cause in found.causes[1:]]:
            lines.append(f"also: {', '.join(others)}")
        return [*lines, f"report: {self.shown}"]

    def write_report(self) -> str:
        """Write the report. Return what `--verbose` prints, and the report's folder."""
        import io

        from rich.console import Console

        from comparisons.errors import InputError
        from comparisons.report.terminal import print_summary

        buffer = io.StringIO()
        console = Console(file=buffer, width=100, color_system=None, soft_wrap=True)
        print_summary(self.report.summary(), console, verbose=True)
        table = "\n".join(line.rstrip() for line in buffer.getvalue().splitlines())
        try:
            self.report.write(self.folder)
        except (InputError, OSError) as error:
            return f"{table}\nno report: {error}"
        return f"{table}\nreport: {self.shown}"


_JUDGED = pytest.StashKey[list[LogJudgement]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the logs are, and where reports go."""
    parser.addini("slam_logs", "folder whose entries are logs, or names of bundled logs", "args")
    reported = "folder for the reports of failing tests"
    parser.addini("slam_reports", reported, default="slamcheck-reports")
    parser.getgroup("slamcheck").addoption(
        "--slam-reports", metavar="DIR", help=f"{reported} (setting slam_reports)"
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test per log."""
    if "slam_log" not in metafunc.fixturenames:
        return
    found = list(_logs(metafunc.config))
    metafunc.parametrize("slam_log", found, ids=[Path(n).name for n in found], indirect=True)


def pytest_assertrepr_compare(op: str, left: object, right: object) -> list[str] | None:
    """Say why an outcome is not the one that was asked for."""
    outcome = left if isinstance(left, Outcome) else right
    if not isinstance(outcome, Outcome):
        return None
    first, *lines = outcome.of.lines()
    return [f"{left!r} {op} {right!r}: {first}", *lines]


@pytest.hookimpl(hookwrapper=True, tryfirst=True)  # `wrapper` would stop pytest 7 at its start
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, None]:
    """Keep the reports of a test that failed."""
    report: pytest.TestReport = (yield).get_result()
    judged = item.stash.get(_JUDGED, [])
    if judged and report.failed:
        with _quiet():
            reported = [(f"slamcheck: {one.title}", one.write_report()) for one in judged]
        report.sections += reported
    if judged and (report.failed or call.when == "teardown"):
        judged.clear()


@pytest.fixture
def slam_log(request: pytest.FixtureRequest) -> Log:
    """A log of the folder that the setting `slam_logs` names."""
    from comparisons.logs.bundled import open_log

    return _plain(open_log)(request.param)


@pytest.fixture(scope="session")
def _slam_kept() -> dict[str, Any]:
    """Runs and solutions of this session, or of this worker of pytest-xdist."""
    return {}


@pytest.fixture
def slam_check(
    request: pytest.FixtureRequest, _slam_kept: dict[str, Any]
) -> Callable[..., LogJudgement]:
    """Judge a log: the reference EKF's run, or the estimate of another system given as a path.

    The log is one that was read, as `slam_log`, or a name or path. What is returned has `outcome`,
    `causes`, `remarks` and `result`. Settings are named as the options of `slamcheck run`, as
    `filter="compressed"`; for an estimate as those of `slamcheck check`, as `require="like"`. The
    smoother of a log is solved once a session for each of its own settings.
    """

    @_plain
    def check(
        log: Log | str | Path, estimate: str | Path | None = None, **settings: Any
    ) -> LogJudgement:
        from comparisons.config import CheckConfig, RunConfig
        from comparisons.logs.log import Log
        from comparisons.options.table import of_job
        from comparisons.settings import by_name, configure

        table = of_job("run" if estimate is None else "check")
        if isinstance(log, Log):  # read already
            table = tuple(flag for flag in table if not flag.field.startswith("log."))
        given = {name: str(v) if isinstance(v, Path) else v for name, v in settings.items()}
        if estimate is not None:
            given["estimate"] = str(estimate)
        flags = by_name(table, given)
        over = {} if isinstance(log, Log) else {"log": {"source": str(log)}}
        config: RunConfig | CheckConfig = (
            configure(RunConfig, flags=flags, over=over)
            if estimate is None
            else configure(CheckConfig, flags=flags, over=over)
        )
        return _judge(request, _slam_kept, log, config)

    return check


@pytest.fixture
def slam_baseline(
    request: pytest.FixtureRequest, _slam_kept: dict[str, Any]
) -> Callable[..., LogJudgement]:
    """Fail where a log, or an estimate given as a path, is worse than its baseline.

    The file is one of `slamcheck baseline save`, whose settings are used.
    """

    @_plain
    def compare(
        log: Log | str | Path, file: str | Path, estimate: str | Path | None = None
    ) -> LogJudgement:
        from comparisons.baseline import compare_with, read_baseline
        from comparisons.errors import InputError

        kept = read_baseline(Path(file))
        if kept.of_estimate != (estimate is not None):
            reported = "an estimate: give" if kept.of_estimate else "slamcheck run: leave out"
            raise InputError(f"{file}: is of {reported} estimate=PATH")
        config = kept.config_at(str(log) if isinstance(log, str | Path) else kept.log)
        if estimate is not None:
            config = config.model_copy(update={"estimate": str(estimate)})
        found = _judge(request, _slam_kept, log, config)
        changes = compare_with(kept, found.result)
        broken = [f"broken: {change}" for change in changes if not change.holds]
        if broken:
            *lines, report = found.lines()
            lines.append(f"{file}: {len(broken)} of {len(changes)} figures are worse")
            pytest.fail("\n".join([*lines, *broken, report]))
        return found

    return compare


def _judge(
    request: pytest.FixtureRequest,
    kept: dict[str, Any],
    log: Log | str | Path,
    config: RunConfig | CheckConfig,
) -> LogJudgement:
    """Find what there is to find, and note it for the test's report."""
    from comparisons.config import CheckConfig

    log = _read(log, config)
    judged = request.node.stash.setdefault(_JUDGED, [])
    folder = _folder(request.config, request.node, len(judged))
    root = request.config.rootpath
    place = folder.relative_to(root) if folder.is_relative_to(root) else folder
    title = log.name
    checked: object
    if isinstance(config, CheckConfig):
        from comparisons.jobs.check import check
        from comparisons.pipeline.read import read_estimate

        title += f", estimate {config.estimate}"
        given = read_estimate(config)
        checked = check(log, given, config, solver=partial(_solved, kept))
    else:
        from comparisons.jobs.run import compare

        checked = _once(kept, log, config, lambda: compare(log, config))
    from comparisons.report.job import report_of

    report = report_of(checked)
    found = LogJudgement(title=title, report=report, folder=folder, shown=str(place))
    judged.append(found)
    return found


def _read(log: Log | str | Path, config: RunConfig | CheckConfig) -> Log:
    """A log that was read as it is, another by the name or path that the settings have, too."""
    from comparisons.errors import InputError
    from comparisons.logs.log import Log
    from comparisons.pipeline.read import load_log

    if isinstance(log, Log):
        return log
    if isinstance(log, str | Path):
        return load_log(config.log)
    raise InputError(f"log: is a {type(log).__name__}, expected slam_log, a name or a path")


def _solved(kept: dict[str, Any], log: Log, config: CheckConfig, progress: Progress) -> Solution:
    """Return a log's solution, made once for each of the smoother's settings."""
    import copy
    from dataclasses import replace

    from comparisons.config import SolveConfig
    from comparisons.pipeline.solve import solve

    own = set(SolveConfig.model_fields) - {"job", "log"}
    asked = SolveConfig.model_construct(**{name: getattr(config, name) for name in own})
    found: Solution = _once(kept, log, asked, lambda: solve(log, asked, progress))
    prepared = replace(
        found.prepared,
        config=config.model_copy(update={"log": found.prepared.config.log}),
        clock=copy.deepcopy(found.prepared.clock),
    )
    return replace(found, prepared=prepared)


def _once(kept: dict[str, Any], log: Log, config: Any, make: Callable[[], Any]) -> Any:
    """Make what a log, truth and all, and settings decide, but once."""
    import joblib

    key = joblib.hash((log, config.model_dump_json()))
    if key not in kept:
        kept[key] = make()
    return kept[key]


def _folder(config: pytest.Config, item: pytest.Item, number: int) -> Path:
    """Return the folder of a test's report: module, class and test, by names that any system takes.

    number: how many reports of the test come before.
    """
    from comparisons.atomic import folder_name

    asked: str = config.getoption("slam_reports") or config.getini("slam_reports")
    root = config.rootpath / asked
    module, *names = item.nodeid.split("::", maxsplit=1)
    name = "::".join(names)
    end = folder_name(name.replace("[", "-").rstrip("]"))
    if not re.fullmatch(r"(\w+::)*\w+(\[[\w.-]+\])?", name, re.ASCII) or len(name) > 80:
        end += f"-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
    parts = [folder_name(part) for part in Path(module).with_suffix("").parts if part != ".."]
    return root.joinpath(*parts, end if number == 0 else f"{end}-{number + 1}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Let no warning of a library fail somebody's test; see comparisons.cli.support.guarded."""
    import numpy as np

    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield


def _plain(function: Callable[P, T]) -> Callable[P, T]:
    """Be quiet, and leave the way out of known faults that they took through this project."""

    @wraps(function)
    def call(*args: P.args, **values: P.kwargs) -> T:
        __tracebackhide__ = True
        try:
            check_packages()
        except ImportError as error:
            pytest.fail(str(error), pytrace=False)
        from comparisons.errors import InputError

        with _quiet():
            try:
                return function(*args, **values)
            except (InputError, pytest.fail.Exception) as error:
                raise error.with_traceback(None) from None

    return call


def _logs(config: pytest.Config) -> list[str]:
    names: list[str] = []
    for entry in config.getini("slam_logs"):
        folder = (config.rootpath / entry) if not Path(entry).is_absolute() else Path(entry)
        if folder.is_dir() and not (folder / "log.toml").exists():
            names += sorted(str(p) for p in folder.iterdir() if not p.name.startswith("."))
        else:
            names.append(str(folder) if folder.exists() else entry)
    return names
