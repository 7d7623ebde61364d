"""The picture of consistency: errors with their bands, NEES and NIS over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comparisons.checks.innovations import SensorInnovations, Whiteness
from comparisons.checks.normalised import Array, mean_band
from comparisons.compare import Comparison
from comparisons.report.picture import blank
from comparisons.report.plots import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR

_COMPONENTS = (("east [m]", 1.0), ("north [m]", 1.0), ("heading [deg]", 180.0 / np.pi))
_MARKERS = ("o-", "o--", "s-", "s--", "^-", "v-")
_MARGINS = {
    "left": 0.07,
    "right": 0.99,
    "bottom": 0.07,
    "top": 0.94,
    "hspace": 0.28,
    "wspace": 0.18,
}
"""Fixed, for finding them takes longer than drawing."""
_LEAST_DRAWN = 1e-2
"""The lower end of squares, whose first ones rounding makes."""


def draw_error(axis: Axes, time_s: Array, error: Array, sigma: Array, label: str) -> None:
    """A component of the error (n,) with 3 sigmas (n,) on either side."""
    axis.fill_between(
        time_s, -3.0 * sigma, 3.0 * sigma, color=EKF_COLOUR, alpha=0.2, linewidth=0.0,
        label="3 sigma",
    )  # fmt: skip
    axis.plot(time_s, error, color=EKF_COLOUR, linewidth=0.8, label="difference")
    axis.axhline(0.0, color=TRUTH_COLOUR, linewidth=0.5)
    axis.set_ylabel(label)


def draw_squared(
    axis: Axes, time_s: Array, squared: Array, low: Array, high: Array, colour: str, label: str
) -> None:
    """Normalised squares (n,), each with its band, on a logarithmic scale."""
    axis.fill_between(
        time_s,
        low,
        high,
        color="#999999",
        alpha=0.25,
        linewidth=0.0,
        label="" if axis.has_data() else "95 % band",
    )
    axis.plot(time_s, squared, color=colour, linewidth=0.8, label=label)
    axis.set_yscale("log")
    axis.minorticks_off()


def consistency_figure(comparison: Comparison) -> Figure:
    """Left: the pose's error by truth, or by the smoother; right: NEES, NIS, whiteness."""
    c = comparison.consistency
    figure = blank(10.0, 6.5, fitted=False)
    axes = figure.subplots(3, 2, gridspec_kw=_MARGINS)
    told = _draw_poses(comparison, axes[:, 0], axes[0, 1])
    for sensor, colour in zip(c.sensors, (EKF_COLOUR, SCANS_COLOUR), strict=False):
        _draw_nis(axes[1, 1], sensor, colour)
    if c.sensors:
        draw_whiteness(axes[2, 1], [w for sensor in c.sensors for w in sensor.whiteness])
    for axis in axes[:2, 1]:
        if axis.has_data():
            axis.set_ylim(bottom=max(axis.get_ylim()[0], _LEAST_DRAWN))
    for axis in (*axes[:, 0], *axes[:2, 1]):
        axis.set_xlim(comparison.ekf.estimate.time_s[[0, -1]])
    for axis in (axes[0, 0], *axes[:, 1]):
        if axis.has_data():
            axis.legend(fontsize=7, loc="upper right")
    for axis in (axes[0, 0], axes[1, 0], axes[0, 1]):
        axis.tick_params(labelbottom=False)
    axes[2, 0].set_xlabel("time [s]")
    axes[1, 1].set_xlabel("time [s]")
    figure.suptitle(f"{comparison.log.name}: {told}", fontsize=10, parse_math=False)
    return figure


def _draw_poses(comparison: Comparison, errors: Array, normalised: Axes) -> str:
    """Errors by component, and their normalised squares; says whose error by what it is."""
    c = comparison.consistency
    normalised.set_ylabel("squared")
    if c.ekf is not None and c.ekf.poses is not None:
        p = c.ekf.poses
        for i, (label, unit) in enumerate(_COMPONENTS):
            draw_error(errors[i], p.time_s, unit * p.error[:, i], unit * p.sigma[:, i], label)
        nees = p.pose
        low, high = np.broadcast_to(np.array(nees.single_band)[:, None], (2, len(nees.row)))
        time_s = p.time_s[nees.row]
        draw_squared(normalised, time_s, nees.squared, low, high, EKF_COLOUR, "EKF, pose (3 dof)")
        if c.smoother is not None and c.smoother.poses is not None:
            other = c.smoother.poses
            normalised.plot(
                other.time_s[other.pose.row], other.pose.squared, color=SMOOTHER_COLOUR,
                linewidth=0.8, label="smoother",
            )  # fmt: skip
        normalised.set_ylabel("NEES")
        return "the EKF's pose against truth"
    f = c.smoothed
    if f is None:
        return "no truth, and no smoother on the same data"
    for i, (label, unit) in enumerate(_COMPONENTS):
        draw_error(errors[i], f.time_s, unit * f.error[:, i], unit * f.sigma[:, i], label)
    if (clear := np.flatnonzero(f.dof > 0)).size:
        low, high = np.array([mean_band(1, dof) for dof in range(4)])[f.dof[clear]].T
        time_s, squared = f.time_s[clear], f.squared[clear]
        draw_squared(normalised, time_s, squared, low, high, EKF_COLOUR, "EKF - smoother")
    return "the EKF's pose against the smoother's, 3 sigma of P_EKF - P_smoother"


def _draw_nis(axis: Axes, sensor: SensorInnovations, colour: str) -> None:
    w = sensor.windows
    draw_squared(axis, w.time_s, w.mean, w.low, w.high, colour, f"{sensor.sensor}, averaged")
    axis.axhline(2.0, color=TRUTH_COLOUR, linewidth=0.5)
    axis.set_ylabel("NIS (2 dof)")


def draw_whiteness(axis: Axes, series: Sequence[Whiteness]) -> None:
    """Autocorrelations by lag, with the widest of their 95 % bands."""
    for one, marker in zip(series, _MARKERS, strict=False):
        lag = np.arange(1, len(one.coefficient) + 1)
        label = f"{one.component}, by {one.order}"
        axis.plot(lag, one.coefficient, marker, markersize=3, linewidth=0.8, label=label)
    if series:
        widest = max(float(one.band.max()) for one in series)
        axis.axhspan(-widest, widest, color="#999999", alpha=0.25, linewidth=0.0)
    axis.set_xlabel("lag")
    axis.set_ylabel("autocorrelation")
