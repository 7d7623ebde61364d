"""A log on disk: `log.toml`, one CSV per stream, one `.npz` for scans. Read and write.

Numbers are written so that they read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from comparisons.archive import Shape, read_archive
from comparisons.arrays import Array, symmetric, upper_triangles
from comparisons.atomic import fresh_folder
from comparisons.errors import InputError, RecordError, naming, outdated_format
from comparisons.logs.from_arrays import COVARIANCE, GAPS, KINDS, MEASUREMENTS, VARIANCES
from comparisons.logs.log import (
    LandmarkMeasurements,
    Landmarks,
    Log,
    LoopClosures,
    Poses,
    Positions,
    Prior,
    Surfaces,
    Truth,
)
from comparisons.logs.log_meta import (
    MARK,
    LogModel,
    MeasurementsModel,
    RelativeModel,
    ScansModel,
    SteeringModel,
    meta_text,
    read_meta,
)
from comparisons.logs.odometry import (
    Ackermann,
    Odometry,
    OdometryNoise,
    RelativePoses,
    SteeringOdometry,
    VelocityOdometry,
)
from comparisons.logs.scans import Clouds, Mount, Scans
from comparisons.logs.stamps import origin, since_origin
from comparisons.logs.table import TextTable
from comparisons.logs.validation import whole_numbers

T = TypeVar("T")
SEE = "see docs/formats.md"
_MEASUREMENTS = (*MEASUREMENTS, "landmark", "diameter_m")
_LANDMARKS, _POSITIONS = ((name, "x_m", "y_m", *VARIANCES) for name in ("id", "time_s"))
_POSES = ("time_s", *KINDS["poses"])
_SURFACES = ("x1_m", "y1_m", "x2_m", "y2_m")
_RELATIVE = ("time_s", *KINDS["relative-poses"], *COVARIANCE)
_ODOMETRY = {kind: ("time_s", *names) for kind, names in KINDS.items()} | {
    "relative-poses": _RELATIVE
}
_SCANS: dict[str, Shape] = {
    "time_s": ("N",),
    "angle_rad": ("B",),
    "range_m": ("N", "B"),
    "intensity": ("N", "B"),
}
_CLOUDS: dict[str, Shape] = {
    "time_s": ("N",),
    "first": ("N + 1",),
    "point_m": ("P", 3),
    "point_s": ("P",),
}
_CLOSURES = ("from_s", "to_s", *_RELATIVE[1:])


def recognises(path: Path) -> bool:
    """Whether a path is a log folder, or its `log.toml`."""
    return (_folder(path) / MARK).is_file()


def read(path: Path) -> Log:
    """Read the folder; faults of its content name the page on the format. Raises InputError."""
    try:
        return read_log_folder(_folder(path))
    except InputError as error:
        raise InputError(f"{error} ({SEE})") from None


def _folder(path: Path) -> Path:
    return path.parent if path.name == MARK and path.is_file() else path


def read_log_folder(folder: Path) -> Log:
    """Read a log folder. Raises InputError naming file, line, value and expectation."""
    _check_names(folder)
    meta = read_meta(folder / MARK)
    start_s, provenance = origin(meta.prior.time_s), meta.provenance

    def part(
        name: str, columns: tuple[str, ...], record: Callable[[TextTable], T], **more: Any
    ) -> T | None:
        """A file's record; None where there is no such file."""
        if not (folder / name).exists():
            return None
        table = TextTable(folder / name, columns, comma=True, header=True, start_s=start_s, **more)
        with table.locating():
            return record(table)

    def measured(kind: str, settings: MeasurementsModel) -> LandmarkMeasurements | None:
        def record(table: TextTable) -> LandmarkMeasurements:
            columns: dict[str, Any] = {name: table[name] for name in table.columns}
            return LandmarkMeasurements(**columns, **settings.model_dump())

        name = f"{kind}measurements.csv"
        return part(name, _MEASUREMENTS, record, gaps=GAPS, optional=("intensity",))

    truth = Truth(
        part("truth_poses.csv", _POSES, lambda t: Poses(t["time_s"], t.data[:, 1:])),
        part("truth_landmarks.csv", _LANDMARKS, _landmarks),
        part("truth_surfaces.csv", _SURFACES, lambda t: Surfaces(t.data)),
    )
    positions = part(
        "positions.csv",
        _POSITIONS,
        lambda t: Positions(
            t["time_s"], t.data[:, 1:3], symmetric(t.data[:, 3:]), meta.positions.antenna_m
        ),
    )
    closures = part(
        "closures.csv",
        _CLOSURES,
        lambda t: LoopClosures(t["from_s"], t["to_s"], t.data[:, 2:5], symmetric(t.data[:, 5:])),
    )
    measurements = measured("", meta.measurements)
    if measurements is None:
        raise InputError(f"{folder / 'measurements.csv'}: no such file")
    odometry = _read_odometry(folder / "odometry.csv", meta, start_s)

    def rest(time_s: Array) -> Array:
        """Count times, that no decimals tell of, from the log's start."""
        instants_s = np.union1d(odometry.time_s, measurements.time_s)
        return since_origin(time_s, start_s, instants_s) if start_s and len(instants_s) else time_s

    if start_s:
        provenance = {**provenance, "time_origin_s": str(start_s)}
    prior_s = float(rest(np.array([meta.prior.time_s]))[0])
    with naming(folder, RecordError):
        return Log(
            name=meta.name,
            format="log-folder",
            prior=Prior(prior_s, np.array(meta.prior.pose), np.array(meta.prior.covariance)),
            odometry=odometry,
            measurements=measurements,
            positions=positions,
            loop_closures=closures,
            known_landmarks=part("known_landmarks.csv", _LANDMARKS, _landmarks),
            known_measurements=measured("known_", MeasurementsModel()),
            scans=_read_scans(folder / "scans.npz", rest, meta.scans),
            clouds=_read_clouds(folder / "clouds.npz", rest),
            truth=truth,
            provenance=provenance,
        )


def write_log_folder(
    log: Log, folder: str | Path, remarks: Mapping[str, str] | None = None
) -> None:
    """Write a log into a new or empty folder, which appears whole or not at all.

    Args:
        log: What to write.
        folder: Where (docs/formats.md says what stands in each file).
        remarks: Comments in `log.toml`, by key.

    Raises:
        InputError: Something is there already: a log may be the only copy of its data.
    """
    with fresh_folder(Path(folder)) as work:
        _write_odometry(work / "odometry.csv", log.odometry)
        _write_measurements(work / "measurements.csv", log.measurements)
        if log.known_measurements is not None:
            _write_measurements(work / "known_measurements.csv", log.known_measurements)
        if (p := log.positions) is not None:
            _write_csv(work / "positions.csv", _POSITIONS, p.time_s, p.position_m, p.covariance)
        if (c := log.loop_closures) is not None:
            parts = c.from_s, c.to_s, c.displacement, c.covariance
            _write_csv(work / "closures.csv", _CLOSURES, *parts)
        maps = {"known_landmarks": log.known_landmarks, "truth_landmarks": log.truth.landmarks}
        for name, m in maps.items():
            if m is not None:
                _write_csv(work / f"{name}.csv", _LANDMARKS, m.id, m.position_m, m.covariance)
        if (t := log.truth.poses) is not None:
            _write_csv(work / "truth_poses.csv", _POSES, t.time_s, t.pose)
        if log.truth.surfaces is not None:
            _write_csv(work / "truth_surfaces.csv", _SURFACES, log.truth.surfaces.segment)
        if log.scans is not None:
            scans: dict[str, Array] = {name: getattr(log.scans, name) for name in _SCANS}
            np.savez_compressed(work / "scans.npz", allow_pickle=False, **scans)
        if log.clouds is not None:
            np.savez_compressed(work / "clouds.npz", **vars(log.clouds))
        (work / MARK).write_text(meta_text(log, remarks), encoding="utf-8")


def _read_odometry(path: Path, meta: LogModel, start_s: int) -> Odometry:
    settings = meta.odometry
    columns = _ODOMETRY[settings.kind]
    table = TextTable(path, columns, comma=True, header=True, gaps=COVARIANCE, start_s=start_s)
    with table.locating():
        if isinstance(settings, RelativeModel):
            covariance = symmetric(table.data[:, 4:])
            return RelativePoses(table["time_s"], table.data[:, 1:4], covariance)
        time_s, speed, turn = table.data.T
        noise = OdometryNoise(**settings.noise.model_dump())
        if isinstance(settings, SteeringModel):
            vehicle = Ackermann(**settings.vehicle.model_dump())
            return SteeringOdometry(time_s, speed, turn, vehicle, noise)
        return VelocityOdometry(time_s, speed, turn, noise)


def _write_odometry(path: Path, odometry: Odometry) -> None:
    if isinstance(odometry, RelativePoses):
        parts = odometry.time_s, odometry.displacement, odometry.covariance
        _write_csv(path, _RELATIVE, *parts)
    else:
        kind = "steering" if isinstance(odometry, SteeringOdometry) else "velocity"
        _write_csv(path, _ODOMETRY[kind], odometry.time_s, *odometry.controls)


def _check_names(folder: Path) -> None:
    """Raise InputError for measurements by the name that the release 0.1 gave their file."""
    for kind in ("", "known_"):
        path = folder / f"{kind}sightings.csv"
        if path.exists() and not (folder / f"{kind}measurements.csv").exists():
            mend = f"call it {kind}measurements.csv, and [sightings] in {MARK} [measurements]"
            raise outdated_format(path, "the name of slamcheck 0.1 for a log's measurements", mend)


def _write_measurements(path: Path, s: LandmarkMeasurements) -> None:
    names = _MEASUREMENTS if np.isnan(s.intensity).all() else (*_MEASUREMENTS, "intensity")
    _write_csv(path, names, *(getattr(s, name) for name in names))


def _landmarks(table: TextTable) -> Landmarks:
    ids = whole_numbers("landmarks", "id", table["id"])
    return Landmarks(ids, table.data[:, 1:3], symmetric(table.data[:, 3:]))


def _read_scans(path: Path, rest: Callable[[Array], Array], settings: ScansModel) -> Scans | None:
    if not path.exists():
        return None
    found: dict[str, Any] = dict(zip(_SCANS, read_archive(path, _SCANS), strict=True))
    found["time_s"] = rest(found["time_s"])
    mount = Mount(settings.forward_m, settings.left_m, settings.heading_rad)
    with naming(path, RecordError):
        return Scans(**found, mount=mount, beam_s=settings.beam_s)


def _read_clouds(path: Path, rest: Callable[[Array], Array]) -> Clouds | None:
    if not path.exists():
        return None
    time_s, first, point_m, point_s = read_archive(path, _CLOUDS)
    with naming(path, RecordError):
        return Clouds(rest(time_s), whole_numbers("clouds", "first", first), point_m, point_s)


def _write_csv(path: Path, columns: tuple[str, ...], *parts: Array | np.ndarray) -> None:
    """Write columns (N,), tables (N, d), and the upper triangles of covariances (N, d, d)."""
    flat = [upper_triangles(part) if part.ndim == 3 else part for part in parts]
    lists = [column.tolist() for part in flat for column in np.atleast_2d(part.T)]
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        file.writelines(",".join(map(repr, row)) + "\n" for row in zip(*lists, strict=True))
