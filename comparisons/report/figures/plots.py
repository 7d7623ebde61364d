"""What scripts and reports draw alike: map, errors, NEES and the ladder of gaps of a result.

Each function draws on given axes, or on those of a new figure, and returns them; it computes
nothing.
"""

from __future__ import annotations

from functools import singledispatch
from typing import Literal

import numpy as np
from matplotlib.axes import Axes

from comparisons.arrays import Array
from comparisons.checks.pair_of_estimates import EstimateComparison
from comparisons.errors import InputError, quoted
from comparisons.estimates.estimate import Estimate
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.run import Comparison
from comparisons.logs.log import Log
from comparisons.pipeline.solve import Solution
from comparisons.report.figures.style import (
    draw_aside,
    draw_estimate,
    draw_landmarks,
    draw_reference,
    entitle,
    given_or_new,
    plot_trajectory,
)
from comparisons.report.job import report_of
from comparisons.report.ladder import LadderStep
from comparisons.report.marks import (
    DEPARTURE_COLOUR,
    EKF_COLOUR,
    SMOOTHER_COLOUR,
    TRUTH_COLOUR,
    Panel,
    ellipses,
)
from comparisons.report.panels import COMPONENTS, errors_and_nees
from comparisons.report.picture import draw_panel
from comparisons.words import DEPARTURE

_NOTHING = 1e-16
"""What a gap of nothing is drawn as."""
_STATES = {"passes": SMOOTHER_COLOUR, "fails": EKF_COLOUR, "not judged": "#999999"}


def plot_map(result: Comparison | ExternalCheck | Solution, axis: Axes | None = None) -> Axes:
    """Draw a result's map: trajectories, landmarks with 3-sigma ellipses, and truth where known.

    Args:
        result: Of `compare`, `check` or `solve`.
        axis: Axes to draw on; None for those of a new figure.

    Returns:
        The axes, with a legend, and a title that says what was found.
    """
    axis = given_or_new(axis)
    _draw_map(result, axis)
    return axis


def plot_errors(
    result: Comparison | ExternalCheck | EstimateComparison,
    component: Literal["east", "north", "heading"] = "east",
    axis: Axes | None = None,
) -> Axes:
    """Draw one component of the pose's error over time, with the 3-sigma band of its covariance.

    Args:
        result: Of `compare`, `check` or `compare_estimates`.
        component: `east` or `north` [m], or `heading` [deg].
        axis: Axes to draw on; None for those of a new figure.

    Returns:
        The axes. The error is against truth where the log has true poses; else against the
        smoother, with the band of P_filter - P_smoother where that is the difference's covariance.
        Of two estimates it is what they differ by.

    Raises:
        InputError: There is no such component, or neither truth nor a smoother to compare with.
    """
    if component not in COMPONENTS:
        raise InputError(
            f"component {quoted(component)} is unknown, expected {', '.join(COMPONENTS)}"
        )
    errors, _ = errors_and_nees(result)
    if not errors:
        raise InputError("the log has no true poses, and no smoother uses the same measurements")
    return _panel(axis, errors[list(COMPONENTS).index(component)])


def plot_nees(
    result: Comparison | ExternalCheck | EstimateComparison, axis: Axes | None = None
) -> Axes:
    """Draw the normalised estimation error squared (NEES) of the pose over time, with its band.

    Args:
        result: Of `compare`, `check` or `compare_estimates`.
        axis: Axes to draw on; None for those of a new figure.

    Returns:
        The axes. Where the log has no true poses, the squared difference from the smoother stands
        in, by P_filter - P_smoother. The band holds 95 % of a sound filter's single values.

    Raises:
        InputError: There is no covariance, or nothing to compare it with.
    """
    _, squared = errors_and_nees(result)
    if squared is None:
        raise InputError("no NEES: the log has no true poses, or the estimate has no covariances "
                         "that can be compared with the other's")  # fmt: skip
    return _panel(axis, squared)


def plot_ladder(result: Comparison | ExternalCheck, axis: Axes | None = None) -> Axes:
    """Draw the gaps between neighbouring estimates, from the filter down to the truth.

    Args:
        result: Of `compare` or `check`.
        axis: Axes to draw on; None for those of a new figure.

    Returns:
        The axes: a row for each gap, the first one on top; the difference of the means [sigma] as
        a disc, the relative difference of the covariances as a circle, the limit as a line.
        Green-blue passes, red fails, grey is not judged.
    """
    axis, steps = given_or_new(axis), report_of(result).summary().steps
    for row, step in enumerate(steps):
        _draw_step(axis, row, step)
    axis.set_xscale("log")
    axis.set_yticks(range(len(steps)), [f"{one.above}\nto {one.below}" for one in steps])
    axis.set_ylim(len(steps) - 0.5, -0.5)
    axis.tick_params(axis="y", labelsize=8)
    axis.set_xlabel("difference of the means [sigma] (disc), of the covariances (circle)")
    axis.grid(visible=True, axis="x", color="#eeeeee")
    return axis


def _draw_step(axis: Axes, row: int, step: LadderStep) -> None:
    colour = _STATES[step.state]
    if step.covariance is not None:
        x = max(step.covariance, _NOTHING)
        axis.plot(x, row, "o", color=colour, markerfacecolor="none", label=f"{step.gap} covariance")
    if step.sigma is not None:
        axis.plot(max(step.sigma, _NOTHING), row, "o", color=colour, label=f"{step.gap} mean")
    elif step.mean != "unknown":
        axis.annotate(f"{step.gap}: {step.mean}", (0.98, row), xycoords=("axes fraction", "data"),
                      ha="right", va="center", color=colour, fontsize=8)  # fmt: skip
    if step.deciding:
        axis.plot(
            [step.deciding] * 2, [row - 0.3, row + 0.3], "-", color=TRUTH_COLOUR, linewidth=1.0
        )


def _panel(axis: Axes | None, panel: Panel) -> Axes:
    axis = given_or_new(axis)
    draw_panel(axis, panel)
    axis.set_xlabel(panel.x_label)
    axis.legend(fontsize=7, loc="upper right")
    return axis


@singledispatch
def _draw_map(result: object, axis: Axes) -> None:
    raise TypeError(f"a {type(result).__name__} has no map")


@_draw_map.register
def _(result: Comparison, axis: Axes) -> None:
    a = result.agreement
    title = (
        f"{result.log.name}: EKF and smoother {result.verdict.headline}\n"
        f"gaps: algebra {a.algebra.sigma:.1e}, model {a.model.sigma:.1e}, "
        f"linearisation {a.linearisation.sigma:.2g} sigma; optimism {a.optimism:.3g}"
    )
    estimates = {"smoother": result.smoothed, "EKF": result.ekf.estimate}
    _draw_estimates(axis, result.log, result.known.dead_reckoned, estimates)
    for finding in result.findings.values():
        finding.draw(axis)
    entitle(axis, title)


@_draw_map.register
def _(result: Solution, axis: Axes) -> None:
    optimality = result.result.optimality
    title = (
        f"{result.log.name}: optimum {'verified' if optimality.verified else 'NOT verified'}, "
        f"chi2 {optimality.chi_square.chi2:.0f} for {optimality.chi_square.dof} degrees of freedom"
    )
    _draw_estimates(axis, result.log, result.dead_reckoned, {"smoother": result.estimate})
    entitle(axis, title)


@_draw_map.register
def _(result: ExternalCheck, axis: Axes) -> None:
    solution, given = result.solution, result.given
    title = f"{solution.log.name}: {result.outcome}, {result.grade.value or 'no grade'}"
    _draw_estimates(axis, solution.log, solution.dead_reckoned, {"smoother": solution.estimate})
    plot_trajectory(given, axis, style="--")
    if given.landmark is not None:
        spread = given.landmark_covariance
        if spread is None:
            spread = np.zeros((len(given.landmark), 2, 2))
        outline = ellipses(given.landmark, spread, 3.0)
        draw_landmarks(axis, given.landmark, outline, EKF_COLOUR, "o", "estimate landmarks")
    if result.departure is not None:
        east, north = result.departure.place
        axis.plot(east, north, "X", color=DEPARTURE_COLOUR, markersize=9, label=DEPARTURE)
    entitle(axis, title)


def _draw_estimates(
    axis: Axes, log: Log, dead_reckoned: Array, estimates: dict[str, Estimate]
) -> None:
    """Estimates by name, on top of what the log knows."""
    if log.truth.poses is not None:
        pose = log.truth.poses.pose
        axis.plot(pose[:, 0], pose[:, 1], color="#bbbbbb", linewidth=2.5, label="truth", zorder=0)
    if log.positions is not None:
        draw_reference(axis, log.positions.position_m, ".", "GPS")
    if log.truth.landmarks is not None:
        draw_reference(axis, log.truth.landmarks.position_m, "*", "true landmarks")
    for name, estimate in estimates.items():
        draw_estimate(axis, name, estimate)
    if log.truth.poses is not None:
        draw_aside(axis, dead_reckoned, "dead reckoning")
