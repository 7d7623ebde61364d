"""What all models of result files have in common."""

from __future__ import annotations

import math
import platform
import re
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from pydantic import BaseModel, ConfigDict

from comparisons.innovations import SensorInnovations
from comparisons.words import Row

_FORMER = {
    "sighting": "measurement",
    "begun": "initialised",
    "retired": "deactivated",
    "surer": "overconfident",
    "closures": "loop_closures",
}
_PACKAGES = ("slamcheck", "gtsam", "numpy", "scipy", "kiss-icp", "open3d-cpu", "open3d")
"""Those that the results depend on."""
_WORDS = re.compile(rf"(?<![a-z])(?<!loop_)({'|'.join(_FORMER)})")


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def current(stored: Any) -> Any:
    """Return what a file holds, its names at any depth in today's words, not those of 0.1."""
    if isinstance(stored, dict):
        return {
            _WORDS.sub(lambda found: _FORMER[found[0]], name): current(value)
            for name, value in stored.items()
        }
    return [current(one) for one in stored] if isinstance(stored, list) else stored


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None


def package_versions() -> dict[str, str]:
    """Of Python and of what the results depend on."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


class NisResult(Model):
    """An average of normalised innovations squared, with its own 95 % band.

    Attributes:
        name: sensor or component.
        dof: degrees of freedom of a value.
        count: number of innovations.
        mean: average; `dof` is right.
        band: 95 % band of the average.
        reading: what the average says, in words.
    """

    name: str
    dof: int
    count: int
    mean: float
    band: tuple[float, float]
    reading: str


class WhitenessResult(Model):
    """Autocorrelation of one component's innovations.

    See comparisons.statistics.Whiteness.

    Attributes:
        component: component of the innovation.
        order: by time, or by landmark.
        autocorrelation: coefficients, by lag from 1.
        band: half widths of their bands, by lag.
        p_value: chance of such coefficients for white innovations.
        mean: average of the standardised innovations; 0 is right.
        mean_band: half width of its 95 % band.
    """

    component: str
    order: str
    autocorrelation: list[float]
    band: list[float]
    p_value: float
    mean: float
    mean_band: float


class InnovationResult(Model):
    """One sensor's innovations.

    See comparisons.innovations.

    Attributes:
        sensor: name of the sensor.
        nis: the sensor as a whole, then its components.
        whiteness: each component, by time and by landmark.
        unusable: innovations that could not be whitened.
    """

    sensor: str
    nis: list[NisResult]
    whiteness: list[WhitenessResult]
    unusable: int

    @classmethod
    def of(cls, s: SensorInnovations) -> InnovationResult:
        """Return a sensor's figures as they are stored."""
        return InnovationResult(
            sensor=s.sensor,
            nis=[NisResult(**{**vars(n), "reading": n.reading}) for n in s.nis],
            whiteness=[
                WhitenessResult(
                    component=w.component,
                    order=w.order,
                    autocorrelation=w.coefficient.tolist(),
                    band=w.band.tolist(),
                    p_value=w.p_value,
                    mean=w.mean,
                    mean_band=w.mean_band,
                )
                for w in s.whiteness
            ],
            unusable=s.unusable,
        )

    def nis_rows(self, group: str) -> list[Row]:
        """Return the averages of the sensor and its components, in a group of rows."""
        return [
            Row(
                group,
                f"NIS of {n.name}, mean (expected {n.dof})",
                f"{n.mean:.3g}",
                f"{n.band[0]:.3g} to {n.band[1]:.3g}",
                n.band[0] <= n.mean <= n.band[1],
            )
            for n in self.nis
        ]
