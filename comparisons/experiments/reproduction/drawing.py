"""What the reproduced figures have in common to look at. Computes nothing."""

from __future__ import annotations

from matplotlib.axes import Axes

from comparisons.arrays import Array
from comparisons.report.figures.style import draw_landmarks, draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses

TRUE_PATH_COLOUR = "#bbbbbb"
SIGMAS = 3.0


def plan(axis: Axes, title: str) -> None:
    """A map's labels, with a title."""
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=10)
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.grid(visible=True, color="#eeeeee")


def chart(axis: Axes, title: str, x: str, y: str, *, legend: bool = True) -> None:
    """A curve's labels."""
    axis.set_title(title, fontsize=10)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(visible=True, color="#eeeeee")
    if legend:
        axis.legend(fontsize=8, loc="best")


def draw_slam(
    axis: Axes, true_path: Array, path: Array, true: Array, landmark: Array, blocks: Array
) -> None:
    """Paths (T, 2) and landmarks (L, 2) with 3-sigma ellipses of covariances (L, 2, 2)."""
    draw_trajectory(axis, true_path, TRUE_PATH_COLOUR, "true path")
    draw_reference(axis, true, "*", "true landmarks")
    draw_trajectory(axis, path, EKF_COLOUR, "estimated path", "--")
    outline = ellipses(landmark, blocks, SIGMAS)
    draw_landmarks(axis, landmark, outline, EKF_COLOUR, "o", "estimates, 3 sigma")


def draw_error(axis: Axes, time_s: Array, error: Array, sigma: Array) -> None:
    """An error (T,) between its one-sigma bounds, in a unit of its own."""
    axis.plot(time_s, error, "-", color=EKF_COLOUR, linewidth=0.9, label="error")
    for sign in (1.0, -1.0):
        label = "1 sigma" if sign > 0.0 else None
        axis.plot(time_s, sign * sigma, "--", color=SMOOTHER_COLOUR, linewidth=0.9, label=label)


def mark(axis: Axes, time_s: float, label: str) -> None:
    """An instant."""
    axis.axvline(time_s, color=TRUTH_COLOUR, linestyle=":", linewidth=0.9, label=label)
