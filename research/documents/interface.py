"""What a reproduced figure is made of: an experiment, a drawing, and claims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.errors import InputError, quoted
from comparisons.figures import Aside
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from research.documents.claims import Claim, Claims

DATA_FOLDERS = ("victoria_park", "acfr_car_park", "mrclam")
"""Of --data: public logs that are no part of this project."""
_DOCUMENTS = {"G": "Guivant et al. 2002", "M": "Misono et al. 2007", "N": "Nieto 2005"}


MOST_DRIVES = 10_000


@dataclass(frozen=True)
class Sources:
    """What experiments may draw on.

    data: a folder with some of DATA_FOLDERS. drives: simulated drives behind a claim that one
    drive cannot show; their seeds begin at 0.
    """

    data: Path | None = None
    drives: int = 10

    def __post_init__(self) -> None:
        """Raises InputError."""
        if not 1 <= self.drives <= MOST_DRIVES:
            raise InputError(f"--drives is {quoted(self.drives)}, expected 1 to {MOST_DRIVES}")
        if self.data is None:
            return
        if not self.data.is_dir():
            raise InputError(f"{self.data}: is no folder, expected one with the real logs")
        if not any((self.data / name).is_dir() for name in DATA_FOLDERS):
            wanted = " or ".join(f"{name}/" for name in DATA_FOLDERS)
            raise InputError(f"{self.data}: holds none of the real logs, expected {wanted}")

    def folder(self, name: str) -> Path | None:
        """One of DATA_FOLDERS, None where it is not given."""
        found = None if self.data is None else self.data / name
        return found if found is not None and found.is_dir() else None

    def log(self, name: str) -> Log:
        """The log of one of DATA_FOLDERS. Raises InputError where it is not given."""
        folder = self.folder(name)
        if folder is None:
            raise InputError(f"needs --data FOLDER with {name}/")
        return open_log(str(folder))


class Data(Protocol):
    """What an experiment leaves. log: the log or logs that it ran on, in words."""

    @property
    def log(self) -> str:
        """In words."""
        ...


D = TypeVar("D", bound=Data)


@dataclass(frozen=True)
class Experiment(Generic[D]):
    """One computation that several figures may share.

    run: computes and draws nothing; raises InputError. needs: one of DATA_FOLDERS without which
    it cannot run.
    """

    name: str
    run: Callable[[Sources], D]
    needs: str | None = None


@dataclass(frozen=True, kw_only=True)
class DocumentFigure(Generic[D]):
    """One row of the catalogue.

    name: as on the command line, the document's initial and the figure's number. title: what is
    shown. says: what the document claims by it, in our words; with the title it describes the two
    functions. draw: draws on an empty figure of `size` inches and computes nothing. claims: what is
    claimed, with the numbers of the experiment. place: of the figure in the document, where that is
    not its number alone.
    """

    name: str
    title: str
    says: str
    experiment: Experiment[D]
    draw: Callable[[Canvas, D], None]
    claims: Callable[[D], Claims]
    size: tuple[float, float] = (9.0, 4.6)
    place: str = ""

    @property
    def source(self) -> str:
        """Document and place."""
        return f"{_DOCUMENTS[self.name[0]]}, {self.place or f'Fig. {self.name[1:]}'}"

    def judged(self, data: D) -> tuple[Claim, ...]:
        """The claims; a number that cannot be had is not finite, and its claim does not hold."""
        with np.errstate(all="ignore"):
            return tuple(self.claims(data))


AnyFigure = DocumentFigure[Any]


@dataclass(frozen=True, kw_only=True)
class FigureResult:
    """A figure of a document.

    Attributes:
        name: name of the figure, as `python -m research.documents` takes it.
        title: its title.
        source: where the document has it.
        says: what the document says.
        log: log on which it was run.
        seconds: wall time of its experiment, which the figures in `shared` have in common.
        cpu_s: processor time of it, all threads of its process.
        shared: figures of the same experiment.
        holds: whether all its claims hold.
        claims: its claims.
        png: as it was drawn; no part of a result file.
        pdf: likewise.
    """

    name: str
    title: str
    source: str
    says: str
    log: str
    seconds: float
    cpu_s: float | None = None
    shared: tuple[str, ...]
    holds: bool
    claims: tuple[Claim, ...]
    png: Aside[bytes]
    pdf: Aside[bytes]


@dataclass(frozen=True)
class SkippedResult:
    """A figure that was asked for and not run.

    Attributes:
        name: name of the figure.
        title: its title.
        source: where the document has it.
        reason: why it was not run.
    """

    name: str
    title: str
    source: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class ReproductionResult:
    """`claims.json`: figures of the documents and their claims.

    Attributes:
        holds: whether every claim of every figure that was run holds.
        drives: simulated drives of a claim on averages.
        seconds: wall time of all.
        cpu_s: processor time of all experiments, whichever process ran them.
        figures: figures that were run.
        skipped: figures that were not run.
        versions: versions of the packages.
    """

    holds: bool
    drives: int
    seconds: float
    cpu_s: float | None = None
    figures: tuple[FigureResult, ...]
    skipped: tuple[SkippedResult, ...]
    versions: dict[str, str]
