"""The Monte Carlo job: chunks of runs through filters, kept as they finish."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import CHUNK, ChunkFiles
from comparisons.experiments.montecarlo.runs import FILTERS, Records, recorded_steps, run_filter
from comparisons.experiments.montecarlo.statistics import (
    FilterFigures,
    Pair,
    compare_pairs,
    figures_of,
    tally,
)
from comparisons.experiments.montecarlo.workers import spread
from comparisons.experiments.scenarios.scenario import Scenario
from comparisons.experiments.scenarios.world import World, build_world, measure

_EDITION = 1
"""Part of every chunk's origin; to be raised when a filter or the simulation changes."""


@dataclass(frozen=True)
class Study:
    """What is asked for. filters: names of FILTERS. Run number = seed, from 0.

    place: where the scenario was read, for errors.
    """

    name: str
    scenario: Scenario
    runs: int = 50
    filters: tuple[str, ...] = tuple(FILTERS)
    place: str = "scenario"

    def __post_init__(self) -> None:
        """Check the choices."""
        if not 1 <= self.runs <= 1_000_000:
            raise InputError(f"--runs is {self.runs}, expected 1 to 1000000")
        unknown = [name for name in self.filters if name not in FILTERS]
        if unknown or not self.filters:
            told = f"filter '{unknown[0]}' is unknown" if unknown else "--filters names none"
            raise InputError(f"{told}, expected some of {','.join(FILTERS)}")
        if len(set(self.filters)) < len(self.filters):
            raise InputError("--filters names a filter twice")

    @property
    def sha256(self) -> str:
        """Of the scenario's figures, not its words."""
        figures = self.scenario.model_dump_json(exclude={"description", "from_paper", "ours"})
        return hashlib.sha256(f"{_EDITION} {figures}".encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """figures: by filter. computed: chunks that were not yet there. damaged: files replaced."""

    study: Study
    time_s: np.ndarray[tuple[int], np.dtype[np.float64]]
    landmarks: int
    figures: dict[str, FilterFigures]
    pairs: list[Pair]
    computed: int
    damaged: int


def run_study(
    study: Study,
    folder: Path,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Outcome:
    """Compute what the folder does not hold yet; figures over all runs. Raises InputError."""
    if workers < 1:
        raise InputError(f"--workers is {workers}, expected 1 or more")
    world = build_world(study.scenario, study.place)
    steps = recorded_steps(study.scenario.steps)
    files = ChunkFiles(folder, study.sha256, len(steps))
    chunks = range(-(-study.runs // CHUNK))
    wanted, damaged = [], 0
    for chunk in chunks:
        for name in study.filters:
            if files.read(name, chunk) is None:
                damaged += files.path(name, chunk).exists()
                wanted.append((name, chunk))
    total = len(chunks) * len(study.filters)
    done = total - len(wanted)
    progress("runs", done, total)
    tasks = [(name, world, chunk) for name, chunk in wanted]
    for place, records in spread(run_chunk, tasks, workers, scheduler):
        files.write(*wanted[place], records)
        done += 1
        progress("runs", done, total)
    kept = {name: tally(_finished(files, name, study.runs)) for name in study.filters}
    return Outcome(
        study,
        study.scenario.step_s * np.array(steps, dtype=float),
        len(world.landmark),
        {name: figures_of(of_filter) for name, of_filter in kept.items()},
        compare_pairs(kept),
        len(wanted),
        damaged,
    )


def run_chunk(name: str, world: World, chunk: int) -> Records:
    """The records (CHUNK, T) of one chunk; the same wherever it is computed."""
    with np.errstate(all="ignore"):
        runs = range(chunk * CHUNK, (chunk + 1) * CHUNK)
        return run_filter(name, world, measure(world, runs))


def _finished(files: ChunkFiles, name: str, runs: int) -> Iterator[Records]:
    """The records of the first runs, chunk by chunk."""
    for chunk in range(-(-runs // CHUNK)):
        records = files.read(name, chunk)
        if records is None:
            raise InputError(f"{files.path(name, chunk)}: was changed while the study ran")
        yield Records(*(r[: runs - chunk * CHUNK] for r in records))
