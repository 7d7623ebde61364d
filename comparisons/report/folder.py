"""The folder that a job leaves, whichever the job: it appears whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from matplotlib.figure import Figure
from pydantic import BaseModel

from comparisons.atomic import check_replaceable, fresh_folder
from comparisons.config import JobConfig
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.folder import write_estimate
from comparisons.report.picture import save

CONFIG = "config.toml"
_RESULTS = ("result", "solution", "check", "odometry", "map")


@dataclass(frozen=True, kw_only=True)
class JobFolder:
    """What goes into it.

    name: of the result's file, without suffix. result: a model with `files`, the names of all that
    the folder holds, which are filled in last. estimates: by folder. figures: by name without
    suffix. files: others by name, each written by a function that is given its path, in the end.
    """

    name: str
    result: BaseModel
    config: JobConfig
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


def write_job_folder(content: JobFolder, folder: Path, formats: Collection[str] = ()) -> None:
    """Write everything. Raises InputError.

    formats: of the pictures; see picture.save. The result's file lists all others, so that the
    next run knows which folder it may replace.
    """
    with fresh_folder(folder, known_files(folder)) as work:
        for name, estimate in content.estimates.items():
            (work / name).mkdir()
            write_estimate(estimate, work / name)
        for name, figure in content.figures.items():
            save(figure, work / f"{name}.png", formats)
        (work / CONFIG).write_text(content.config.toml(), encoding="utf-8")
        for name, write in content.files.items():
            write(work / name)
        result = work / f"{content.name}.json"
        found = content.result.model_dump(mode="json")
        files = sorted(p.relative_to(work).as_posix() for p in work.rglob("*") if p.is_file())
        found["files"] = sorted([*files, result.name])
        result.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def known_files(folder: Path) -> frozenset[str]:
    """What an earlier job left in a folder, by its own account; empty where there is none."""
    for name in _RESULTS:
        try:
            found = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
            return frozenset(str(file) for file in found["files"])
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            continue
    return frozenset()


def check_free(folder: Path) -> None:
    """Raise InputError where a folder may not be written, before the work."""
    check_replaceable(folder, known_files(folder))
