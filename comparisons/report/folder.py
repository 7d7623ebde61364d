"""The folder that a job leaves, whichever the job: it appears whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.atomic import LIST, fresh_folder
from comparisons.figures import json_text, stored

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from comparisons.config import JobConfig
    from comparisons.estimates.estimate import Estimate

CONFIG = "config.toml"


@dataclass(frozen=True, kw_only=True)
class JobFolder:
    """What goes into it.

    name: of the result's file, without suffix. result: has `files`, the names of all that
    the folder holds, which are filled in last. config: None of a job that no file repeats.
    estimates: by folder. figures: by name without suffix, in formats as picture.save takes them.
    files: others by name, each written by a function that is given its path, in the end.
    """

    name: str
    result: object
    config: JobConfig | None = None
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    figures: Mapping[str, Figure] = field(default_factory=dict)
    formats: Collection[str] = ()
    files: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


def write_job_folder(content: JobFolder, folder: Path) -> None:
    """Write everything; the result's file names all others. Raises InputError."""
    file = f"{content.name}.json"
    with fresh_folder(folder, file if content.config is None else CONFIG) as work:
        _write(content.estimates, work)
        _save(content.figures, work, content.formats)
        if content.config is not None:
            (work / CONFIG).write_text(content.config.toml(), encoding="utf-8")
        for name, write in content.files.items():
            write(work / name)
        found = stored(content.result)
        files = sorted(p.relative_to(work).as_posix() for p in work.rglob("*") if p.is_file())
        found["files"] = sorted([*files, file, LIST])
        (work / file).write_text(json_text(found, indent=2) + "\n", encoding="utf-8")


def _write(estimates: Mapping[str, Estimate], folder: Path) -> None:
    if estimates:
        from comparisons.estimates.folder import write_estimate  # an audit has no estimate

        for name, estimate in estimates.items():
            (folder / name).mkdir()
            write_estimate(estimate, folder / name)


def _save(figures: Mapping[str, Figure], folder: Path, formats: Collection[str]) -> None:
    if figures:
        from comparisons.report.picture import save  # matplotlib takes long to load

        for name, figure in figures.items():
            save(figure, folder / f"{name}.png", formats)
