"""The Monte Carlo job: chunks of runs through filters, kept as they finish."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from comparisons.config import check_unchanged, full_path, recorded_path
from comparisons.errors import InputError
from comparisons.experiments.montecarlo.chunk_files import CHUNK, LOGS, ChunkFiles, check_folder
from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.montecarlo.external import (
    Estimator,
    ExternalProgram,
    Failure,
    check_names,
    run_external,
)
from comparisons.experiments.montecarlo.runs import RunRecords, recorded_steps, run_filter
from comparisons.experiments.montecarlo.statistics import (
    FilterFigures,
    FilterPair,
    compare_pairs,
    figures_of,
    tally,
)
from comparisons.experiments.montecarlo.workers import check_workers, spread
from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from comparisons.experiments.scenarios.world import ScenarioWorld, build_world, log_of_run, measure
from comparisons.figures import Aside
from comparisons.logs.log_folder import write_log_folder
from comparisons.statistics import LEVEL

if TYPE_CHECKING:
    from pandas import DataFrame

_KEPT_LOGS = 3
"""Failed runs of one external filter whose logs are kept."""
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

    def log_name(self, run: int) -> str:
        """Of a run's log."""
        return f"{self.name}-{run}"

    @property
    def sha256(self) -> str:
        """Of the scenario's figures, and of the edition of what computes with them."""
        return hashlib.sha256(f"{_EDITION} {self.scenario.figures}".encode()).hexdigest()


def read_study(config: MonteCarloConfig, *, allow_changed: bool = False) -> Study:
    """Return a study of the scenario that is named, recorded with its hash and its full path.

    Raises InputError where the configuration has another scenario's hash, unless that is allowed.
    """
    scenario = read_scenario(str(recorded_path(config.scenario)))
    if not allow_changed:
        option = "--allow-changed-scenario"
        check_unchanged(config.scenario, scenario.sha256, config.sha256, option)
    path = recorded_path(config.scenario)
    full = full_path(path) if path.is_file() else config.scenario
    named = {"scenario": full, "sha256": scenario.sha256}
    return Study(config.model_copy(update=named), scenario)


@dataclass(frozen=True, kw_only=True)
class StudyOutcome:
    """Hold what many runs of several filters found, the same however the work was spread.

    Attributes:
        config: all settings; they repeat the study.
        scenario: name of the scenario.
        description: what it is.
        sha256: hash of the scenario.
        runs: number of runs.
        steps: steps of a run.
        recorded_steps: steps at which figures were recorded.
        duration_s: duration of a run.
        landmarks: landmarks of the scenario.
        level: level of bands and intervals.
        filters: each filter, by name.
        pairs: each pair of filters.
        final_map: figures of landmarks are of the last step alone, since an external filter takes
            part.
        failures: failed runs of external filters, by name.
        study: configuration and scenario; no part of `montecarlo.json`, as what follows.
        time_s: (T,) of the recorded steps.
        computed: chunks of runs that were not in the folder yet.
        damaged: files of the folder that had to be replaced.
        reused: runs of external filters that were not computed again.
    """

    config: dict[str, Any]
    scenario: str
    description: str
    sha256: str
    runs: int
    steps: int
    recorded_steps: int
    duration_s: float
    landmarks: int
    level: float = LEVEL
    filters: dict[str, FilterFigures]
    pairs: list[FilterPair]
    final_map: bool
    failures: dict[str, tuple[Failure, ...]]
    study: Aside[Study]
    time_s: Aside[np.ndarray[tuple[int], np.dtype[np.float64]]]
    computed: Aside[int]
    damaged: Aside[int]
    reused: Aside[int]

    def __repr__(self) -> str:
        """Return scenario, runs and filters in one line."""
        runs = f"{self.runs:,} runs"
        return f"<MonteCarlo of {self.scenario}: {runs}, filters {', '.join(self.filters)}>"

    def _repr_html_(self) -> str:
        shown: str = resolve_name("comparisons.experiments.montecarlo.page:framed_page")(self)
        return shown

    def to_pandas(self, table: Literal["filters", "pairs", "nees"] = "filters") -> DataFrame:
        """Return a table as a pandas data frame.

        Args:
            table: `filters`: mean NEES by block of the state with its 95 % band, and root mean
                square errors over all runs; `pairs`: every two filters, run by run; `nees`: mean
                NEES over the runs, by instant, with its 95 % band.

        Returns:
            The table, one row for each of what it lists.

        Raises:
            InputError: pandas is not installed, or there is no such table.
        """
        frame = resolve_name("comparisons.experiments.montecarlo.tables:study_frame")
        return cast("DataFrame", frame(self, table))


@dataclass(frozen=True)
class External:
    """Filters of the user's. estimators: by name. workers: processes that run them.

    reuse: take results that lie in the folder, of commands whose words and named files are the
    same; what these import may have changed. A callable always runs again.
    """

    estimators: Mapping[str, Estimator] = field(default_factory=dict)
    reuse: bool = False
    workers: int = 1


def montecarlo(
    scenario: str | Path = "circle",
    runs: int = 50,
    filters: Iterable[str] = ("ekf",),
    *,
    estimators: Mapping[str, Estimator] | None = None,
    folder: str | Path | None = None,
    workers: int = 1,
) -> StudyOutcome:
    """Run variants of the EKF, and your own filters, over the same simulated runs.

    Args:
        scenario: A bundled name, or the path of a scenario's TOML file.
        runs: How many; a run's number is its seed, from 0.
        filters: Variants of the EKF, by the names of `slamcheck montecarlo --filters`.
        estimators: Your own filters by name. Each is a function that takes a `Log` without truth
            and returns an `Estimate` or a `ExternalEstimate`. An exception counts as a failure of
            that run.
        folder: Keeps finished runs, and logs of runs that failed. Default: nothing is kept.
        workers: Processes; more than one needs estimators that can be pickled.

    Returns:
        Mean NEES with its chi-square band, errors of each filter, and differences of each pair.
        With `estimators`, figures of landmarks are those of the last step alone.

    Raises:
        InputError: There is no such scenario or filter, or every run of an estimator failed.
    """
    config = MonteCarloConfig.of(scenario=str(scenario), runs=runs, filters=tuple(filters))
    if folder is not None:
        check_folder(Path(folder))
    with tempfile.TemporaryDirectory(prefix="slamcheck-montecarlo-") as place:
        external = External(estimators or {}, workers=workers)
        return run_study(read_study(config), Path(folder or place), workers, external=external)


def run_study(
    study: Study,
    folder: Path,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
    external: External | None = None,
) -> StudyOutcome:
    """Compute what the folder does not hold yet; figures over all runs. Raises InputError."""
    external = external or External()
    for number in (workers, external.workers):
        check_workers(number)
    check_names(external.estimators)
    if external.estimators and scheduler is not None:
        raise InputError("--scheduler computes our filters only; give --workers with --command")
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
    job = _ExternalJob(study, world, folder, external.workers, progress)
    theirs = {name: job.run(name, one, external) for name, one in external.estimators.items()}
    used = np.logical_and.reduce(
        [np.ones(len(steps), dtype=bool), *(t.used for t in theirs.values())]
    )
    final = bool(theirs)
    kept = {
        name: tally(_finished(files, name, config.runs), used, final_map=final) for name in names
    } | {name: tally(runs.records(), used, final_map=final) for name, runs in theirs.items()}
    scenario = study.scenario
    return StudyOutcome(
        config=config.model_dump(mode="json"),
        scenario=study.name,
        description=scenario.description,
        sha256=study.sha256,
        runs=config.runs,
        steps=scenario.steps,
        recorded_steps=int(np.count_nonzero(used)),
        duration_s=scenario.steps * scenario.step_s,
        landmarks=len(world.landmark),
        filters={name: figures_of(of_filter) for name, of_filter in kept.items()},
        pairs=compare_pairs(kept),
        final_map=final,
        failures={name: runs.failures for name, runs in theirs.items()},
        study=study,
        time_s=scenario.step_s * np.array(steps, dtype=float)[used],
        computed=len(wanted),
        damaged=damaged,
        reused=sum(one.reused for one in theirs.values()),
    )


def run_chunk(name: str, world: ScenarioWorld, chunk: int) -> RunRecords:
    """The records (CHUNK, T) of one chunk; the same wherever it is computed."""
    with np.errstate(all="ignore"):
        runs = range(chunk * CHUNK, (chunk + 1) * CHUNK)
        return run_filter(name, world, measure(world, runs))


def _finished(files: ChunkFiles, name: str, runs: int) -> Iterator[RunRecords]:
    """The records of the first runs, chunk by chunk."""
    for chunk in range(-(-runs // CHUNK)):
        records = files.read(name, chunk)
        if records is None:
            raise InputError(f"{files.path(name, chunk)}: was changed while the study ran")
        yield RunRecords(*(r[: runs - chunk * CHUNK] for r in records))


@dataclass(frozen=True, kw_only=True)
class _ExternalRuns:
    """One external filter's runs. used: (T,) recorded steps with a pose in every run."""

    files: ChunkFiles
    name: str
    runs: int
    used: NDArray[np.bool_]
    failures: tuple[Failure, ...]
    reused: int

    def records(self) -> Iterator[RunRecords]:
        """Run by run, NaN where it failed."""
        failed = {failure.seed for failure in self.failures}
        empty = RunRecords(*(np.full((1, len(self.used)), np.nan) for _ in RunRecords._fields))
        for run in range(self.runs):
            run_records = empty if run in failed else self.files.read(self.name, run)
            if run_records is None:
                raise InputError(f"{self.files.path(self.name, run)}: was changed meanwhile")
            yield run_records


@dataclass(frozen=True)
class _ExternalJob:
    study: Study
    world: ScenarioWorld
    folder: Path
    workers: int
    progress: Callable[[str, int, int], None]

    def run(self, name: str, estimator: Estimator, external: External) -> _ExternalRuns:
        """All runs through one filter, a file each. Raises InputError where every one fails."""
        runs, steps = self.study.config.runs, recorded_steps(self.study.scenario.steps)
        files = _external_files(self.study, self.folder, estimator)
        reuse = external.reuse and isinstance(estimator, ExternalProgram)
        wanted = [run for run in range(runs) if not (reuse and _is_there(files, name, run))]
        done = runs - len(wanted)
        self.progress(name, done, runs)
        failures = []
        tasks = [(estimator, self.world, run, self.study.log_name(run)) for run in wanted]
        for place, found in spread(run_external, tasks, self.workers):
            if isinstance(found, Failure):
                failures.append(found)
            else:
                files.write(name, wanted[place], found)
            done += 1
            self.progress(name, done, runs)
        failures.sort(key=lambda one: one.seed)
        reported = self._keep_logs(name, failures)
        if len(reported) == runs:
            first = reported[0]
            raise InputError(
                f"{name}: all {runs} runs failed; seed {first.seed}: {first.reason}; its log is "
                f"{first.log}"
            )
        kept = _ExternalRuns(
            files=files,
            name=name,
            runs=runs,
            used=np.ones(len(steps), dtype=bool),
            failures=tuple(reported),
            reused=runs - len(wanted),
        )
        used = kept.used
        for run, records in enumerate(kept.records()):
            if run not in {failure.seed for failure in reported}:
                used = used & np.isfinite(records.position_square[0])
        return replace(kept, used=used)

    def _keep_logs(self, name: str, failures: list[Failure]) -> list[Failure]:
        """Leave the first few logs, with what was said; what was said earlier goes."""
        for old in (self.folder / LOGS).glob(f"{name}-*.stderr"):
            old.unlink()
        reported = []
        for failure in failures[:_KEPT_LOGS]:
            log = keep_log(self.study, self.folder, failure.seed)
            said = log.parent / f"{name}-{log.name}.stderr"
            said.write_text(failure.output, encoding="utf-8")
            reported.append(replace(failure, log=log))
        return reported + failures[_KEPT_LOGS:]


def keep_log(study: Study, folder: Path, seed: int) -> Path:
    """Leave a run's log in a study's folder, as an external filter is given it. Return where."""
    place = folder / LOGS / f"{seed:06d}"
    if not place.exists():
        world = build_world(study.scenario, study.config.scenario)
        write_log_folder(log_of_run(world, seed, study.log_name(seed)), place)
    return place


def kept_runs(study: Study, folder: Path, commands: Mapping[str, ExternalProgram]) -> int:
    """Return how many runs of all filters a study's folder holds, finished or not."""
    runs, found = study.config.runs, 0
    ours = ChunkFiles(folder, study.sha256, 0)
    for name in study.config.filters:
        for chunk in range(-(-runs // CHUNK)):
            found += min(CHUNK, runs - chunk * CHUNK) * ours.path(name, chunk).exists()
    for theirs, command in commands.items():
        files = _external_files(study, folder, command)
        found += sum(_is_there(files, theirs, run) for run in range(runs))
    return found


def _external_files(study: Study, folder: Path, estimator: Estimator) -> ChunkFiles:
    """An external filter's runs, one a file."""
    command = estimator.sha256 if isinstance(estimator, ExternalProgram) else ""
    origin = hashlib.sha256(f"{study.sha256} {command}".encode()).hexdigest()
    return ChunkFiles(folder, origin, len(recorded_steps(study.scenario.steps)), 1)


def _is_there(files: ChunkFiles, name: str, run: int) -> bool:
    """Whether a run's result is of the same command and study."""
    try:
        return files.read(name, run) is not None
    except InputError:
        return False


def record_commands(study: Study, commands: Mapping[str, ExternalProgram]) -> Study:
    """Return the study with what runs besides, for its config.toml: hashes, as words may be secret.

    Raises InputError for recorded commands that were not given again: a file names them, and only
    the command line runs them.
    """
    missing = [name for name in study.config.commands if name not in commands]
    if missing:
        raise InputError(
            f"the configuration names the command '{missing[0]}', which is never run from a file; "
            f"give --command '{missing[0]}=COMMAND'"
        )
    named = {name: f"sha256:{program.sha256}" for name, program in commands.items()}
    return Study(study.config.model_copy(update={"commands": named}), study.scenario)
