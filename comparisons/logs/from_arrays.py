"""A log from a user's own arrays, named as the columns of a log folder; see `Log.from_arrays`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from comparisons.arrays import Array, symmetric
from comparisons.errors import InputError, RecordError, shorten
from comparisons.logs.log import (
    NO_LANDMARK,
    Columns,
    Ids,
    LandmarkMeasurements,
    Landmarks,
    Log,
    Poses,
    Positions,
    Prior,
    Truth,
)
from comparisons.logs.odometry import (
    NOISE_TEXT,
    Ackermann,
    Odometry,
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
    displacements,
    instants_of,
    poses_at,
)
from comparisons.logs.odometry_noise import added_between, reckoned_motion
from comparisons.logs.stamps import resolved
from comparisons.logs.validation import standard_deviation, whole_numbers
from graphslam.increments import dead_reckoned

KINDS = {
    "velocity": ("speed_mps", "yaw_rate_radps"),
    "steering": ("speed_mps", "steering_rad"),
    "poses": ("x_m", "y_m", "heading_rad"),
    "relative-poses": ("dx_m", "dy_m", "dheading_rad"),
}
"""Kinds of odometry, and the columns that each needs besides `time_s`."""
COVARIANCE = tuple(f"cov_{i}{j}" for i in range(3) for j in range(i, 3))
TWIST = ("var_forward", "var_left", "var_turn")
"""Variances of velocities that a message of odometry has beside its poses."""
PRIOR_VARIANCE = 1e-6
_UNKNOWN = ("", "nan", "na", "none", "null", "unknown")
"""What stands, in either case, for a landmark that is not known."""
_NOISE = ("variance_rate_position", "variance_rate_heading")
_VEHICLE = ("wheelbase_m", "encoder_offset_m", "sensor_forward_m", "sensor_left_m")
VARIANCES = ("var_x_m2", "cov_xy_m2", "var_y_m2")
GAPS = ("diameter_m", "intensity")
"""Columns in which NaN means not measured."""
LABELS = ("landmark", "id")
"""Columns of landmarks' names."""
MEASUREMENTS = ("time_s", "range_m", "bearing_rad", "sigma_range_m", "sigma_bearing_rad")


Motion = tuple[Odometry, float, str | None]
"""Odometry, when it starts, and words on the noise of relative poses."""


def log_from_arrays(
    odometry: Columns,
    measurements: Columns,
    positions: Columns | None,
    truth: Columns | None,
    truth_landmarks: Columns | None,
    prior: Prior | None,
    name: str,
) -> Log:
    """See Log.from_arrays."""
    for what, given in (("odometry", odometry), ("measurements", measurements)):
        if not isinstance(given, Mapping):
            raise InputError(f"{what}: is a {type(given).__name__}, expected columns by name")
    seen = _columns("measurements", measurements, MEASUREMENTS, ("landmark", *GAPS))
    numbers = LandmarkNumbers(seen.get("landmark"), (truth_landmarks or {}).get("id"))
    fixes = None if positions is None else _positions(positions)
    poses = None
    if truth is not None:
        poses = _poses("truth", _columns("truth", truth, ("time_s", *KINDS["poses"])))
    with_poses = "x_m" in odometry
    if with_poses:  # a pose is needed at every instant with a measurement or a position
        seen["time_s"] = resolved(seen["time_s"])
        if fixes is not None:
            fixes = Positions(resolved(fixes.time_s), fixes.position_m, fixes.covariance)
    names = seen.pop("landmark", np.full(len(seen["time_s"]), NO_LANDMARK))
    stream = LandmarkMeasurements(**seen, landmark=numbers.of(names))
    wanted = [stream.time_s] + ([] if fixes is None else [fixes.time_s])
    moved, start_s, noise = _motion(odometry, np.concatenate(wanted))
    if with_poses and fixes is not None:
        fixes = fixes.chosen(np.isin(fixes.time_s, (start_s, *moved.time_s)))
    where = prior or default_prior(start_s, poses)
    provenance = {} if noise is None else {"odometry_noise": noise}
    if numbers.by_text:
        provenance["labels"] = numbers.text()
    return Log(
        name=name,
        format="arrays",
        prior=where,
        odometry=moved,
        measurements=stream,
        positions=fixes,
        truth=Truth(
            poses, None if truth_landmarks is None else _landmarks(truth_landmarks, numbers)
        ),
        provenance=provenance,
    )


def default_prior(start_s: float, truth: Poses | None) -> Prior:
    """Where the truth is at the start, the origin where that is unknown; exact to 1 mm, 1 mrad."""
    pose = np.zeros(3)
    if truth is not None and truth.time_s[0] <= start_s <= truth.time_s[-1]:
        pose = truth.at(np.array([start_s]))[0]
    return Prior(start_s, pose, PRIOR_VARIANCE * np.eye(3))


def odometry_kind(names: Sequence[str]) -> str:
    """The kind that columns are of. Raises InputError where that is none or not certain."""
    found = [kind for kind, needed in KINDS.items() if set(needed) <= set(names)]
    if len(found) == 1:
        return found[0]
    choices = "; ".join(f"{', '.join(needed)} ({kind})" for kind, needed in KINDS.items())
    if found:
        raise InputError(f"odometry: holds {' and '.join(found)}, expected one of these kinds")
    raise InputError(f"odometry: columns are {', '.join(names)}, expected time_s and {choices}")


def _motion(given: Columns, wanted_s: Array) -> Motion:
    """Odometry of any kind; wanted_s: (M,) instants at which a pose is needed."""
    kind = odometry_kind([name for name in given if name != "time_s"])
    sigmas = ("sigma_move_m", "sigma_turn")
    if kind == "poses":
        optional = (*sigmas, *COVARIANCE, *TWIST)
        table = _columns("odometry", given, ("time_s", *KINDS[kind]), optional)
        table["time_s"] = resolved(table["time_s"])
        return _between_poses(_poses("odometry", table), table, wanted_s)
    if kind == "relative-poses":
        table = _columns("odometry", given, ("time_s", *KINDS[kind]), (*sigmas, *COVARIANCE))
        return _relative(table)
    needed = ("time_s", *KINDS[kind], "sigma_speed_mps", "sigma_turn")
    table = _columns("odometry", given, needed, _NOISE + (_VEHICLE if kind == "steering" else ()))
    if kind == "steering" and "wheelbase_m" not in given:
        raise InputError("odometry: wheelbase_m is missing, which steering needs")
    noise = OdometryNoise(
        *(_single(given, name) for name in ("sigma_speed_mps", "sigma_turn")),
        **{name: _single(given, name) for name in _NOISE if name in given},
    )
    time_s, first, second = (table[name] for name in ("time_s", *KINDS[kind]))
    found: Odometry
    if kind == "steering":
        vehicle = Ackermann(**{name: _single(given, name) for name in _VEHICLE if name in given})
        found = SteeringOdometry(time_s, first, second, vehicle, noise)
    else:
        found = VelocityOdometry(time_s, first, second, noise)
    return found, float(found.time_s[0]) if len(found.time_s) else 0.0, None


def _between_poses(poses: Poses, table: dict[str, Any], wanted_s: Array) -> Motion:
    """Motions between the instants wanted, and in half seconds without, between the poses given."""
    time_s = poses.time_s
    if len(time_s) < 2:
        raise InputError(f"odometry: {len(time_s)} poses, expected at least two")
    within = (wanted_s >= time_s[0]) & (wanted_s <= time_s[-1])
    instants = instants_of(wanted_s[within], time_s)
    variance = _step_variances(table, len(time_s) - 1)
    if variance is None and set(COVARIANCE) <= table.keys():
        twist = [table.get(name, np.zeros(len(time_s))) for name in TWIST]
        rows = np.column_stack((poses.pose, *twist, covariances(table).reshape(-1, 9)))
        motion, words = reckoned_motion(instants, time_s, rows)
        return motion, float(time_s[0]), words
    motion = displacements(instants, poses_at(instants, time_s, poses.pose))
    if variance is None:
        return motion, float(time_s[0]), NOISE_TEXT
    covariance = added_between(instants, time_s, variance[:, :, None] * np.eye(3))
    stated = RelativePoses(motion.time_s, motion.displacement, covariance)
    return stated, float(time_s[0]), "stated, for each motion between the given poses"


def covariances(table: Mapping[str, Any]) -> Array:
    """Return the covariances (N, 3, 3) of the columns `cov_00` to `cov_22`."""
    return symmetric(np.column_stack([table[name] for name in COVARIANCE]))


def _relative(table: dict[str, Any]) -> Motion:
    time_s = table["time_s"]
    if not len(time_s):
        raise InputError("odometry: holds no motions, expected at least one")
    moved = np.column_stack([table[name] for name in KINDS["relative-poses"]])
    start_s = float(2 * time_s[0] - time_s[1]) if len(time_s) > 1 else float(time_s[0] - 1.0)
    if set(COVARIANCE) <= table.keys():
        covariance = covariances(table)
        return RelativePoses(time_s, moved, covariance), start_s, "the columns cov_00 to 22"
    variance = _step_variances(table, len(time_s))
    if variance is None:
        path = dead_reckoned(np.zeros(3), moved)
        stated = displacements(np.concatenate(([start_s], time_s)), path).covariance
        return RelativePoses(time_s, moved, stated), start_s, NOISE_TEXT
    covariance = variance[:, :, None] * np.eye(3)
    return RelativePoses(time_s, moved, covariance), start_s, "stated, for each motion"


def _step_variances(table: dict[str, Any], count: int) -> Array | None:
    """(count, 3) of the last motions, from their stated sigmas; None where none are stated."""
    given = [name for name in ("sigma_move_m", "sigma_turn") if name in table]
    if not given:
        return None
    if len(given) < 2:
        raise InputError(f"odometry: {given[0]} alone, expected sigma_move_m and sigma_turn")
    move, turn = (table[name] for name in given)
    for name, values in zip(given, (move, turn), strict=True):
        standard_deviation("odometry", name, values)
    return np.column_stack((move, move, turn))[-count:] ** 2


def _positions(given: Columns) -> Positions:
    stated = "sigma_m" in given
    needed = ("time_s", "x_m", "y_m", *(("sigma_m",) if stated else VARIANCES))
    table = _columns("positions", given, needed)
    place = np.column_stack((table["x_m"], table["y_m"]))
    if stated:
        sigma = table["sigma_m"]
        standard_deviation("positions", "sigma_m", sigma)
        covariance = sigma[:, None, None] ** 2 * np.eye(2)
    else:
        covariance = symmetric(np.column_stack([table[name] for name in VARIANCES]))
    return Positions(table["time_s"], place, covariance)


def _poses(stream: str, table: dict[str, Any]) -> Poses:
    if not len(table["time_s"]):
        raise InputError(f"{stream}: holds no poses, expected at least one")
    try:
        pose = np.column_stack([table[name] for name in KINDS["poses"]])
        return Poses(table["time_s"], pose)
    except RecordError as error:
        raise RecordError(stream, error.row, error.fault) from None


def _landmarks(given: Columns, numbers: LandmarkNumbers) -> Landmarks:
    table = _columns("truth landmarks", given, ("id", "x_m", "y_m"))
    place = np.column_stack((table["x_m"], table["y_m"]))
    try:
        ids = numbers.of(table["id"], "truth landmarks", "id")
        return Landmarks(ids, place, np.zeros((len(place), 2, 2)))
    except RecordError as error:
        raise RecordError("truth landmarks", error.row, error.fault) from None


class LandmarkNumbers:
    """Whole numbers for landmarks' names: their own, or by the order in which they come."""

    def __init__(self, *given: Any) -> None:
        """given: all columns of names; None for a column that is not there."""
        words = [word for column in given if column is not None for word in _words(column)]
        self.by_text: dict[str, int] = {}
        if any(_number(word) is None for word in words):
            for word in words:
                if _number(word) != NO_LANDMARK:
                    self.by_text.setdefault(word, len(self.by_text))

    def of(self, column: Any, stream: str = "measurements", name: str = "landmark") -> Ids:
        """(N,), NO_LANDMARK for no name. Raises RecordError for fractions."""
        found = [self.by_text.get(word, _number(word)) for word in _words(column)]
        return whole_numbers(stream, name, np.array(found, dtype=float))

    def text(self) -> str:
        """Names and numbers as JSON."""
        return json.dumps(self.by_text, ensure_ascii=False)


def _words(column: Any) -> list[str]:
    return [str(one).strip() for one in np.asarray(column).tolist()]


def _number(word: str) -> float | None:
    """A landmark's number, NO_LANDMARK for no name; None for text."""
    if word.lower() in _UNKNOWN:
        return NO_LANDMARK
    try:
        return float(word)
    except ValueError:
        return None


def _columns(
    stream: str, given: Columns, needed: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Any]:
    """All columns as arrays of one length, of floats but for landmarks' names.

    Raises InputError naming what is missing or unknown.
    """
    known = (*needed, *optional)
    if missing := [name for name in needed if name not in given]:
        raise InputError(f"{stream}: {missing[0]} is missing, expected {', '.join(known)}")
    if unknown := [name for name in given if name not in known]:
        raise InputError(
            f"{stream}: {shorten(unknown[0])} is unknown, expected one of {', '.join(known)}"
        )
    count = np.size(given["time_s"]) if "time_s" in given else np.size(given["x_m"])
    found: dict[str, Any] = {}
    for name, value in given.items():
        try:
            column = np.asarray(value)
        except ValueError:
            raise RecordError(stream, None, f"{name} is no column of {count} values") from None
        if column.ndim == 0:
            column = np.full(count, value)
        if column.shape != (count,):
            raise RecordError(stream, None, f"{name} has shape {column.shape}, expected {(count,)}")
        if column.dtype.kind not in "iuf" and name not in LABELS:
            raise RecordError(stream, None, f"{name} is not numeric")
        found[name] = column if name in LABELS else column.astype(float)
    return found


def _single(given: Columns, name: str) -> float:
    value = np.unique(np.asarray(given[name], dtype=float))
    if len(value) != 1:
        raise InputError(f"odometry: {name} changes, expected one number")
    return float(value[0])
