"""The map of an external estimate and the smoother's."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from comparisons.pipeline.check import ExternalCheck
from comparisons.report.figures.style import draw_landmarks, draw_trajectory, estimates_figure
from comparisons.report.marks import DEPARTURE, DEPARTURE_COLOUR, EKF_COLOUR, ellipses


def check_figure(check: ExternalCheck) -> Figure:
    """An estimate from elsewhere on top of the smoother's."""
    solution, given = check.solution, check.given
    title = f"{solution.log.name}: {check.outcome}, {check.grade.value or 'no grade'}"
    estimates = {"smoother": solution.estimate}
    figure = estimates_figure(solution.log, solution.dead_reckoned, estimates, title)
    axis = figure.axes[0]
    draw_trajectory(axis, given.pose[:, :2], EKF_COLOUR, "estimate trajectory", "--")
    if given.landmark is not None:
        spread = given.landmark_covariance
        if spread is None:
            spread = np.zeros((len(given.landmark), 2, 2))
        outline = ellipses(given.landmark, spread, 3.0)
        draw_landmarks(axis, given.landmark, outline, EKF_COLOUR, "o", "estimate landmarks")
    if check.departure is not None:
        east, north = check.departure.place
        axis.plot(east, north, "X", color=DEPARTURE_COLOUR, markersize=9, label=DEPARTURE)
    axis.legend(loc="best", fontsize=8)
    return figure
