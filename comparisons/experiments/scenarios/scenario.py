"""Scenario files: what a Monte Carlo study simulates. Unknown keys are errors."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from comparisons.config import SettingsGroup
from comparisons.errors import InputError, naming, shorten
from comparisons.logs.table import read_toml

_FOLDER = Path(__file__).parent
_Positive = Annotated[float, Field(ge=1e-9, le=1e9)]
_NotNegative = Annotated[float, Field(ge=0, le=1e9)]
_Finite = Annotated[float, Field(ge=-1e9, le=1e9)]
_Every = Annotated[int, Field(ge=1, le=1_000_000)]
_Point = tuple[_Finite, _Finite]


class Circle(SettingsGroup):
    """Constant speed and yaw rate, from the origin eastwards."""

    kind: Literal["circle"]
    speed_mps: _Positive
    yaw_rate_radps: _Finite


class Waypoints(SettingsGroup):
    """Round a closed polygon by pure pursuit, from its first point."""

    kind: Literal["waypoints"]
    speed_mps: _Positive
    lookahead_m: _Positive
    points: Annotated[list[_Point], Field(min_length=3)]


class EnvironmentCourse(SettingsGroup):
    """The path of an environment of comparisons.logs.simulate.worlds, by pure pursuit."""

    kind: Literal["nieto-loop"]
    speed_mps: _Positive
    lookahead_m: _Positive


class Ring(SettingsGroup):
    """Landmarks on circles about a centre, evenly spaced, going through the radii in turn."""

    kind: Literal["ring"]
    centre: _Point
    radii_m: Annotated[list[_Positive], Field(min_length=1)]
    count: Annotated[int, Field(ge=1, le=1000)]


class PointLandmarks(SettingsGroup):
    """Landmarks one by one."""

    kind: Literal["points"]
    points: Annotated[list[_Point], Field(min_length=1)]


class EnvironmentLandmarks(SettingsGroup):
    """The landmarks of an environment."""

    kind: Literal["nieto-loop"]


class WhiteOdometryNoise(SettingsGroup):
    """White noise of every step's speed and yaw rate."""

    sigma_speed_mps: _Positive
    sigma_yaw_rate_radps: _Positive


class RelativePositionSensor(SettingsGroup):
    """Position in the robot's frame; each axis has sigma_m + sigma_share * distance."""

    kind: Literal["relative-position"]
    sigma_m: _NotNegative = 0.0
    sigma_share: _NotNegative = 0.0
    max_range_m: _Positive
    field_of_view_rad: _Positive = 6.284
    every: _Every = 1

    @model_validator(mode="after")
    def _noisy(self) -> Self:
        if self.sigma_m + self.sigma_share <= 0:
            raise ValueError("sensor: sigma_m and sigma_share are both 0, expected noise")
        return self


class RangeBearingSensor(SettingsGroup):
    """Range and bearing; the range has sigma_range_m + sigma_range_share * distance."""

    kind: Literal["range-bearing"]
    sigma_range_m: _NotNegative = 0.0
    sigma_range_share: _NotNegative = 0.0
    sigma_bearing_rad: _Positive
    max_range_m: _Positive
    field_of_view_rad: _Positive = 6.284
    every: _Every = 1

    @model_validator(mode="after")
    def _noisy(self) -> Self:
        if self.sigma_range_m + self.sigma_range_share <= 0:
            raise ValueError(
                "sensor: sigma_range_m and sigma_range_share are both 0, expected noise"
            )
        return self


class Scenario(SettingsGroup):
    """One scenario. from_paper, ours: which of the figures are taken from where, in words."""

    description: str
    from_paper: list[str]
    ours: list[str]
    steps: Annotated[int, Field(ge=1, le=1_000_000)]
    step_s: _Positive
    sigma_start_m: _Positive
    sigma_start_rad: _Positive
    course: Annotated[Circle | Waypoints | EnvironmentCourse, Field(discriminator="kind")]
    landmarks: Annotated[Ring | PointLandmarks | EnvironmentLandmarks, Field(discriminator="kind")]
    odometry: WhiteOdometryNoise
    sensor: Annotated[RelativePositionSensor | RangeBearingSensor, Field(discriminator="kind")]

    @property
    def figures(self) -> str:
        """All that decides a study, which the words do not."""
        return self.model_dump_json(exclude={"description", "from_paper", "ours"})

    @property
    def sha256(self) -> str:
        """Of the figures."""
        return hashlib.sha256(self.figures.encode()).hexdigest()


def bundled_scenarios() -> list[str]:
    """Names of the scenarios that come with slamcheck."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def read_scenario(name: str) -> Scenario:
    """A scenario by bundled name, unless a file of that name exists, or by path.

    Raises InputError.
    """
    path = Path(name)
    if not path.is_file():
        if name not in bundled_scenarios():
            raise InputError(
                f"scenario '{shorten(name, 200)}' is neither a file nor one of "
                f"{', '.join(bundled_scenarios())}"
            )
        path = _FOLDER / f"{name}.toml"
    found = read_toml(path)
    with naming(name):
        return Scenario.of(**found)
