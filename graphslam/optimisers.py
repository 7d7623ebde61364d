"""Nonlinear least squares by gtsam's optimisers, with what they leave to be done."""

from __future__ import annotations

from collections.abc import Callable

import gtsam

from graphslam.marginals import eliminate

SETTLED = 1e-9
"""A step that promises less than this is the last: no unknown is 5e-5 sigma from its place."""
_MOST_POLISHING = 40
_LEAST_SHARE = 0.05
OPTIMISERS = ("levenberg-marquardt", "gauss-newton", "dogleg")


def optimise(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, name: str = OPTIMISERS[0]
) -> tuple[gtsam.Values, int, bool]:
    """Near the minimum, for `polish` to go on: the end, the iterations, whether it converged.

    Raises RuntimeError where the linear systems are indeterminate, ValueError for another name.
    """
    if name == "levenberg-marquardt":
        return levenberg_marquardt(graph, values, 1e-5)
    kinds = {
        "gauss-newton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
        "dogleg": (gtsam.DoglegOptimizer, gtsam.DoglegParams),
    }
    if name not in kinds:
        raise ValueError(f"optimiser is '{name}', expected one of {', '.join(OPTIMISERS)}")
    optimiser, parameters = kinds[name]
    return _run(optimiser, graph, values, parameters(), 1e-5, 100)


def levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    relative_tolerance: float,
    limit: int = 100,
) -> tuple[gtsam.Values, int, bool]:
    """The end, the iterations, and whether it converged. Raises RuntimeError as `optimise`."""
    parameters = gtsam.LevenbergMarquardtParams()
    kind = gtsam.LevenbergMarquardtOptimizer
    return _run(kind, graph, values, parameters, relative_tolerance, limit)


def _run(
    kind: Callable[..., gtsam.NonlinearOptimizer],
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    parameters: gtsam.NonlinearOptimizerParams,
    relative_tolerance: float,
    limit: int,
) -> tuple[gtsam.Values, int, bool]:
    """By Cholesky, and by the slower QR where that breaks down on an ill-conditioned problem."""
    parameters.setMaxIterations(limit)
    parameters.setRelativeErrorTol(relative_tolerance)
    parameters.setAbsoluteErrorTol(1e-9)
    optimiser = kind(graph, values, parameters)
    try:
        end = optimiser.optimize()
    except RuntimeError:
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        optimiser = kind(graph, values, parameters)
        end = optimiser.optimize()
    return end, optimiser.iterations(), optimiser.iterations() < limit


def polish(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[gtsam.Values, float, int]:
    """Gauss-Newton until a step promises next to nothing; the end, its error and the iterations.

    By Cholesky, and from where that fails by QR, which loses half as many digits but takes twice
    as long; from where that gains nothing by shorter steps, for residuals are large there.
    """
    error, exact, share, iterations = graph.error(values), False, 1.0, 0
    while share > _LEAST_SHARE and iterations < _MOST_POLISHING:
        iterations += 1
        linear = graph.linearize(values)
        try:
            step = eliminate(linear).optimize() if exact else linear.optimize()
            promised = linear.error(values.zeroVectors()) - linear.error(step)
            nearer = values.retract(step.scale(share))
            lower = graph.error(nearer)
        except RuntimeError:
            if exact:
                raise
            promised = lower = float("inf")
        if lower < error:
            values, error = nearer, lower
        elif exact:
            share *= 0.5
        else:
            exact = True
        if abs(promised) < SETTLED:
            break
    return values, error, iterations
