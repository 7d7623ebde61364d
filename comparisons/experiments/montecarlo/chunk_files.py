"""Finished chunks on disk, one file per filter and chunk, so that a killed job goes on."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from comparisons.archive import read_entries
from comparisons.atomic import OWN, check_above, free_beside, is_unfinished, write_whole
from comparisons.errors import InputError
from comparisons.experiments.montecarlo.config import is_config
from comparisons.experiments.montecarlo.runs import RunRecords
from comparisons.logs.table import read_toml

CHUNK = 25
"""Runs of a chunk. It is computed whole even where fewer are asked for, so that a run's figures do
not depend on how many there are, nor on who computes them."""

CONFIG = "config.toml"
LOGS = "logs"
"""Folder of runs' logs that are kept, by seed, and of what failed filters said."""
_REPORTS = frozenset({CONFIG, "montecarlo.json", "curves.png", "report.html", "runs.csv"})
_SHA256 = "sha256"
_ENTRIES = (_SHA256, *RunRecords._fields)
_MOST_BYTES = 2**24
"""Of a chunk: at most 500 steps are recorded, whichever the study, in less than a megabyte."""
_NAME = re.compile(r"[a-z][a-z0-9_-]*-\d{6}\.npz")


def check_folder(folder: Path) -> None:
    """Raises InputError where a study must not be written: other files than a study's are there."""
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file, expected a folder to write")
        if folder.name == ".." and not folder.exists():
            raise InputError(f"{folder}: no such folder")
        check_above(folder / CONFIG)
        _check_reports(folder)
        chunks = folder / "chunks"
        for path in (*_sorted(folder), *_sorted(chunks)):
            inside, name = path.parent == chunks, path.name
            ours = _NAME.fullmatch(name) if inside else name in _REPORTS
            folders = (chunks, folder / LOGS)
            right = path.is_dir() if path in folders else ours and path.is_file()
            if not right and not is_unfinished(name):  # a killed job may leave one
                raise InputError(
                    f"{folder}: already holds {path.relative_to(folder).as_posix()}; give a new "
                    "folder or empty this one"
                )
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from None


def _check_reports(folder: Path) -> None:
    """Raise InputError where reports stand beside no settings of a study, which come first."""
    found = sorted(name for name in _REPORTS if os.path.lexists(folder / name))
    if found and not is_config(str(folder / CONFIG)):
        raise InputError(
            f"{folder}: already holds {found[0]}, and no study's {CONFIG}; give a new folder"
        )


def _sorted(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


class ChunkFiles:
    """The chunks of one study. sha256: of what they were computed from."""

    def __init__(self, folder: Path, sha256: str, records: int, runs: int = CHUNK) -> None:
        """folder: the study's. records: recorded steps of a run. runs: of a file."""
        self._folder, self._sha256, self._shape = folder / "chunks", sha256, (runs, records)

    def path(self, name: str, chunk: int) -> Path:
        """Where a filter's chunk is kept."""
        return self._folder / f"{name}-{chunk:06d}.npz"

    def read(self, name: str, chunk: int) -> RunRecords | None:
        """A finished chunk; None where there is none, or a damaged one.

        Raises InputError where the file is whole but of another study.
        """
        try:
            found = read_entries(self.path(name, chunk), _ENTRIES, (_SHA256,), _MOST_BYTES)
            sha256 = str(found.pop(_SHA256))
            records = RunRecords(**found)
        except (InputError, KeyError, TypeError, ValueError):  # an entry is missing or no text
            return None
        if sha256 != self._sha256:
            folder = self._folder.parent
            path = folder / CONFIG  # of a study that was finished there
            scenario = f" ({read_toml(path).get('scenario')})" if path.is_file() else ""
            raise InputError(
                f"{folder}: its chunks are of another scenario{scenario}; give --out "
                f"{free_beside(folder)}"
            )
        if any(r.shape != self._shape or r.dtype != np.float64 for r in records):
            return None
        return records

    def write(self, name: str, chunk: int, records: RunRecords) -> None:
        """Keep a chunk; the file appears whole or not at all."""

        def save(part: Path) -> None:
            np.savez(part, allow_pickle=False, **{_SHA256: self._sha256}, **records._asdict())

        write_whole(self.path(name, chunk), save, OWN)
