"""`slamcheck solve`: the smoother alone."""

from __future__ import annotations

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import start_job
from comparisons.cli.support import VERDICTS, guarded, print_result, progress_bar
from comparisons.options.table import of_job


@from_flags(of_job("solve"), "--association --gps --smoother --robust --seed")
def solve(given: Given) -> None:
    """Run the smoother alone; write its estimate and its graph.

    Exit code 0: the optimum is verified; 3: it is not.

    \b
    Examples:
      slamcheck solve                               the bundled log
      slamcheck solve path/to/MRCLAM_Dataset6 --robot 3 --robust gnc
    """
    with guarded(log_file=given.log_file):
        with progress_bar(given.output) as progress:
            from comparisons.config import SolveConfig

            job = start_job(given, SolveConfig)
            from comparisons.pipeline.solve import solve as solve_log

            solution = solve_log(job.log, job.config, progress)
            progress("report", 0, 0)
            from comparisons.report.folder import write_job_folder
            from comparisons.report.solution import (
                build_solution_result,
                solution_folder,
                solution_summary,
            )

            result = build_solution_result(solution, job.read)
            write_job_folder(solution_folder(solution, result), job.folder)
        print_result(solution_summary(result), job.folder / "solution.json", given.output)
        raise SystemExit(VERDICTS[result.verdict])
