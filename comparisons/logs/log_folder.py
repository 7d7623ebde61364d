"""A log on disk: `log.toml`, one CSV per stream, one `.npz` for scans. Read and write.

Numbers are written so that they read back to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.archive import read_archive
from comparisons.arrays import Array
from comparisons.atomic import fresh_folder
from comparisons.errors import InputError, RecordError, naming, outdated_format
from comparisons.logs.log import Log, Prior, Truth
from comparisons.logs.log_meta import MARK, LogModel, meta_text, read_meta
from comparisons.logs.records import columns_of, record_of
from comparisons.logs.schema import STREAMS, LogStream
from comparisons.logs.stamps import origin, since_origin
from comparisons.logs.table import TextTable
from comparisons.logs.validation import whole_numbers

SEE = "see docs/formats.md"


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
    records = {
        stream.field: _read_text(folder / stream.file, stream, meta, start_s)
        for stream in STREAMS
        if not stream.is_archived
    }

    def rest(time_s: Array) -> Array:
        """Count times, that no decimals tell of, from the log's start."""
        instants_s = np.union1d(records["odometry"].time_s, records["measurements"].time_s)
        return since_origin(time_s, start_s, instants_s) if start_s and len(instants_s) else time_s

    if start_s:
        provenance = {**provenance, "time_origin_s": str(start_s)}
    prior_s = float(rest(np.array([meta.prior.time_s]))[0])
    records |= {
        stream.field: _read_arrays(folder / stream.file, stream, meta, rest)
        for stream in STREAMS
        if stream.is_archived
    }
    streams: dict[str, Any] = {
        field: record for field, record in records.items() if "." not in field
    }
    truth: dict[str, Any] = {
        field.partition(".")[2]: record for field, record in records.items() if "." in field
    }
    with naming(folder, RecordError):
        return Log(
            name=meta.name,
            format="log-folder",
            prior=Prior(prior_s, np.array(meta.prior.pose), np.array(meta.prior.covariance)),
            truth=Truth(**truth),
            provenance=provenance,
            **streams,
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
        for stream in STREAMS:
            record = attrgetter(stream.field)(log)
            if record is None:
                continue
            if stream.is_archived:
                arrays = {part.name: getattr(record, part.name) for part in record.table.fields}
                np.savez_compressed(work / stream.file, allow_pickle=False, **arrays)
            else:
                _write_csv(work / stream.file, columns_of(record))
        (work / MARK).write_text(meta_text(log, remarks), encoding="utf-8")


def _read_text(path: Path, stream: LogStream, meta: LogModel, start_s: int) -> Any:
    """A file's record; None where there is no such file, and need not be."""
    if not stream.is_required and not path.exists():
        return None
    settings = meta.settings(stream.field)
    kind = settings.pop("kind", "")
    table = next(table for table in stream.tables if table.kind == kind)
    added = tuple(column.name for column in table.columns if column.is_added)
    text = TextTable(
        path,
        tuple(name for name in table.names if name not in added),
        comma=True,
        header=True,
        gaps=table.gaps,
        optional=added,
        starts_s=dict.fromkeys(table.times, start_s),
    )
    with text.locating():
        return record_of(table, {name: text[name] for name in text.columns}, **settings)


def _read_arrays(
    path: Path, stream: LogStream, meta: LogModel, rest: Callable[[Array], Array]
) -> Any:
    """An archive's record; None where there is no such file. rest: counts times from the start."""
    if not path.exists():
        return None
    (table,) = stream.tables
    shapes = {part.name: part.shape for part in table.fields}
    arrays: dict[str, Any] = dict(zip(shapes, read_archive(path, shapes), strict=True))
    arrays |= {name: rest(arrays[name]) for name in table.times}
    with naming(path, RecordError):
        for part in table.fields:
            if part.is_whole:
                arrays[part.name] = whole_numbers(table.name, part.name, arrays[part.name])
        return record_of(table, arrays, **meta.settings(stream.field))


def _check_names(folder: Path) -> None:
    """Raise InputError for measurements by the name that the release 0.1 gave their file."""
    for kind in ("", "known_"):
        path = folder / f"{kind}sightings.csv"
        if path.exists() and not (folder / f"{kind}measurements.csv").exists():
            mend = f"call it {kind}measurements.csv, and [sightings] in {MARK} [measurements]"
            raise outdated_format(path, "the name of slamcheck 0.1 for a log's measurements", mend)


def _write_csv(path: Path, columns: Mapping[str, list[Any]]) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        rows = zip(*columns.values(), strict=True)
        file.writelines(",".join(map(repr, row)) + "\n" for row in rows)
