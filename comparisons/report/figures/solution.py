"""The map of the smoother alone."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.pipeline.solve import Solution
from comparisons.report.figures.style import estimates_figure


def solution_figure(solution: Solution) -> Figure:
    """The smoother on top of what the log knows."""
    optimality = solution.result.optimality
    title = (
        f"{solution.log.name}: optimum {'verified' if optimality.verified else 'NOT verified'}, "
        f"chi2 {optimality.chi_square.chi2:.0f} for {optimality.chi_square.dof} degrees of freedom"
    )
    return estimates_figure(
        solution.log, solution.dead_reckoned, {"smoother": solution.estimate}, title
    )
