"""The records of a log: frozen, validated, SI units, east-north plane, bearings from the heading.

Arrays are float64 and read-only. Every stream is ordered by time. Equal times are allowed for
measurements (one scan) and for wheel odometry (the later sample holds). Validation raises
RecordError naming stream, row, value and expectation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError, printable, quoted
from comparisons.logs import schema
from comparisons.logs.odometry import Integration, Odometry, RelativePoses, poses_at
from comparisons.logs.records import LogRecord, Stream
from comparisons.logs.scans import Clouds, Scans
from comparisons.logs.schema import NO_LANDMARK as NO_LANDMARK
from comparisons.logs.validation import (
    LARGEST,
    LARGEST_ID,
    frozen,
    positive_definite,
)
from comparisons.shown import Brief, Shown, render

if TYPE_CHECKING:
    from pandas import DataFrame

Ids = NDArray[np.int64]
Columns = Mapping[str, Any]
"""Arrays (N,) by name; a single number holds for all rows."""


@dataclass(frozen=True, kw_only=True, repr=False)
class LandmarkMeasurements(Stream, Brief):
    """Range-bearing detections of landmarks, bearings counter-clockwise from straight ahead.

    time_s, range_m, bearing_rad, sigma_range_m, sigma_bearing_rad: (M,). landmark: (M,) ids, or
    NO_LANDMARK. diameter_m, intensity: (M,), NaN where unknown, as all are when left out; the
    latter in the sensor's own unit. label_gate: normalised innovation squared
    beyond which an id is taken for a misread; infinite where ids are certain.
    needs_confirmation: detections may be spurious, so that a new landmark wants several.
    """

    table = schema.MEASUREMENTS

    time_s: Array
    range_m: Array
    bearing_rad: Array
    sigma_range_m: Array
    sigma_bearing_rad: Array
    landmark: Ids
    diameter_m: Array = field(default_factory=lambda: np.zeros(0))
    label_gate: float = float("inf")
    needs_confirmation: bool = False
    intensity: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not self.label_gate > 0:
            raise InputError(
                f"measurements: label_gate is {quoted(self.label_gate)}, expected above 0"
            )
        super().__post_init__()

    @classmethod
    def of(
        cls,
        time_s: Array,
        z: Array,
        sigma: ArrayLike,
        landmark: ArrayLike = NO_LANDMARK,
        **more: Any,
    ) -> LandmarkMeasurements:
        """Return measurements z (M, 2), range and bearing, with sigmas (M, 2), or (2,) of all.

        landmark: (M,) ids, or one of all. more: the other fields.
        """
        sigma_range_m, sigma_bearing_rad = np.broadcast_to(np.asarray(sigma, float), z.shape).T
        return cls(
            time_s=time_s,
            range_m=z[:, 0],
            bearing_rad=z[:, 1],
            sigma_range_m=sigma_range_m,
            sigma_bearing_rad=sigma_bearing_rad,
            landmark=np.broadcast_to(landmark, len(z)),
            **more,
        )

    @property
    def labelled(self) -> bool:
        """Every measurement names its landmark."""
        return bool((self.landmark != NO_LANDMARK).all())

    @property
    def labels_in_order(self) -> Ids:
        """(L,) ids by first measurement, the order in which a filter that trusts them adds them."""
        labels, first = np.unique(self.landmark, return_index=True)
        return labels[np.argsort(first)]


@dataclass(frozen=True, repr=False)
class Positions(Stream, Brief):
    """Absolute positions, such as GPS.

    time_s: (N,). position_m: (N, 2) of the antenna. covariance: (N, 2, 2). antenna_m: where the
    antenna is, forward and left of the pose that the log estimates.
    """

    table = schema.POSITIONS

    time_s: Array
    position_m: Array
    covariance: Array
    antenna_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        antenna = tuple(float(value) for value in self.antenna_m)
        if len(antenna) != 2 or not np.isfinite(antenna).all():
            raise InputError(
                f"positions: antenna_m is {quoted(self.antenna_m)}, expected two numbers"
            )
        object.__setattr__(self, "antenna_m", antenna)
        super().__post_init__()

    def with_sigma(self, sigma_m: float) -> Positions:
        """The same positions, each with one sigma [m] on both axes."""
        return replace(self, covariance=np.tile(sigma_m**2 * np.eye(2), (len(self.time_s), 1, 1)))


@dataclass(frozen=True)
class LoopClosures(Stream):
    """Measured motions between poses that do not follow each other, such as closed loops.

    from_s, to_s: (N,) times of the poses. displacement: (N, 3) dx, dy [m], dheading [rad] of the
    second in the first's frame. covariance: (N, 3, 3) in the second's frame, as RelativePoses.
    """

    table = schema.CLOSURES

    from_s: Array
    to_s: Array
    displacement: Array
    covariance: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        same = np.flatnonzero(self.from_s == self.to_s)
        if len(same):
            raise RecordError(
                "loop closures", int(same[0]), f"from {self.from_s[same[0]]} s to the same pose"
            )

    @property
    def time_s(self) -> Array:
        """(N,) of the later pose of each."""
        return np.maximum(self.from_s, self.to_s)


@dataclass(frozen=True)
class Landmarks(LogRecord):
    """A map. id: (L,), unique. position_m: (L, 2). covariance: (L, 2, 2), zero for exact."""

    table = schema.LANDMARKS

    id: Ids
    position_m: Array
    covariance: Array

    def places_of(self, ids: Ids) -> Array:
        """(K, 2) positions of landmarks by their ids (K,), all of which are in the map."""
        order = np.argsort(self.id)
        return self.position_m[order[np.searchsorted(self.id, ids, sorter=order)]]


@dataclass(frozen=True, repr=False)
class Poses(LogRecord, Brief):
    """A trajectory. time_s: (N,). pose: (N, 3) x, y [m], heading [rad]."""

    table = schema.POSES

    time_s: Array
    pose: Array

    def at(self, time_s: Array) -> Array:
        """(N, 3) poses at times (N,), between the records by interpolation, headings unwrapped."""
        return poses_at(time_s, self.time_s, self.pose)


@dataclass(frozen=True)
class Surfaces(LogRecord):
    """Walls and outlines as segments. segment: (S, 4) x1, y1, x2, y2 [m]."""

    table = schema.SURFACES

    segment: Array


@dataclass(frozen=True, repr=False)
class Truth(Brief):
    """What is known independently of the estimators' sensors."""

    poses: Poses | None = None
    landmarks: Landmarks | None = None
    surfaces: Surfaces | None = None


@dataclass(frozen=True, repr=False)
class Prior(Brief):
    """Where the vehicle starts. pose: (3,). covariance: (3, 3) of the additive global error.

    open: the covariance says nothing, so that absolute positions must fix the frame.
    """

    time_s: float
    pose: Array
    covariance: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_s", float(self.time_s))
        if not abs(self.time_s) <= LARGEST:
            raise InputError(
                f"prior: time_s is {quoted(self.time_s)}, expected at most {LARGEST:g}"
            )
        for name, shape in (("pose", (3,)), ("covariance", (3, 3))):
            value = frozen(getattr(self, name))
            object.__setattr__(self, name, value)
            if value.shape != shape or not (np.abs(value) <= LARGEST).all():
                raise InputError(
                    f"prior: {name} must hold {shape} finite numbers, at most {LARGEST:g}"
                )
        positive_definite("prior", self.covariance[None])

    @property
    def open(self) -> bool:
        """Not even where in a whole turn the vehicle heads is known."""
        return bool(self.covariance[2, 2] > (2.0 * np.pi) ** 2)


@dataclass(frozen=True, kw_only=True)
class Log(Shown):
    """Hold one drive: its streams, its prior, and where they come from.

    Arrays are read-only. Times are in seconds, angles in radians, headings counter-clockwise from
    east, bearings counter-clockwise from straight ahead.

    Attributes:
        name: For reports.
        format: The reader's name.
        prior: Where the vehicle starts.
        odometry: Wheels, or relative poses; may be empty only where there are scans.
        measurements: Range-bearing measurements of landmarks; may be empty only where there are
            scans or closures.
        positions: Absolute positions, such as GPS.
        loop_closures: Measured motions between poses that do not follow each other.
        known_landmarks: Landmarks surveyed beforehand.
        known_measurements: Measurements that refer to the ids of these.
        scans: Planar laser scans.
        clouds: Spatial point clouds.
        integration: How wheel odometry is integrated, where not as the documents do.
        truth: What is known independently of the sensors; no estimator is given it.
        provenance: Free text by key, for reports.
    """

    name: str
    format: str
    prior: Prior
    odometry: Odometry
    measurements: LandmarkMeasurements
    positions: Positions | None = None
    loop_closures: LoopClosures | None = None
    known_landmarks: Landmarks | None = None
    known_measurements: LandmarkMeasurements | None = None
    scans: Scans | None = None
    clouds: Clouds | None = None
    truth: Truth = field(default_factory=Truth)
    provenance: dict[str, str] = field(default_factory=dict)
    integration: Integration | None = None

    def __post_init__(self) -> None:
        """Check the streams against each other."""
        object.__setattr__(self, "name", printable(self.name))
        texts = {printable(k): printable(v) for k, v in self.provenance.items()}
        object.__setattr__(self, "provenance", texts)
        _names_by_number(self)
        start = self.prior.time_s
        scanned = any(s is not None and len(s.time_s) for s in (self.scans, self.clouds))
        self._check_loop_closures()
        for stream, times, optional in (
            ("odometry", self.odometry.time_s, scanned),
            ("measurements", self.measurements.time_s, scanned or self.loop_closures is not None),
        ):
            if not len(times) and not optional:
                raise InputError(f"{self.name}: no {stream}, expected at least one record")
            if len(times) and times[0] < start:
                raise RecordError(stream, 0, f"time {times[0]} s lies before the prior's {start} s")
        if self.known_measurements is not None:
            ids = np.zeros(0) if self.known_landmarks is None else self.known_landmarks.id
            unknown = np.flatnonzero(~np.isin(self.known_measurements.landmark, ids))
            if len(unknown):
                row = int(unknown[0])
                raise RecordError(
                    "known measurements",
                    row,
                    f"landmark {self.known_measurements.landmark[row]} is not a known landmark",
                )

    @classmethod
    def from_arrays(
        cls,
        odometry: Columns,
        measurements: Columns,
        *,
        positions: Columns | None = None,
        truth: Columns | None = None,
        truth_landmarks: Columns | None = None,
        prior: Prior | None = None,
        name: str = "arrays",
    ) -> Log:
        """Return a log of a user's own arrays.

        Args:
            odometry: Arrays (N,) by name: `time_s` and either `speed_mps`, `yaw_rate_radps` or
                `speed_mps`, `steering_rad` (each with `sigma_speed_mps`, `sigma_turn`; steering
                with `wheelbase_m`), or `x_m`, `y_m`, `heading_rad` of dead reckoned poses, or
                `dx_m`, `dy_m`, `dheading_rad` of motions (both optionally with `sigma_move_m` and
                `sigma_turn` of each; motions with `cov_00` to `cov_22`). A single number holds for
                all rows.
            measurements: `time_s`, `range_m`, `bearing_rad`, `sigma_range_m`, `sigma_bearing_rad`;
                optionally `landmark` (whole numbers or text; -1 or empty for unknown), `diameter_m`
                and `intensity`.
            positions: `time_s`, `x_m`, `y_m` and `sigma_m` or `var_x_m2`, `cov_xy_m2`, `var_y_m2`.
            truth: `time_s`, `x_m`, `y_m`, `heading_rad`.
            truth_landmarks: `id`, `x_m`, `y_m`.
            prior: Where the vehicle starts; by default where the truth is then, else the origin.
            name: The log's.

        Returns:
            A validated log; its arrays are read-only copies.

        Raises:
            InputError: A record is missing or out of range; stream, row, value and expectation are
                named.
        """
        from comparisons.logs.from_arrays import log_from_arrays

        streams = {
            "measurements": measurements,
            "positions": positions,
            "truth": truth,
            "truth_landmarks": truth_landmarks,
        }
        return log_from_arrays(odometry, streams, prior, name)

    def __repr__(self) -> str:
        """Return name, counts and duration in one line."""
        counts = ", ".join(f"{count:,} {name}" for name, count in self.records.items())
        return f"<Log {self.name}: {counts}; {self.duration_s:.1f} s>"

    def to_pandas(
        self,
        table: Literal[
            "odometry", "measurements", "positions", "truth", "truth_landmarks"
        ] = "measurements",
    ) -> DataFrame:
        """Return a stream as a pandas data frame.

        Args:
            table: `odometry`: the samples of the wheels, or relative poses; `measurements`: range,
                bearing and their standard deviations, landmark (-1 where the sensor names none);
                `positions`: absolute ones with their covariance; `truth`: true poses;
                `truth_landmarks`: the true map. Units are in the columns' names.

        Returns:
            One row for each record; none where the log has no such stream.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        return render("frame", self, table)

    def _check_loop_closures(self) -> None:
        """They are between poses of the odometry, and there where it lacks motions."""
        poses = np.zeros(0)
        if isinstance(self.odometry, RelativePoses):
            poses = np.concatenate(([self.prior.time_s], self.odometry.time_s))
            gaps = np.flatnonzero(np.isnan(self.odometry.covariance[:, 0, 0]))
            if len(gaps) and self.loop_closures is None:
                raise RecordError(
                    "relative poses", int(gaps[0]), "covariance is nan, which needs loop closures"
                )
        if self.loop_closures is not None:
            ends = np.column_stack((self.loop_closures.from_s, self.loop_closures.to_s))
            stray = np.argwhere(~np.isin(ends, poses))
            if len(stray):
                row, column = stray[0].tolist()
                raise RecordError(
                    "loop closures",
                    row,
                    f"time {ends[row, column]} s is not the time of a pose, expected a time "
                    "of the relative poses",
                )

    @property
    def end_s(self) -> float:
        """Time of the last odometry or measurement, or of the last scan where there are neither."""
        driven = [self.odometry.time_s, self.measurements.time_s]
        scanned = [s.time_s for s in (self.scans, self.clouds) if s is not None]
        times = driven if any(map(len, driven)) else scanned
        return max(float(time_s[-1]) for time_s in times if len(time_s))

    @property
    def labels(self) -> dict[int, str]:
        """Names of landmarks by id, where its file names them by text; empty where by numbers."""
        return _names_by_number(self)

    @property
    def duration_s(self) -> float:
        """From the prior to the last record."""
        return self.end_s - self.prior.time_s

    @property
    def records(self) -> dict[str, int]:
        """Number of records in each stream that is present, without those that hold a guess."""
        streams = ((stream.name, attrgetter(stream.field)(self)) for stream in schema.STREAMS)
        counts = {
            name: len(record.time_s)
            for name, record in streams
            if record is not None and record.table.times
        }
        if isinstance(self.odometry, RelativePoses):
            counts["odometry"] -= int(np.isnan(self.odometry.covariance[:, 0, 0]).sum())
        return counts


def _names_by_number(log: Log) -> dict[int, str]:
    """The labels that the provenance has as JSON. Raises InputError."""
    text = log.provenance.get("labels", "{}")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        found = None
    numbers: list[Any] = list(found.values()) if isinstance(found, dict) else [None]
    whole = all(type(number) is int and abs(number) < LARGEST_ID for number in numbers)
    if not whole or len(set(numbers)) < len(numbers):
        raise InputError(
            f"{log.name}: provenance: labels is {quoted(text)}, expected a JSON object of names "
            'and whole numbers, each once, as {"oak": 0, "elm": 1}'
        )
    return dict(zip(numbers, found, strict=True))
