"""The Monte Carlo job: chunks of runs through filters, kept as they finish."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comparisons.config import check_unchanged, full_path
from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import CHUNK, ChunkFiles
from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.montecarlo.runs import Records, recorded_steps, run_filter
from comparisons.experiments.montecarlo.statistics import (
    FilterFigures,
    Pair,
    compare_pairs,
    figures_of,
    tally,
)
from comparisons.experiments.montecarlo.workers import check_workers, spread
from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from comparisons.experiments.scenarios.world import World, build_world, measure

_EDITION = 1
"""Part of every chunk's origin; to be raised when a filter or the simulation changes."""


@dataclass(frozen=True)
class Study:
    """What is asked for, and the scenario that it names. Run number = seed, from 0."""

    config: MonteCarloConfig
    scenario: Scenario

    @property
    def name(self) -> str:
        """The scenario's."""
        path = Path(self.config.scenario)
        return path.stem if path.suffix == ".toml" else path.name

    @property
    def sha256(self) -> str:
        """Of the scenario's figures, and of the edition of what computes with them."""
        return hashlib.sha256(f"{_EDITION} {self.scenario.figures}".encode()).hexdigest()


def read_study(config: MonteCarloConfig, *, allow_changed: bool = False) -> Study:
    """Return a study of the scenario that is named, recorded with its hash and its full path.

    Raises InputError where the configuration has another scenario's hash, unless that is allowed.
    """
    scenario = read_scenario(config.scenario)
    if not allow_changed:
        option = "--allow-changed-scenario"
        check_unchanged(config.scenario, scenario.sha256, config.sha256, option)
    path = Path(config.scenario)
    full = full_path(path) if path.is_file() else config.scenario
    named = {"scenario": full, "sha256": scenario.sha256}
    return Study(config.model_copy(update=named), scenario)


@dataclass(frozen=True, kw_only=True)
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
    check_workers(workers)
    config, names = study.config, tuple[str, ...](study.config.filters)
    world = build_world(study.scenario, config.scenario)
    steps = recorded_steps(study.scenario.steps)
    files = ChunkFiles(folder, study.sha256, len(steps))
    chunks = range(-(-config.runs // CHUNK))
    wanted, damaged = [], 0
    for chunk in chunks:
        for name in names:
            if files.read(name, chunk) is None:
                damaged += files.path(name, chunk).exists()
                wanted.append((name, chunk))
    total = len(chunks) * len(names)
    done = total - len(wanted)
    progress("runs", done, total)
    tasks = [(name, world, chunk) for name, chunk in wanted]
    for place, records in spread(run_chunk, tasks, workers, scheduler):
        files.write(*wanted[place], records)
        done += 1
        progress("runs", done, total)
    kept = {name: tally(_finished(files, name, config.runs)) for name in names}
    return Outcome(
        study=study,
        time_s=study.scenario.step_s * np.array(steps, dtype=float),
        landmarks=len(world.landmark),
        figures={name: figures_of(of_filter) for name, of_filter in kept.items()},
        pairs=compare_pairs(kept),
        computed=len(wanted),
        damaged=damaged,
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
