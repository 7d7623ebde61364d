"""`slamcheck solve`: the smoother alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from comparisons.cli.flags import Given, from_flags
from comparisons.cli.jobs import Job, do_job, start_job
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from comparisons.config import SolveConfig
    from comparisons.pipeline.prepare import Progress
    from comparisons.pipeline.solve import Solution


@from_flags(of_job("solve"), "--association --gps --smoother --robust --seed")
def solve(given: Given) -> None:
    """Run the smoother alone; write its estimate and its graph.

    Exit code 0: the optimum is verified; 3: it is not.

    \b
    Examples:
      slamcheck solve                               the bundled log
      slamcheck solve path/to/MRCLAM_Dataset6 --robot 3 --robust gnc
    """

    def work(progress: Progress) -> tuple[Job[SolveConfig], Solution]:
        from comparisons.config import SolveConfig

        job = start_job(given, SolveConfig)
        from comparisons.pipeline.solve import solve as solve_log

        return job, solve_log(job.log, job.config, progress)

    do_job(given, work)
