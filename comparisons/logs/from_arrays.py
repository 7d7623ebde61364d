"""A log from a user's own arrays, named as the columns of a log folder; see `Log.from_arrays`."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from comparisons.arrays import Array, symmetric
from comparisons.errors import InputError, RecordError, shorten
from comparisons.logs.log import NO_LANDMARK, Columns, Ids, Log, Poses, Prior, Truth
from comparisons.logs.odometry import (
    NOISE_TEXT,
    Ackermann,
    Odometry,
    OdometryNoise,
    RelativePoses,
    displacements,
    instants_of,
    poses_at,
)
from comparisons.logs.odometry_noise import added_between, reckoned_motion
from comparisons.logs.records import record_of
from comparisons.logs.schema import (
    COLUMNS,
    COVARIANCE,
    KINDS,
    POSES,
    RELATIVE,
    STREAMS,
    TWIST,
    LogStream,
)
from comparisons.logs.stamps import resolved
from comparisons.logs.validation import refuse_outside, standard_deviation, whole_numbers
from graphslam.increments import dead_reckoned

PRIOR_VARIANCE = 1e-6
_UNKNOWN = ("", "nan", "na", "none", "null", "unknown")
"""What stands, in either case, for a landmark that is not known."""
LABELS = tuple(name for name, column in COLUMNS.items() if column.is_label)
_NOISE = ("variance_rate_position", "variance_rate_heading")

Motion = tuple[Odometry, float, str | None]
"""Odometry, when it starts, and words on the noise of relative poses."""


def log_from_arrays(
    odometry: Columns, streams: Mapping[str, Columns | None], prior: Prior | None, name: str
) -> Log:
    """See Log.from_arrays. streams: the others, by their arguments there."""
    for what, columns in (("odometry", odometry), ("measurements", streams["measurements"])):
        if not isinstance(columns, Mapping):
            raise InputError(f"{what}: is a {type(columns).__name__}, expected columns by name")
    tables = {
        stream: _stream_columns(stream, columns)
        for stream in STREAMS
        if (columns := streams.get(stream.argument)) is not None
    }
    numbers = LandmarkNumbers(*(table.get(label) for table in tables.values() for label in LABELS))
    with_poses = "x_m" in odometry
    records: dict[str, Any] = {}
    for stream, table in tables.items():
        if with_poses and stream.is_timed:  # a pose is needed at every instant of a record
            table["time_s"] = resolved(table["time_s"])
        records[stream.field] = _record(stream, table, numbers)
    timed = [stream.field for stream in tables if stream.is_timed]
    moved, start_s, noise = _motion(
        odometry, np.concatenate([records[field].time_s for field in timed])
    )
    for field in timed:
        if with_poses and field != "measurements":
            at_poses = np.isin(records[field].time_s, (start_s, *moved.time_s))
            records[field] = records[field].chosen(at_poses)
    poses = records.pop("truth.poses", None)
    truth = Truth(poses, records.pop("truth.landmarks", None))
    provenance = {} if noise is None else {"odometry_noise": noise}
    if numbers.by_text:
        provenance["labels"] = numbers.text()
    return Log(
        name=name,
        format="arrays",
        prior=prior or default_prior(start_s, poses),
        odometry=moved,
        truth=truth,
        provenance=provenance,
        **records,
    )


def default_prior(start_s: float, truth: Poses | None) -> Prior:
    """Where the truth is at the start, the origin where that is unknown; exact to 1 mm, 1 mrad."""
    pose = np.zeros(3)
    if truth is not None and truth.time_s[0] <= start_s <= truth.time_s[-1]:
        pose = truth.at(np.array([start_s]))[0]
    return Prior(start_s, pose, PRIOR_VARIANCE * np.eye(3))


def odometry_kinds(names: Collection[str]) -> list[str]:
    """Return the kinds of odometry that columns are enough for."""
    return [kind for kind, table in KINDS.items() if set(table.values) <= set(names)]


def odometry_kind(names: Sequence[str]) -> str:
    """The kind that columns are of. Raises InputError where that is none or not certain."""
    kinds = odometry_kinds(names)
    if len(kinds) == 1:
        return kinds[0]
    choices = "; ".join(f"{', '.join(table.values)} ({kind})" for kind, table in KINDS.items())
    if kinds:
        raise InputError(f"odometry: holds {' and '.join(kinds)}, expected one of these kinds")
    raise InputError(f"odometry: columns are {', '.join(names)}, expected time_s and {choices}")


def _motion(given: Columns, wanted_s: Array) -> Motion:
    """Odometry of any kind; wanted_s: (M,) instants at which a pose is needed."""
    kind = odometry_kind([name for name in given if name != "time_s"])
    declared = KINDS[kind]
    needed, stated = declared.needed, declared.stated
    if kind == "poses":
        table = _columns("odometry", given, needed, (*stated, *COVARIANCE, *TWIST))
        table["time_s"] = resolved(table["time_s"])
        return _between_poses(_poses("odometry", table), table, wanted_s)
    if kind == "relative-poses":
        return _relative(_columns("odometry", given, needed, (*stated, *COVARIANCE)))
    measures = tuple(one.name for one in fields(Ackermann)) if kind == "steering" else ()
    needed += tuple(name for name in stated if name not in measures)
    table = _columns("odometry", given, needed, _NOISE + measures)
    if kind == "steering" and "wheelbase_m" not in given:
        raise InputError("odometry: wheelbase_m is missing, which steering needs")
    noise = OdometryNoise(
        *(_single(given, name) for name in ("sigma_speed_mps", "sigma_turn")),
        **{name: _single(given, name) for name in _NOISE if name in given},
    )
    settings: dict[str, Any] = {"noise": noise}
    if kind == "steering":
        vehicle = {name: _single(given, name) for name in measures if name in given}
        settings["vehicle"] = Ackermann(**vehicle)
    moved: Odometry = record_of(declared, table, **settings)
    return moved, float(moved.time_s[0]) if len(moved.time_s) else 0.0, None


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
    moved = np.column_stack([table[name] for name in RELATIVE.values])
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


def _stream_columns(stream: LogStream, given: Columns) -> dict[str, Any]:
    """The columns of a stream, of one kind, and the covariances of sigmas or of what is exact."""
    (table,) = stream.tables
    covariance = next((part for part in table.fields if part.is_covariance), None)
    needed = table.needed
    sigmas = [one for one in table.others if one.stated is not None and one.name in given]
    if covariance is not None and not stream.is_truth:
        needed += tuple(column.name for column in sigmas or covariance.columns)
    singles = [column for part in table.fields if len(part.shape) == 1 for column in part.columns]
    optional = [column.name for column in singles if column.is_optional]
    columns = _columns(stream.spoken, given, needed, optional)
    if covariance is None:
        return columns
    unit = np.eye(int(covariance.shape[1]))
    if stream.is_truth:
        columns[covariance.name] = np.zeros((len(columns[needed[0]]), *unit.shape))
    for sigma in sigmas:
        values = columns[sigma.name]
        refuse_outside(stream.spoken, sigma.name, values, sigma.limits)
        columns[covariance.name] = values[:, None, None] ** 2 * unit
    return columns


def _record(stream: LogStream, columns: dict[str, Any], numbers: LandmarkNumbers) -> Any:
    """A stream's record, its landmarks by number."""
    (table,) = stream.tables
    if table is POSES:
        return _poses(stream.spoken, columns)
    try:
        for label in [column.name for column in table.columns if column.is_label]:
            count = len(columns[table.needed[0]])
            names = columns.get(label, np.full(count, NO_LANDMARK))
            columns[label] = numbers.of(names, stream.spoken, label)
        return record_of(table, columns)
    except RecordError as error:
        raise RecordError(stream.spoken, error.row, error.fault) from None


def _poses(stream: str, columns: dict[str, Any]) -> Poses:
    if not len(columns["time_s"]):
        raise InputError(f"{stream}: holds no poses, expected at least one")
    try:
        poses: Poses = record_of(POSES, columns)
    except RecordError as error:
        raise RecordError(stream, error.row, error.fault) from None
    return poses


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
        is_label = name in LABELS
        if column.dtype.kind not in "iuf" and not is_label:
            raise RecordError(stream, None, f"{name} is not numeric")
        found[name] = column if is_label else column.astype(float)
    return found


def _single(given: Columns, name: str) -> float:
    value = np.unique(np.asarray(given[name], dtype=float))
    if len(value) != 1:
        raise InputError(f"odometry: {name} changes, expected one number")
    return float(value[0])
