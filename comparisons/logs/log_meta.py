"""`log.toml`: what a log folder says about its streams. Unknown keys are errors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from comparisons.errors import InputError, printable, shorten
from comparisons.logs.log import Log
from comparisons.logs.odometry import Ackermann, OdometryNoise
from comparisons.logs.scans import Mount
from comparisons.logs.table import read_toml

MARK = "log.toml"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    def record_settings(self) -> dict[str, Any]:
        """What a stream's section says, as arguments of its record."""
        return self.model_dump()


_Three = tuple[float, float, float]


class _PriorModel(_Model):
    time_s: float
    pose: _Three
    covariance: tuple[_Three, _Three, _Three]


class _VehicleModel(_Model):
    wheelbase_m: float
    encoder_offset_m: float = Ackermann.encoder_offset_m
    sensor_forward_m: float = Ackermann.sensor_forward_m
    sensor_left_m: float = Ackermann.sensor_left_m


class _NoiseModel(_Model):
    sigma_speed_mps: float
    sigma_turn: float
    variance_rate_position: float = OdometryNoise.variance_rate_position
    variance_rate_heading: float = OdometryNoise.variance_rate_heading

    def record(self) -> OdometryNoise:
        """The same, checked."""
        return OdometryNoise(**self.model_dump())


class SteeringModel(_Model):
    """Odometry of speed and steering."""

    kind: Literal["steering"]
    vehicle: _VehicleModel
    noise: _NoiseModel

    def record_settings(self) -> dict[str, Any]:
        """Kind, vehicle and noise."""
        vehicle = Ackermann(**self.vehicle.model_dump())
        return {"kind": self.kind, "vehicle": vehicle, "noise": self.noise.record()}


class VelocityModel(_Model):
    """Odometry of speed and yaw rate."""

    kind: Literal["velocity"]
    noise: _NoiseModel

    def record_settings(self) -> dict[str, Any]:
        """Kind and noise."""
        return {"kind": self.kind, "noise": self.noise.record()}


class RelativeModel(_Model):
    """Odometry of displacements, each with its covariance."""

    kind: Literal["relative-poses"]


class MeasurementsModel(_Model):
    """What holds for all measurements."""

    label_gate: float = float("inf")
    needs_confirmation: bool = False


class PositionsModel(_Model):
    """Where the antenna is: forward and left of the pose."""

    antenna_m: tuple[float, float] = (0.0, 0.0)


class ScansModel(_Model):
    """Where the scanner sits, and the time from one beam to the next."""

    forward_m: float = Mount.forward_m
    left_m: float = Mount.left_m
    heading_rad: float = Mount.heading_rad
    beam_s: float = 0.0

    def record_settings(self) -> dict[str, Any]:
        """Mount and beam_s."""
        mount = Mount(self.forward_m, self.left_m, self.heading_rad)
        return {"mount": mount, "beam_s": self.beam_s}


class LogModel(_Model):
    """The whole file."""

    version: Literal[1]
    name: str
    source: str = "log-folder"
    units: str = ""
    prior: _PriorModel
    odometry: Annotated[SteeringModel | VelocityModel | RelativeModel, Field(discriminator="kind")]
    measurements: MeasurementsModel = MeasurementsModel()
    positions: PositionsModel = PositionsModel()
    scans: ScansModel = ScansModel()
    provenance: dict[str, str] = {}

    def settings(self, stream: str) -> dict[str, Any]:
        """Return what the file says of a stream: arguments of its record, `kind` of odometry."""
        section = getattr(self, stream, None)
        return {} if section is None else section.record_settings()


def read_meta(path: Path) -> LogModel:
    """Read and check `log.toml`. Raises InputError naming the key at fault."""
    try:
        return LogModel.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from None


def first_fault(error: ValidationError) -> str:
    """The first key at fault and what is wrong with it, in one line."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    return f"{shorten(key, 100)}: {shorten(first['msg'].lower(), 200)}"


def meta_text(log: Log, remarks: Mapping[str, str] | None = None) -> str:
    """The TOML; its strings and numbers are spelt as JSON, which TOML shares.

    remarks: comments behind the lines of some keys.
    """
    prior, odometry = log.prior, log.odometry
    lines = [
        "version = 1",
        f"name = {toml_text(log.name)}",
        f"source = {toml_text(log.format)}",
        'units = "SI, radians; bearings counter-clockwise from straight ahead"',
        "",
        "[prior]",
        f"time_s = {float(prior.time_s)!r}",
        f"pose = {prior.pose.tolist()}",
        f"covariance = {prior.covariance.tolist()}",
        "",
        "[odometry]",
    ]
    lines.append(f'kind = "{odometry.table.kind}"')
    groups = [name for name in ("noise", "vehicle") if hasattr(odometry, name)]
    for group in groups:
        lines += ["", f"[odometry.{group}]"]
        record = vars(getattr(odometry, group))
        lines += [f"{name} = {float(value)!r}" for name, value in record.items()]
    lines += ["", "[measurements]", f"label_gate = {log.measurements.label_gate!r}"]
    lines += [f"needs_confirmation = {json.dumps(log.measurements.needs_confirmation)}"]
    if log.positions is not None:
        lines += ["", "[positions]", f"antenna_m = {list(log.positions.antenna_m)}"]
    if log.scans is not None:
        settings = {**vars(log.scans.mount), "beam_s": log.scans.beam_s}
        lines += ["", "[scans]"]
        lines += [f"{name} = {float(value)!r}" for name, value in settings.items()]
    lines += ["", "[provenance]"]
    for key, words in (remarks or {}).items():
        lines = [
            f"{line}  # {printable(words)}" if line.startswith(f"{key} = ") else line
            for line in lines
        ]
    lines += [f"{toml_text(k)} = {toml_text(v)}" for k, v in log.provenance.items()]
    return "\n".join(lines) + "\n"


def toml_text(value: str) -> str:
    """Return a TOML string: JSON's spelling, which TOML shares for printable text."""
    return json.dumps(value, ensure_ascii=False)
