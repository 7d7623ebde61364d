"""What is drawn of consistency: errors with their bands, NEES, NIS and whiteness.

The picture and the page draw these panels, each in its way; nothing is computed by either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.consistency.innovations import SensorInnovations
from comparisons.checks.consistency.normalised import mean_band
from comparisons.pipeline.compare import Comparison
from comparisons.report.figures.style import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR

_COMPONENTS = (("east [m]", 1.0), ("north [m]", 1.0), ("heading [deg]", 180.0 / np.pi))
_COLOURS = (EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, "#5c6f2b")


@dataclass(frozen=True)
class Curve:
    """A line through points x, y: (n,)."""

    name: str
    colour: str
    x: Array
    y: Array


@dataclass(frozen=True)
class Band:
    """What lies between low and high at x: (n,) each."""

    name: str
    colour: str
    x: Array
    low: Array
    high: Array


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves over one axis. logarithmic: of the values. level: what is right, if one value is."""

    title: str
    x_label: str
    curves: tuple[Curve, ...]
    bands: tuple[Band, ...]
    logarithmic: bool = False
    level: float | None = None


@dataclass(frozen=True)
class ConsistencyPanels:
    """errors: east, north, heading. squared: NEES. nis: by sensor. told: whose error, by what."""

    told: str
    errors: tuple[Panel, ...]
    squared: Panel | None
    nis: tuple[Panel, ...]
    whiteness: Panel | None


def consistency_panels(comparison: Comparison) -> ConsistencyPanels:
    """The pose's error by truth, or else by the smoother, and the filter's innovations."""
    c = comparison.consistency
    told, errors, squared = _poses(comparison)
    nis = tuple(_nis(s, colour) for s, colour in zip(c.sensors, _COLOURS, strict=False))
    return ConsistencyPanels(told, errors, squared, nis, _whiteness(c.sensors))


def _poses(comparison: Comparison) -> tuple[str, tuple[Panel, ...], Panel | None]:
    c, f = comparison.consistency, comparison.consistency.smoothed
    if c.ekf is not None and (p := c.ekf.poses) is not None:
        nees = p.pose
        low, high = np.broadcast_to(np.array(nees.single_band)[:, None], (2, len(nees.row)))
        at = p.time_s[nees.row]
        curves = [Curve("EKF", EKF_COLOUR, at, nees.squared)]
        if c.smoother is not None and (q := c.smoother.poses) is not None:
            at_q = q.time_s[q.pose.row]
            curves.append(Curve("smoother", SMOOTHER_COLOUR, at_q, q.pose.squared))
        band = Band("95 % band", "#999999", at, low, high)
        squared = Panel(
            title="NEES of the pose (3 dof)",
            x_label="time [s]",
            curves=tuple(curves),
            bands=(band,),
            logarithmic=True,
        )
        told = "the EKF's pose against truth"
        return told, _errors(p.time_s, p.error, p.sigma, "EKF - truth"), squared
    if f is None:
        return "no truth, and no smoother on the same data", (), None
    told = "the EKF's pose against the smoother's, 3 sigma of P_EKF - P_smoother"
    clear, panel = np.flatnonzero(f.dof > 0), None
    if clear.size:
        low, high = np.array([mean_band(1, dof) for dof in range(4)])[f.dof[clear]].T
        at = f.time_s[clear]
        curve = Curve("EKF - smoother", EKF_COLOUR, at, f.squared[clear])
        band = Band("95 % band", "#999999", at, low, high)
        panel = Panel(
            title="pose's difference, squared",
            x_label="time [s]",
            curves=(curve,),
            bands=(band,),
            logarithmic=True,
        )
    return told, _errors(f.time_s, f.error, f.sigma, "EKF - smoother"), panel


def _errors(time_s: Array, error: Array, sigma: Array, name: str) -> tuple[Panel, ...]:
    """Of errors (n, 3) and sigmas (n, 3)."""
    panels = []
    for i, (label, unit) in enumerate(_COMPONENTS):
        spread = 3.0 * unit * sigma[:, i]
        curve = Curve(name, EKF_COLOUR, time_s, unit * error[:, i])
        band = Band("3 sigma", EKF_COLOUR, time_s, -spread, spread)
        panels.append(
            Panel(title=label, x_label="time [s]", curves=(curve,), bands=(band,), level=0.0)
        )
    return tuple(panels)


def _nis(sensor: SensorInnovations, colour: str) -> Panel:
    w, name = sensor.windows, f"{sensor.sensor}, averaged"
    return Panel(
        title=f"NIS of {sensor.sensor} (2 dof)",
        x_label="time [s]",
        curves=(Curve(name, colour, w.time_s, w.mean),),
        bands=(Band("95 % band", "#999999", w.time_s, w.low, w.high),),
        logarithmic=True,
        level=2.0,
    )


def _whiteness(sensors: tuple[SensorInnovations, ...]) -> Panel | None:
    """Autocorrelations by lag, with the widest of their 95 % bands."""
    series = [w for sensor in sensors for w in sensor.whiteness]
    if not series:
        return None
    curves = []
    for i, one in enumerate(series):
        lag = np.arange(1.0, len(one.coefficient) + 1.0)
        name = f"{one.component}, by {one.order}"
        curves.append(Curve(name, _COLOURS[i % len(_COLOURS)], lag, one.coefficient))
    lags = np.array((1.0, max(curve.x[-1] for curve in curves)))
    widest = np.full(2, max(float(one.band.max()) for one in series))
    band = Band("95 % band", "#999999", lags, -widest, widest)
    return Panel(
        title="autocorrelation of innovations, by lag",
        x_label="lag",
        curves=tuple(curves),
        bands=(band,),
        level=0.0,
    )
