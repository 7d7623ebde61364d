"""The map of the smoother alone."""

from __future__ import annotations

from matplotlib.figure import Figure

from comparisons.pipeline.solve import Solution
from comparisons.report.figures.style import estimates_figure


def solution_figure(solution: Solution) -> Figure:
    """The smoother on top of what the log knows."""
    proof = solution.result.proof
    title = (
        f"{solution.log.name}: optimum {'proven' if proof.proven else 'NOT proven'}, "
        f"chi2 {proof.chi_square.chi2:.0f} for {proof.chi_square.dof} degrees of freedom"
    )
    return estimates_figure(
        solution.log, solution.dead_reckoned, {"smoother": solution.estimate}, title
    )
