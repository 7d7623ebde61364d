"""Nonlinear least squares by gtsam's optimisers, with what they leave to be done."""

from __future__ import annotations

from collections.abc import Callable

import gtsam

from graphslam.marginals import eliminate

SETTLED = 1e-6
"""A step that promises less is the last; it moves no unknown by more than 1.5e-3 sigma."""
_MOST_POLISHING = 20
_LEAST = 1e-9
"""An iteration that lowers the error by less is the last, whatever the error."""
OPTIMISERS = ("levenberg-marquardt", "gauss-newton", "dogleg")


def optimise(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, name: str = OPTIMISERS[0]
) -> tuple[gtsam.Values, int, bool]:
    """Near the minimum, for `polish` to go on: the end, the iterations, whether it converged.

    name: of OPTIMISERS. Raises RuntimeError where the linear systems are indeterminate.
    """
    if name == "levenberg-marquardt":
        return levenberg_marquardt(graph, values, 1e-5)
    kinds = {
        "gauss-newton": (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams),
        "dogleg": (gtsam.DoglegOptimizer, gtsam.DoglegParams),
    }
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
    parameters.setRelativeErrorTol(relative_tolerance)
    optimiser = kind(graph, values, parameters)
    try:
        iterations = _descend(optimiser, relative_tolerance, limit)
    except RuntimeError:
        parameters.setLinearSolverType("MULTIFRONTAL_QR")
        optimiser = kind(graph, values, parameters)
        iterations = _descend(optimiser, relative_tolerance, limit)
    return optimiser.values(), iterations, iterations < limit


def _descend(optimiser: gtsam.NonlinearOptimizer, relative_tolerance: float, limit: int) -> int:
    """Iterate until the error falls by next to nothing; the iterations.

    gtsam's own count leaves a last step out that it does not take, and whether it takes that is
    rounding.
    """
    error = optimiser.error()
    for iteration in range(1, limit + 1):
        optimiser.iterate()
        before, error = error, optimiser.error()
        if not before - error > max(_LEAST, relative_tolerance * before):
            return iteration
    return limit


def polish(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[gtsam.Values, float, int]:
    """Gauss-Newton until a step promises next to nothing; the end, its error and the iterations.

    Where it does not get there, for residuals are large, Levenberg-Marquardt goes on to its end.
    """
    values, error, promised, spent = _gauss_newton(graph, values)
    if promised < SETTLED:
        return values, error, spent
    values, more, _ = levenberg_marquardt(graph, values, 1e-14)
    values, error, _, last = _gauss_newton(graph, values)
    return values, error, spent + more + last


def _gauss_newton(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> tuple[gtsam.Values, float, float, int]:
    """The end, its error, what another step promises to take off it, and the iterations.

    By Cholesky, and from where that fails by QR, which loses half as many digits but takes twice
    as long. A step that turns a large map as a whole goes along the tangent of that turn, and the
    error grows; the step after it leads back to the circle, below where both began.
    Whether the last step lowers the error is rounding, so that it is not asked.
    """
    error, exact, promised, iterations = graph.error(values), False, float("inf"), 0
    while iterations < _MOST_POLISHING and promised >= SETTLED:
        iterations += 1
        try:
            nearer, lower, promised = _step(graph, values, exact)
            if promised < SETTLED and lower < error + SETTLED:
                return nearer, lower, promised, iterations
            if lower > error + promised:
                nearer, lower, _ = _step(graph, nearer, exact)
                iterations += 1
        except RuntimeError:
            if exact:
                raise
            lower = float("inf")
        if lower < error:
            values, error = nearer, lower
        elif exact:
            break
        else:
            exact, promised = True, max(promised, SETTLED)
    return values, error, promised, iterations


def _step(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, exact: bool
) -> tuple[gtsam.Values, float, float]:
    """The values a Gauss-Newton step further, their error, and what the step promised."""
    linear = graph.linearize(values)
    step = eliminate(linear).optimize() if exact else linear.optimize()
    nearer = values.retract(step)
    return nearer, graph.error(nearer), -0.5 * linear.gradientAtZero().dot(step)
