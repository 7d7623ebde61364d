"""What the header of a user's column means: one of a log folder's columns, and a unit.

A header is a name and, optionally, a unit: `range_m`, `range [m]`, `bearing_deg`, `t_ns`, `v_m_s`.
Neither case nor `_` makes a name another. `plain_csv` asks here for each header of a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from typing import NamedTuple

from comparisons.errors import InputError, shorten
from comparisons.logs.from_arrays import COVARIANCE, TWIST

RENAME = "rename the columns"
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
_SPELT = {
    **dict.fromkeys(("second", "seconds", "secs"), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "micros", "microsecond", "microseconds", "µs", "μs"), "us"),
    **dict.fromkeys(
        ("nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"
    ),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("degree", "degrees", "degs", "°"), "deg"),
    **dict.fromkeys(("ms-1", "m/sec"), "m/s"),
    **dict.fromkeys(("kph", "kmph"), "km/h"),
    **dict.fromkeys(("rads-1", "rad/sec", "rads/s", "radians/s"), "rad/s"),
    **dict.fromkeys(("degs-1", "deg/sec", "degs/s", "degrees/s", "degree/s", "°/s"), "deg/s"),
}
"""Other spellings of units, without blanks, points and ^."""
NAMES: dict[str, tuple[str, ...]] = {
    "time_s": ("time", "t", "timestamp", "stamp"),
    "speed_mps": ("speed", "v", "velocity", "forward_velocity", "linear_velocity"),
    "yaw_rate_radps": ("yaw_rate", "yawrate", "w", "omega", "angular_velocity"),
    "steering_rad": ("steering", "steer", "steering_angle"),
    "x_m": ("x",),
    "y_m": ("y",),
    "heading_rad": ("heading", "yaw", "theta"),
    "dx_m": ("dx",),
    "dy_m": ("dy",),
    "dheading_rad": ("dheading", "dyaw", "dtheta"),
    "range_m": ("range", "distance"),
    "bearing_rad": ("bearing",),
    "sigma_range_m": ("sigma_range",),
    "sigma_bearing_rad": ("sigma_bearing",),
    "landmark": ("landmark", "id", "label", "landmark_id", "subject_nb"),
    "id": ("id", "label", "landmark", "landmark_id", "subject_nb"),
    "diameter_m": ("diameter",),
    "intensity": ("intensity",),
    "var_x_m2": ("var_x",),
    "cov_xy_m2": ("cov_xy",),
    "var_y_m2": ("var_y",),
    "sigma_m": ("sigma",),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "altitude": ("altitude", "alt"),
    **{name: (name,) for name in (*TWIST, *COVARIANCE)},
}
"""What a header may be called, by column of a log folder."""
_ALSO: dict[str, tuple[str, ...]] = {
    "time_s": (
        "ts", "datetime", "unix_time", "unix_stamp", "stamp_unix", "time_unix", "timestamp_unix",
    ),
    "speed_mps": (
        "vel", "forward_speed", "linear_speed", "lin_vel", "linear_vel", "forward_vel",
    ),
    "yaw_rate_radps": (
        "yaw_vel", "yaw_velocity", "yaw_speed", "heading_rate", "psi_dot", "turn_rate",
        "rate_of_turn", "angular_speed", "angular_rate", "ang_vel", "angular_vel", "wz", "omega_z",
        "gyro_z", "gyr_z",
    ),
    "steering_rad": ("steer_angle", "steering_wheel_angle", "delta"),
    "x_m": ("px", "pos_x", "x_pos", "east", "easting"),
    "y_m": ("py", "pos_y", "y_pos", "north", "northing"),
    "heading_rad": ("psi", "yaw_angle", "heading_angle", "hdg"),
    "dx_m": ("delta_x",),
    "dy_m": ("delta_y",),
    "dheading_rad": ("dpsi", "delta_heading", "delta_yaw", "delta_theta", "delta_psi"),
    "range_m": ("dist", "rng", "rho", "r"),
    "bearing_rad": ("azimuth", "azim", "az", "angle", "bearing_angle", "relative_bearing"),
    "sigma_range_m": ("range_sigma", "range_std", "std_range", "range_stddev", "sigma_r"),
    "sigma_bearing_rad": (
        "bearing_sigma", "bearing_std", "std_bearing", "bearing_stddev", "sigma_b",
    ),
    **dict.fromkeys(
        ("landmark", "id"),
        ("landmark_name", "landmark_label", "tag", "tag_id", "marker", "marker_id", "beacon",
         "beacon_id", "feature_id", "object_id", "target", "target_id", "name"),
    ),
    "sigma_m": ("sigma_position", "position_sigma", "position_std", "std"),
}  # fmt: skip
"""Names that are read where no header has one of the usual."""


@dataclass(frozen=True, kw_only=True)
class ColumnOptions:
    """What a user says of the columns of a file.

    units: by header or usual name, of its values. headers: by usual name, which header has it; None
    where the command has no option for it.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] | None = None

    @property
    def mend(self) -> str:
        """What to do about headers that are not known."""
        return RENAME if self.headers is None else f"{RENAME} or give --column"


class Meaning(NamedTuple):
    """A column of a log folder, the unit that the header names, and whether its name is usual."""

    column: str
    unit: str | None
    usual: bool


class UnknownUnit(InputError):  # noqa: N818  # named for what it is
    """A header of a known name names a unit that its column cannot have."""


def known_unit(column: str, text: str) -> str | None:
    """Return how a unit of a column is spelt in `UNITS`; None for one that it cannot have."""
    units = UNITS.get(dimension(column), {})
    word = text.lower().replace(" ", "").replace(".", "").replace("^", "")
    word = _SPELT.get(word, word)
    if word in units:
        return word
    return next((unit for unit in units if unit.replace("/", "") == word), None)


def meaning(header: str, wanted: Sequence[str]) -> Meaning | None:
    """Return what a header means of the columns that are wanted; None for nothing.

    Raises UnknownUnit.
    """
    for usual, names in ((True, NAMES), (False, _ALSO)):
        for column in wanted:
            keys = {_key(one) for one in names.get(column, ())}
            found = _unit_behind(header, keys, column)
            if found is not None:
                return Meaning(column, found or None, usual)
    return None


def named_header(header: str, column: str) -> Meaning:
    """Return a header that a user gave for a column, with the unit that ends it."""
    name, unit = parted(header)
    if unit is not None:
        return Meaning(column, _checked_unit(header, column, unit), usual=True)
    ends = (known_unit(column, end) for _, end in _endings(name))
    return Meaning(column, next((end for end in ends if end), None), usual=True)


def column_of(name: str, among: Sequence[str] = tuple(NAMES)) -> str | None:
    """Return the column that a name is of, as `time_s` for `time`; None for none of some."""
    key = _key(name)
    for names in (NAMES, _ALSO):
        for column in among:
            if key in {_key(one) for one in (column, *names.get(column, ()))}:
                return column
    return None


def factor_of(column: str, unit: str) -> float:
    """Return what makes SI of values; a unit behind `-` counts the other way round."""
    factor = UNITS.get(dimension(column), {}).get(unit.removeprefix("-"), 1.0)
    return -factor if unit.startswith("-") else factor


def parted(header: str) -> tuple[str, str | None]:
    """Return a header's name and the unit in brackets behind it."""
    text = header.strip().lower().lstrip("%_ ")
    at = min(len(text.partition(bracket)[0]) for bracket in "[(")
    if at < len(text) and text[-1] in "])":
        name = text[:at].replace("_", " ").rstrip()
        return name.replace(" ", "_"), text[at + 1 : -1].strip()
    return text.replace(" ", "_"), None


def dimension(column: str) -> str:
    """Return which of `UNITS` a column is in, by the end of its name; empty for none."""
    tail = column.rpartition("_")[2]
    return tail if tail in UNITS else ""


def _key(name: str) -> str:
    """What makes a name another; in one with digits, as those of matrices, `_` does as well."""
    lower = name.lower()
    return lower if any(map(str.isdigit, lower)) else lower.replace("_", "")


def _endings(name: str) -> list[tuple[str, str]]:
    """Names with the unit that may end them: of one part, or of two as in `m_s`."""
    words = name.split("_")
    return [
        ("_".join(words[:-count]), "/".join(words[-count:])) for count in (1, 2) if words[count:]
    ]


def _unit_behind(header: str, keys: set[str], column: str) -> str | None:
    """The unit of a header that has one of the names; empty for no unit, None for another name."""
    name, unit = parted(header)
    if _key(name) in keys:
        return "" if unit is None else _checked_unit(header, column, unit)
    for first, end in _endings(name):
        known = known_unit(column, end)
        if known is not None and _key(first) in keys:
            return known
    return None


def _checked_unit(header: str, column: str, unit: str) -> str:
    known = known_unit(column, unit)
    if known is None:
        raise UnknownUnit(
            f"unit '{shorten(unit)}' of column '{shorten(header)}' is unknown, expected "
            f"{', '.join(UNITS.get(dimension(column), ())) or 'none'}"
        )
    return known
