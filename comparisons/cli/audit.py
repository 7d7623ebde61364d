"""`slamcheck audit`: a trace of any Kalman filter."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from comparisons.cli.flags import OUTPUT, argument, parameter, set_parameters
from comparisons.cli.support import VERDICTS, chosen_output, guarded, print_result, progress_bar
from comparisons.errors import InputError


def audit(trace: Path, tolerance: float, out: Path | None, **output: bool) -> None:
    """Audit a trace of any Kalman filter: its algebra, gains and consistency.

    A trace is recorded by slamcheck.Recorder, or in C++ by cpp/slamcheck_recorder.hpp. Exit code
    0: the filter is sound; 1: a fault was found; 3: nothing that is recorded could be checked.

    \b
    Examples:
      slamcheck audit run.trace
      slamcheck audit run.trace --verbose           every figure
      slamcheck audit float.trace --tolerance 1e-3  a filter in single precision
    """
    with guarded():
        chosen = chosen_output(**output)
        _check_trace(trace)
        from comparisons.atomic import check_replaceable, folder_name

        folder = out or Path(f"slamcheck-audit-{folder_name(trace.stem)}")
        check_replaceable(folder, "audit.json")
        from comparisons.checks.of_events import audit_trace

        with progress_bar(chosen) as progress:
            found = audit_trace(trace, tolerance, progress)
            progress("report", 0, 0)
            from comparisons.report.audit import AuditReport

            report = AuditReport.of(found)
            file = report.write(folder)
        print_result(report.summary(), file, chosen)
        raise SystemExit(VERDICTS[report.outcome])


def _check_trace(path: Path) -> None:
    """Raise InputError for an estimate, saying which command is for it."""
    if path.is_dir():
        from comparisons.estimates.planar_trace import TRACE

        found = next((path / one for one in (TRACE, f"ekf/{TRACE}") if (path / one).is_file()), "")
        meant = f"slamcheck audit {shlex.quote(str(found))}" if found else "it holds no " + TRACE
        raise InputError(
            f"{path}: a folder, not a regular file, expected a filter's trace; {meant}"
        )
    if path.suffix == ".tum":
        raise InputError(
            f"{path}: is a trajectory, expected a filter's trace; an estimate is checked by "
            f"slamcheck check LOG --estimate {shlex.quote(str(path))}"
        )


_TOLERANCE = typer.Option(
    metavar="SIGMAS",
    min=0.0,
    help="Largest difference of covariances and estimates that counts as rounding, in standard "
    "deviations.",
)
_OUT = typer.Option(metavar="DIR", help="Output folder. [slamcheck-audit-TRACE]")
set_parameters(
    audit,
    argument("trace", Path, "TRACE", "Trace of a filter, an SQLite file."),
    parameter("tolerance", Annotated[float, _TOLERANCE], 1e-6),
    parameter("out", Annotated[Path | None, _OUT], None),
    *OUTPUT.values(),
)
