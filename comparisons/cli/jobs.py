"""What the jobs' commands share: from what was given to the folder, and to the exit code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from comparisons.cli.flags import Arguments
from comparisons.cli.support import (
    VERDICTS,
    Output,
    guarded,
    print_result,
    progress_bar,
    say_streams,
)
from comparisons.errors import InputError

if TYPE_CHECKING:
    from comparisons.config import JobConfig
    from comparisons.logs.log import Log
    from comparisons.pipeline.clock import Clock, Progress

C = TypeVar("C", bound="JobConfig")


@dataclass(frozen=True)
class Job(Generic[C]):
    """A job about to be done. read: the time that reading the log took."""

    log: Log
    config: C
    folder: Path
    read: Clock


def do_job(
    given: Arguments,
    work: Callable[[Progress], tuple[Job[Any], object]],
    after: Callable[[Any], None] = lambda found: None,
) -> None:
    """Work, write the report, print it and exit.

    work: returns what it did and what it found. after: done with that, when all is printed.
    """
    with guarded(log_file=given.log_file):
        with progress_bar(given.output) as progress:
            job, found = work(progress)
            progress("report", 0, 0)
            from comparisons.report.job import report_of

            report = report_of(found, job.read)
            file = report.write(job.folder)
        print_result(report.summary(), file, given.output)
        after(found)
        raise SystemExit(VERDICTS[report.outcome])


def do_plain_job(
    given: Arguments, kind: str, work: str, base: Mapping[str, Any] | None = None
) -> None:
    """Do a job that is one function of log, configuration and progress.

    kind: name of its configuration. work: `module:function`. Both are loaded here. base: see
    read_job.
    """

    def done(progress: Progress) -> tuple[Job[Any], object]:
        job = start_job(given, resolve_name(f"comparisons.config:{kind}"), base)
        return job, resolve_name(work)(job.log, job.config, progress)

    do_job(given, done)


def start_job(
    given: Arguments,
    kind: type[C],
    base: Mapping[str, Any] | None = None,
    check: Callable[[C], None] = lambda config: None,
) -> Job[C]:
    """Settle the configuration, read the log, and see that the folder is free or of the same run.

    base, check: see read_job. Raises InputError.
    """
    from comparisons.report.destination import check_free, default_folder

    if given.out is not None:
        check_free(given.out)
    log, config, read = read_job(given, kind, base, check)
    if given.output is not Output.QUIET:
        say_streams(log, config.log.source)
    folder = given.out or default_folder(config, log.name, base or {})
    check_free(folder, config, replace=given.replace)
    return Job(log, config, folder, read)


def read_job(
    given: Arguments,
    kind: type[C],
    base: Mapping[str, Any] | None = None,
    check: Callable[[C], None] = lambda config: None,
) -> tuple[Log, C, Clock]:
    """Settle the configuration and read the log; the last is the time that took.

    base: settings where there is no file. check: what must hold before the log is read. Raises
    InputError.
    """
    from comparisons.pipeline.read import read_for
    from comparisons.settings import configure

    file, source = _file_and_source(given)
    over = {} if source is None else {"log": {"source": source}}
    if file is None:
        over = {**(base or {}), **over}
    config = configure(kind, file, given.flags, given.settings, over)
    check(config)
    return read_for(config, allow_changed=given.allow_changed_log)


def _file_and_source(given: Arguments) -> tuple[Path | None, str | None]:
    """The configuration's file and the log's name, either of which the argument may be."""
    file, source = given.config, given.log
    if source is not None and Path(source).suffix == ".toml" and Path(source).is_file():
        if _is_log(Path(source)):
            return file, source
        if file is not None:
            raise InputError(f"{source}: a second configuration; give one of it and --config")
        return Path(source), None
    return file, source


def _is_log(path: Path) -> bool:
    """Whether a TOML file is a log folder's `log.toml`, by its name and content."""
    from comparisons.logs.log_meta import MARK
    from comparisons.logs.table import read_toml

    return path.name == MARK and "job" not in (found := read_toml(path)) and "odometry" in found
