"""The streams of a log, declared once: what all that read, check, write and document them ask.

A stream is a field of `Log` and a file of a log folder. Its record is one class or, of odometry,
one of several; a record's table says which columns of text make each of its arrays. A column has
its name in a log folder, whose end is its unit, its names in files of others, and its limits.

To add a stream: its columns and its table here, an entry of `STREAMS`, and in `log` a record of
that table and a field of `Log`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from math import inf, nextafter, pi
from typing import Any, Literal, NamedTuple

_DEGREE = pi / 180
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "rad": {"rad": 1.0, "deg": _DEGREE},
    "mps": {"mps": 1.0, "m/s": 1.0, "kmh": 1 / 3.6, "km/h": 1 / 3.6},
    "radps": {
        "radps": 1.0, "rad/s": 1.0, "degps": _DEGREE, "deg/s": _DEGREE, "dps": _DEGREE
    },
    "m2": {"m2": 1.0},
}  # fmt: skip
"""By dimension, the units that a header may name, in SI; the first is the default."""
_SPELT = {"mps": "m/s", "radps": "rad/s", "m2": "m^2"}
LEAST_SIGMA, LARGEST_SIGMA = 1e-7, 1e6
"""Of a measurement, in whatever unit: others are mistakes."""
NO_LANDMARK = -1
"""Landmark id of a measurement whose landmark the sensor did not name."""


class Limits(NamedTuple):
    """A closed interval, and the words for it where numbers do not say it."""

    low: float = -inf
    high: float = inf
    words: str = ""

    @property
    def expected(self) -> str:
        """In words."""
        return self.words or f"between {self.low:.4g} and {self.high:.4g}"


ANY = Limits()
SIGMA = Limits(LEAST_SIGMA, LARGEST_SIGMA)


class Stated(NamedTuple):
    """The option of `slamcheck new-log` by which a number holds for all rows.

    Attributes:
        option: With its dashes.
        unit: What its value is in, as help shows it.
        help: Of the command.
        of: Columns that the number is a sigma of: it may have a unit of the first that is there.
        is_positive: Whether it may not be zero.
    """

    option: str
    unit: str
    help: str
    of: tuple[str, ...]
    is_positive: bool = True


@dataclass(frozen=True, eq=False)
class Column:
    """One value a row: of a log folder's file, of a user's CSV, of a message, or of an array.

    Attributes:
        name: In a log folder and in `Log.from_arrays`.
        names: What a header may call it, the first in texts; empty where no header is read so.
        less_usual: Names that are read where no header has one of the usual.
        fields: Fields of a message that make it, or others that do; the first that are all there.
        limits: Where its values lie.
        is_optional: Whether files and arrays may lack it.
        is_added: Whether a log folder has it, behind the others, only where there are values.
        has_gaps: Whether NaN stands for what was not measured.
        is_label: Whether it names landmarks: whole numbers, in files of users also text.
        is_distinct: Whether no value may come twice.
        is_bounded: Whether its numbers are at most `validation.LARGEST`.
        is_signed: Whether a user may say that it counts the other way round.
        degrees_above: Values in radians that are larger can only be degrees.
        stated: The option that gives one value for all rows.
        words: What it is, where its name does not say it.
    """

    name: str
    names: tuple[str, ...] = ()
    less_usual: tuple[str, ...] = ()
    _: KW_ONLY
    fields: tuple[tuple[str, ...], ...] = ()
    limits: Limits = ANY
    is_optional: bool = False
    is_added: bool = False
    has_gaps: bool = False
    is_label: bool = False
    is_distinct: bool = False
    is_bounded: bool = True
    is_signed: bool = False
    degrees_above: float = inf
    stated: Stated | None = None
    words: str = ""

    @property
    def weight(self) -> tuple[bool, bool, bool]:
        """Sorts first what a file must have, then what nothing else tells."""
        return self.has_gaps, self.stated is not None, self.is_optional

    @property
    def unit(self) -> str:
        """Its dimension, of `UNITS`; empty for none."""
        return dimension(self.name)


def spelt_unit(unit: str) -> str:
    """Return a dimension of `UNITS` as texts spell it."""
    return _SPELT.get(unit, unit)


def dimension(name: str) -> str:
    """Return which of `UNITS` a column is in, by the end of its name; empty for none."""
    tail = name.rpartition("_")[2]
    return tail if tail in UNITS else ""


TIME = Column(
    "time_s",
    ("time", "t", "timestamp", "stamp"),
    ("ts", "datetime", "unix_time", "unix_stamp", "stamp_unix", "time_unix", "timestamp_unix"),
    fields=(("stamp_s", "stamp_ns"), ("stamp",)),
)
SPEED = Column(
    "speed_mps",
    ("speed", "v", "velocity", "forward_velocity", "linear_velocity"),
    ("vel", "forward_speed", "linear_speed", "lin_vel", "linear_vel", "forward_vel"),
    fields=(("forward",),),
    is_signed=True,
)
YAW_RATE = Column(
    "yaw_rate_radps",
    ("yaw_rate", "yawrate", "w", "omega", "angular_velocity"),
    (
        "yaw_vel", "yaw_velocity", "yaw_speed", "heading_rate", "psi_dot", "turn_rate",
        "rate_of_turn", "angular_speed", "angular_rate", "ang_vel", "angular_vel", "wz", "omega_z",
        "gyro_z", "gyr_z",
    ),
    fields=(("turn",),),
    is_signed=True,
    degrees_above=20.0,
)  # fmt: skip
STEERING = Column(
    "steering_rad",
    ("steering", "steer", "steering_angle"),
    ("steer_angle", "steering_wheel_angle", "delta"),
    limits=Limits(-1.55, 1.55),
    is_signed=True,
    degrees_above=1.55,
    words="left is positive",
)
X = Column(
    "x_m", ("x",), ("px", "pos_x", "x_pos", "east", "easting"), fields=(("x",),), is_signed=True
)
Y = Column(
    "y_m", ("y",), ("py", "pos_y", "y_pos", "north", "northing"), fields=(("y",),), is_signed=True
)
HEADING = Column(
    "heading_rad",
    ("heading", "yaw", "theta"),
    ("psi", "yaw_angle", "heading_angle", "hdg"),
    fields=(("qx", "qy", "qz", "qw"),),
    is_signed=True,
)
DX = Column("dx_m", ("dx",), ("delta_x",), is_signed=True)
DY = Column("dy_m", ("dy",), ("delta_y",), is_signed=True)
DHEADING = Column(
    "dheading_rad",
    ("dheading", "dyaw", "dtheta"),
    ("dpsi", "delta_heading", "delta_yaw", "delta_theta", "delta_psi"),
    is_signed=True,
)
RANGE = Column(
    "range_m",
    ("range", "distance"),
    ("dist", "rng", "rho", "r"),
    limits=Limits(nextafter(0.0, 1.0), words="above 0"),
)
BEARING = Column(
    "bearing_rad",
    ("bearing",),
    ("azimuth", "azim", "az", "angle", "bearing_angle", "relative_bearing"),
    limits=Limits(-2.0 * pi, 2.0 * pi),
    is_signed=True,
    degrees_above=2.0 * pi,
    words="left is positive",
)
SIGMA_RANGE = Column(
    "sigma_range_m",
    ("sigma_range",),
    ("range_sigma", "range_std", "std_range", "range_stddev", "sigma_r"),
    limits=SIGMA,
    stated=Stated("--sigma-range", "M", "Sigma of ranges, if no column has it.", of=("range_m",)),
)
SIGMA_BEARING = Column(
    "sigma_bearing_rad",
    ("sigma_bearing",),
    ("bearing_sigma", "bearing_std", "std_bearing", "bearing_stddev", "sigma_b"),
    limits=SIGMA,
    stated=Stated(
        "--sigma-bearing", "RAD", "Sigma of bearings, if no column has it.", of=("bearing_rad",)
    ),
)
_LESS_USUAL_LABELS = (
    "landmark_name", "landmark_label", "tag", "tag_id", "marker", "marker_id", "beacon",
    "beacon_id", "feature_id", "object_id", "target", "target_id", "name",
)  # fmt: skip
LANDMARK = Column(
    "landmark",
    ("landmark", "id", "label", "landmark_id", "subject_nb"),
    _LESS_USUAL_LABELS,
    limits=Limits(NO_LANDMARK, words=f"an id from 0 or {NO_LANDMARK}"),
    is_optional=True,
    is_label=True,
    words=f"{NO_LANDMARK} for unknown",
)
ID = Column(
    "id",
    ("id", "label", "landmark", "landmark_id", "subject_nb"),
    _LESS_USUAL_LABELS,
    is_label=True,
    is_distinct=True,
)
DIAMETER = Column("diameter_m", ("diameter",), is_optional=True, has_gaps=True)
INTENSITY = Column(
    "intensity",
    ("intensity",),
    is_optional=True,
    is_added=True,
    has_gaps=True,
    is_bounded=False,
    words="in the sensor's own unit",
)
_VAR_X = Column("var_x_m2", ("var_x",), fields=(("position_0",), ("pose_0",)), is_optional=True)
_COV_XY = Column("cov_xy_m2", ("cov_xy",), fields=(("position_1",), ("pose_1",)), is_optional=True)
_VAR_Y = Column("var_y_m2", ("var_y",), fields=(("position_4",), ("pose_7",)), is_optional=True)
SIGMA_POSITION = Column(
    "sigma_m",
    ("sigma",),
    ("sigma_position", "position_sigma", "position_std", "std"),
    limits=SIGMA,
    stated=Stated("--sigma-position", "M", "Sigma of positions, if no column has it.", of=("x_m",)),
)
_LATITUDE = Column("latitude", ("latitude", "lat"), fields=(("latitude",),))
_LONGITUDE = Column("longitude", ("longitude", "lon", "lng"), fields=(("longitude",),))
_ALTITUDE = Column("altitude", ("altitude", "alt"), fields=(("altitude",),))
_TWIST = tuple(
    Column(name, (name,), fields=((entry,),), is_optional=True)
    for name, entry in (
        ("var_forward", "twist_0"),
        ("var_left", "twist_7"),
        ("var_turn", "twist_35"),
    )
)
"""Variances of velocities that a message of odometry has beside its poses."""
_ENTRIES = (0, 1, 5, 7, 11, 35)
"""x, y and the turn about z of a message's six: the upper triangle among its 36 covariances."""
_UPPER = [(i, j) for i in range(3) for j in range(i, 3)]
_COVARIANCE = tuple(
    Column(
        f"cov_{i}{j}",
        (f"cov_{i}{j}",),
        fields=((f"pose_{entry}",),),
        is_optional=True,
        words="of x, y [m] and heading [rad], the upper triangle by rows",
    )
    for (i, j), entry in zip(_UPPER, _ENTRIES, strict=True)
)
"""Of x, y and heading, or of a motion: the upper triangle by rows."""
SIGMA_SPEED = Column(
    "sigma_speed_mps",
    stated=Stated("--sigma-speed", "M/S", "Sigma of speeds.", ("speed_mps",), is_positive=False),
)
SIGMA_TURN = Column(
    "sigma_turn",
    stated=Stated(
        "--sigma-turn",
        "RAD",
        "Sigma of turn rates, steering or turns.",
        ("yaw_rate_radps", "steering_rad", "heading_rad", "dheading_rad"),
        is_positive=False,
    ),
)
SIGMA_MOVE = Column(
    "sigma_move_m",
    stated=Stated(
        "--sigma-move",
        "M",
        "Sigma of moves. [grows with distance]",
        ("x_m", "dx_m"),
        is_positive=False,
    ),
)
WHEELBASE = Column(
    "wheelbase_m",
    stated=Stated("--wheelbase", "M", "Wheelbase, for steering angles.", ("wheelbase_m",)),
)


@dataclass(frozen=True, eq=False)
class ArrayField:
    """An array of a record.

    Attributes:
        name: Of the record's field.
        shape: Lengths of its axes, or names of lengths that arrays of a record share.
        columns: Of a table of text, that make it; none of one that is stored as an array.
        has_gaps: Whether NaN stands for what was not measured; of covariances, in whole matrices.
        is_singular: Whether covariances may be so.
        is_bounded: Whether its numbers are at most `validation.LARGEST`.
        is_whole: Whether they are whole, such as ids.
        words: What it is, where its name does not say it.
    """

    name: str
    shape: tuple[int | str, ...]
    columns: tuple[Column, ...] = ()
    _: KW_ONLY
    has_gaps: bool = False
    is_singular: bool = False
    is_bounded: bool = True
    is_whole: bool = False
    words: str = ""

    @property
    def is_covariance(self) -> bool:
        """Whether its columns are the upper triangle of a matrix."""
        return len(self.shape) == 3

    @property
    def is_optional(self) -> bool:
        """Whether a record may leave it empty where nothing was measured."""
        return self.has_gaps and len(self.columns) == 1


def _single(column: Column) -> ArrayField:
    return ArrayField(
        column.name,
        ("N",),
        (column,),
        has_gaps=column.has_gaps,
        is_bounded=column.is_bounded and not column.is_label,
        is_whole=column.is_label,
    )


def _group(name: str, *columns: Column) -> ArrayField:
    return ArrayField(name, ("N", len(columns)), columns)


def _matrix(*columns: Column, has_gaps: bool = False, is_singular: bool = False) -> ArrayField:
    size = {3: 2, 6: 3}[len(columns)]
    shape = ("N", size, size)
    return ArrayField("covariance", shape, columns, has_gaps=has_gaps, is_singular=is_singular)


@dataclass(frozen=True, eq=False)
class RecordTable:
    """The arrays of a record.

    Attributes:
        name: Of the records, in errors.
        fields: In the order of the columns; each has a row for each of the first's.
        kind: Of odometry, else empty.
        order: How times follow each other: they increase, or do not fall; empty for neither.
        others: Columns that files and arrays of users may have besides, or in place of some.
        words: On its rows.
    """

    name: str
    fields: tuple[ArrayField, ...]
    _: KW_ONLY
    kind: str = ""
    order: Literal["increasing", "not falling", ""] = ""
    others: tuple[Column, ...] = ()
    words: str = ""

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Of the file, in its order."""
        return tuple(column for part in self.fields for column in part.columns)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the columns."""
        return tuple(column.name for column in self.columns)

    @cached_property
    def needed(self) -> tuple[str, ...]:
        """Names of the columns that no file may lack."""
        return tuple(column.name for column in self.columns if not column.is_optional)

    @cached_property
    def values(self) -> tuple[str, ...]:
        """Those of them that are no times."""
        return tuple(name for name in self.needed if name not in self.times)

    @cached_property
    def read_from_files(self) -> tuple[Column, ...]:
        """Those that files of users may have, under one of their names."""
        return tuple(column for column in (*self.columns, *self.others) if column.names)

    @cached_property
    def measured(self) -> tuple[str, ...]:
        """Those of the values that the sensor gives, without their sigmas."""
        sigmas = {column.name for column in self.columns if column.stated is not None}
        return tuple(name for name in self.values if name not in sigmas)

    @cached_property
    def stated(self) -> tuple[str, ...]:
        """Names of the others that say one number for all rows."""
        return tuple(column.name for column in self.others if column.stated is not None)

    @cached_property
    def places(self) -> dict[str, tuple[ArrayField, int]]:
        """Where each column stands: in which array, and in which column of that."""
        return {
            column.name: (part, place)
            for part in self.fields
            for place, column in enumerate(part.columns)
        }

    @cached_property
    def gaps(self) -> tuple[str, ...]:
        """Names of the columns in which NaN is a value."""
        return tuple(
            column.name for part in self.fields for column in part.columns if part.has_gaps
        )

    @cached_property
    def times(self) -> tuple[str, ...]:
        """Names of the arrays that are clock times, and of their columns."""
        names = (part.name for part in self.fields)
        return tuple(name for name in names if name in ("time_s", "from_s", "to_s"))


def _table(name: str, *parts: Column | ArrayField, **more: Any) -> RecordTable:
    """A table of arrays; a column alone is one."""
    fields = (part if isinstance(part, ArrayField) else _single(part) for part in parts)
    return RecordTable(name, tuple(fields), **more)


_MOTION = _group("displacement", DX, DY, DHEADING)
_POSE = _group("pose", X, Y, HEADING)
_PLACE = _group("position_m", X, Y)
_VARIANCES = (_VAR_X, _COV_XY, _VAR_Y)
_HELD = "a sample holds until the next"
VELOCITY = _table(
    "velocity odometry", TIME, SPEED, YAW_RATE,
    kind="velocity", order="not falling", others=(SIGMA_SPEED, SIGMA_TURN), words=_HELD,
)  # fmt: skip
STEERED = _table(
    "steering odometry", TIME, SPEED, STEERING,
    kind="steering", order="not falling", others=(SIGMA_SPEED, SIGMA_TURN, WHEELBASE), words=_HELD,
)  # fmt: skip
RECKONED = _table(
    "poses", TIME, _POSE, _matrix(*_COVARIANCE),
    kind="poses", order="increasing", others=(SIGMA_MOVE, SIGMA_TURN, *_TWIST),
)  # fmt: skip
"""Of users alone: the poses of an odometry."""
RELATIVE = _table(
    "relative poses", TIME, _MOTION, _matrix(*_COVARIANCE, has_gaps=True),
    kind="relative-poses", order="increasing", others=(SIGMA_MOVE, SIGMA_TURN),
    words="the displacement in the departing frame, its covariance in the arriving one (as g2o and "
    "gtsam), the first departing from the prior",
)  # fmt: skip
KINDS = {table.kind: table for table in (VELOCITY, STEERED, RECKONED, RELATIVE)}
"""Kinds of odometry that a user may have."""
CLOSURES = _table("loop closures", Column("from_s"), Column("to_s"), _MOTION, _matrix(*_COVARIANCE))
MEASUREMENTS = _table(
    "measurements",
    TIME, RANGE, BEARING, SIGMA_RANGE, SIGMA_BEARING, LANDMARK, DIAMETER, INTENSITY,
    order="not falling",
)  # fmt: skip
POSITIONS = _table(
    "positions", TIME, _PLACE, _matrix(*_VARIANCES),
    order="increasing", others=(SIGMA_POSITION, _LATITUDE, _LONGITUDE, _ALTITUDE),
)  # fmt: skip
LANDMARKS = _table("landmarks", ID, _PLACE, _matrix(*_VARIANCES, is_singular=True))
POSES = _table("poses", TIME, _POSE, order="increasing")
SURFACES = _table("surfaces", _group("segment", *map(Column, ("x1_m", "y1_m", "x2_m", "y2_m"))))
SCANS = _table(
    "scans",
    ArrayField("time_s", ("N",), words="of the first beam"),
    ArrayField("angle_rad", ("B",)),
    ArrayField("range_m", ("N", "B"), has_gaps=True, words="NaN for no return"),
    ArrayField("intensity", ("N", "B"), is_bounded=False),
    order="increasing",
)
_FIRST = "row of each scan's first point, and the end"
CLOUDS = _table(
    "clouds",
    ArrayField("time_s", ("N",)),
    ArrayField("first", ("N + 1",), is_whole=True, words=_FIRST),
    ArrayField("point_m", ("P", 3), has_gaps=True),
    ArrayField("point_s", ("P",), words="seconds after the scan's time"),
    order="increasing",
)


@dataclass(frozen=True, eq=False)
class LogStream:
    """A stream of a log.

    Attributes:
        field: Of `Log`, as `truth.poses`.
        file: Of a log folder.
        tables: Of its records, one for each kind.
        option: Of `slamcheck new-log` for a user's file, with its help; empty where it reads none.
        by_users: Tables of users' files, where these are others.
        is_required: Whether a log folder must have it.
        words: On its rows, besides those of the table.
    """

    field: str
    file: str
    tables: tuple[RecordTable, ...]
    option: str = ""
    help: str = ""
    _: KW_ONLY
    by_users: tuple[RecordTable, ...] = ()
    is_required: bool = False
    words: str = ""

    @property
    def user_tables(self) -> tuple[RecordTable, ...]:
        """What files of users may hold."""
        return self.by_users or self.tables

    @property
    def is_truth(self) -> bool:
        """Whether it is of the truth, which is exact."""
        return self.field.startswith("truth.")

    @property
    def wanted(self) -> tuple[str, ...]:
        """Names of the columns that are read of files of users, in the order of their weight."""
        columns = [column for table in self.user_tables for column in table.read_from_files]
        if self.is_truth:
            columns = [column for column in columns if not column.is_optional]
        return tuple(dict.fromkeys(c.name for c in sorted(columns, key=lambda c: c.weight)))

    @property
    def name(self) -> str:
        """In counts of records."""
        return self.field.replace("_", " ").replace(".", " ")

    @property
    def argument(self) -> str:
        """Of `Log.from_arrays`; empty where it has none."""
        return self.option.removeprefix("--").replace("-", "_")

    @property
    def spoken(self) -> str:
        """What users call it."""
        return self.argument.replace("_", " ") or self.name

    @property
    def is_timed(self) -> bool:
        """Whether its rows are of instants at which an estimator needs a pose."""
        return not self.is_truth and "time_s" in self.tables[0].needed

    @property
    def is_archived(self) -> bool:
        """Whether its file holds arrays, not text."""
        return self.file.endswith(".npz")


STREAMS = (
    LogStream(
        "odometry", "odometry.csv", (STEERED, VELOCITY, RELATIVE),
        "--odometry", "Speeds, or poses.", by_users=tuple(KINDS.values()), is_required=True,
    ),
    LogStream(
        "measurements", "measurements.csv", (MEASUREMENTS,),
        "--measurements", "Ranges, bearings, labels.", is_required=True,
        words="one scan shares one time",
    ),
    LogStream(
        "positions", "positions.csv", (POSITIONS,),
        "--positions", "GPS, in the frame of the start pose.",
    ),
    LogStream(
        "loop_closures", "closures.csv", (CLOSURES,),
        words="measured motions between poses that do not follow each other, as of relative poses, "
        "whose times these are",
    ),
    LogStream("known_landmarks", "known_landmarks.csv", (LANDMARKS,)),
    LogStream(
        "known_measurements", "known_measurements.csv", (MEASUREMENTS,),
        words="ids from `known_landmarks.csv`",
    ),
    LogStream("scans", "scans.npz", (SCANS,)),
    LogStream("clouds", "clouds.npz", (CLOUDS,)),
    LogStream("truth.poses", "truth_poses.csv", (POSES,), "--truth", "True poses, CSV or TUM."),
    LogStream(
        "truth.landmarks", "truth_landmarks.csv", (LANDMARKS,),
        "--truth-landmarks", "True landmarks: id, x, y.",
    ),
    LogStream("truth.surfaces", "truth_surfaces.csv", (SURFACES,), words="one segment per line"),
)  # fmt: skip
"""In the order of `Log`'s fields."""


def _known_columns() -> Iterator[Column]:
    """What a user may give a column of, each once for each table."""
    for stream in STREAMS:
        if stream.option:
            for table in stream.user_tables:
                yield from (*table.columns, *table.others)


COLUMNS: dict[str, Column] = {
    column.name: column for column in sorted(_known_columns(), key=lambda column: column.weight)
}
"""All that a user may give, by name."""
COVARIANCE, TWIST, VARIANCES = (
    tuple(column.name for column in columns) for columns in (_COVARIANCE, _TWIST, _VARIANCES)
)
"""Names of the columns of covariances of poses, of variances of speeds, and of positions."""
OPTIONS = {
    column.name: column.stated.option for column in COLUMNS.values() if column.stated is not None
}
"""The option that states a column's number for all rows."""
