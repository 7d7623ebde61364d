"""Colours of estimates, outlines of ellipses, and panels of curves, for figures and pages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array
from comparisons.innovations import SensorInnovations

EKF_COLOUR = "#d1495b"
SMOOTHER_COLOUR = "#00798c"
TRUTH_COLOUR = "#444444"
SCANS_COLOUR = "#edae49"
TIME, EVENT = "time [s]", "event"
"""Axes that all curves over them share."""
MOST_POINTS, DIGITS = 2000, 4
"""Of a curve on a page, and of its figures."""
DEPARTURE_COLOUR = "#7b4fa3"


def ellipses(centre: Array, covariance: Array, sigmas: float, points: int = 48) -> Array:
    """Outlines (L, points, 2) of the error ellipses of centres (L, 2), covariances (L, 2, 2).

    A covariance that is not finite, as a broken filter leaves it, is drawn as a point.
    """
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    covariance = np.where(finite, covariance, 0.0)
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, points)
    circle = np.column_stack((np.cos(angle), np.sin(angle)))
    scaled = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    result: Array = centre[:, None] + sigmas * circle @ scaled.transpose(0, 2, 1)
    return result


@dataclass(frozen=True)
class Curve:
    """A line through points x, y: (n,)."""

    name: str
    colour: str
    x: Array
    y: Array


@dataclass(frozen=True, kw_only=True)
class FilledBand:
    """What lies between low and high at x: (n,) each.

    lack: why it has a gap where it has one. about: name of the curve that it lies evenly about.
    """

    name: str
    colour: str
    x: Array
    low: Array
    high: Array
    lack: str = ""
    about: str = ""

    @property
    def gap(self) -> str:
        """Return in words where there is no band, and why; nothing where it is whole."""
        whole = np.isfinite(self.low) & np.isfinite(self.high)
        missing = int(np.count_nonzero(~whole))
        if not missing:
            return ""
        because = f": {self.lack}" if self.lack else ""
        return f"no {self.name} at {missing:,} of {len(self.x):,} instants{because}"


@dataclass(frozen=True)
class Moment:
    """Where something happens on the axis that curves run along."""

    name: str
    colour: str
    x: float


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves over one axis. logarithmic: of the values. level: what is right, if one value is.

    moments: what is marked across all curves. lacks: bands that are not there, and why. points,
    digits: at most so many of a curve on the page, and of a figure.
    """

    title: str
    x_label: str
    curves: tuple[Curve, ...]
    bands: tuple[FilledBand, ...]
    logarithmic: bool = False
    level: float | None = None
    moments: tuple[Moment, ...] = ()
    lacks: tuple[str, ...] = ()
    points: int = MOST_POINTS
    digits: int = DIGITS

    @property
    def timed(self) -> bool:
        """Whether it stands over the axis that all such panels share."""
        return self.x_label in (TIME, EVENT)

    @property
    def lacking(self) -> list[str]:
        """Return in words what is not drawn of bands, wholly or in part."""
        return [*self.lacks, *(band.gap for band in self.bands if band.gap)]


def nis_panel(sensor: SensorInnovations, colour: str, at: Array, x_label: str) -> Panel:
    """Return the averages over stretches of a run. at: (n,) where each is drawn."""
    w, dof = sensor.windows, sensor.nis[0].dof
    return Panel(
        title=f"NIS of {sensor.sensor} ({dof} dof)",
        x_label=x_label,
        curves=(Curve(f"{sensor.sensor}, averaged", colour, at, w.mean),),
        bands=(FilledBand(name="95 % band", colour="#999999", x=at, low=w.low, high=w.high),),
        logarithmic=True,
        level=float(dof),
    )
