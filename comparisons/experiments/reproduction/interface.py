"""What a reproduced figure is made of: an experiment, a drawing, and claims with numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.errors import InputError

AT_MOST: Literal["at most"] = "at most"
AT_LEAST: Literal["at least"] = "at least"
SHARE_WITHIN_3_SIGMA, THREE_SIGMA_SQUARED = 0.989, 9.0
"""Of a Gaussian in the plane: the share within 3 sigma, and the squared distance there."""
DATA_FOLDERS = ("victoria_park", "acfr_car_park", "mrclam")
"""Of --data: public logs that are no part of this project."""


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
        if self.drives < 1:
            raise InputError(f"--drives is {self.drives}, expected 1 or more")
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


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One thing that a document says, as a number with a limit.

    text: what is claimed, and of what the number is. why: where it is not met, what is different
    here, as far as known.
    """

    text: str
    measured: float
    relation: Literal["at most", "at least"]
    limit: float
    unit: str = ""
    why: str = ""

    @property
    def holds(self) -> bool:
        """A number that is not finite meets no limit."""
        if not math.isfinite(self.measured):
            return False
        if self.relation == AT_MOST:
            return self.measured <= self.limit
        return self.measured >= self.limit


def at_most(text: str, measured: float, limit: float, unit: str = "", why: str = "") -> Claim:
    """A claim whose number must not be larger than the limit."""
    return Claim(
        text=text, measured=float(measured), relation=AT_MOST, limit=limit, unit=unit, why=why
    )


def at_least(text: str, measured: float, limit: float, unit: str = "", why: str = "") -> Claim:
    """A claim whose number must not be smaller than the limit."""
    return Claim(
        text=text, measured=float(measured), relation=AT_LEAST, limit=limit, unit=unit, why=why
    )


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
    it cannot run. takes: those that it reads besides, where they are given. library: one of
    graphslam.scan.libraries without which it cannot run.
    """

    name: str
    run: Callable[[Sources], D]
    needs: str | None = None
    takes: tuple[str, ...] = ()
    library: str | None = None

    @property
    def reads(self) -> set[str]:
        """All of DATA_FOLDERS that it may read."""
        return {*self.takes, *(() if self.needs is None else (self.needs,))}


@dataclass(frozen=True, kw_only=True)
class Figure(Generic[D]):
    """One row of the catalogue.

    name: as on the command line, the document's initial and the figure's number. title: what is
    shown. source: document and place. says: what the document claims by it, in our words.
    draw: draws on an empty figure of `size` inches and computes nothing. claims: what is claimed,
    with the numbers of the experiment.
    """

    name: str
    title: str
    source: str
    says: str
    experiment: Experiment[D]
    draw: Callable[[Canvas, D], None]
    claims: Callable[[D], list[Claim]]
    size: tuple[float, float] = (9.0, 4.6)

    def judged(self, data: D) -> tuple[Claim, ...]:
        """The claims; a number that cannot be had is not finite, and its claim does not hold."""
        with np.errstate(all="ignore"):
            return tuple(self.claims(data))


AnyFigure = Figure[Any]


@dataclass(frozen=True, kw_only=True)
class Reproduced:
    """A figure that was drawn. seconds: of the experiment, which `shared` figures have in common.

    cpu_s: of the processor, all threads of the process that ran it (time.process_time).
    png, pdf: the pictures.
    """

    figure: AnyFigure
    claims: tuple[Claim, ...]
    log: str
    seconds: float
    cpu_s: float
    shared: tuple[str, ...]
    png: bytes
    pdf: bytes

    @property
    def holds(self) -> bool:
        """All claims do."""
        return all(claim.holds for claim in self.claims)


@dataclass(frozen=True)
class Skipped:
    """A figure that was not drawn, and what it would take."""

    figure: AnyFigure
    reason: str
