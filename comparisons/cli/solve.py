"""`slamcheck solve`: the smoother alone."""

from __future__ import annotations

from comparisons.cli.flags import Arguments, from_flags
from comparisons.cli.jobs import do_plain_job
from comparisons.options.table import of_job


@from_flags(of_job("solve"), "--association --gps --smoother --robust --robot --seed")
def solve(given: Arguments) -> None:
    """Run the smoother alone; write its estimate and its graph.

    Exit code 0: the optimum is verified; 3: it is not.

    \b
    Examples:
      slamcheck solve                               the bundled log
      slamcheck solve path/to/MRCLAM_Dataset6 --robot 3 --robust gnc
    """
    do_plain_job(given, "SolveConfig", "comparisons.pipeline.solve:solve")
