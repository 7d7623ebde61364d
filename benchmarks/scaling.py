"""Runs per second of a Monte Carlo study with 1 and 2 workers, and what more runs would cost.

    python benchmarks/scaling.py [--chunks 4] [--repeat 5] [--filter ekf] [--target 100000]
                                 [--price 0.05]

Local processes (joblib), and workers of a Dask cluster on this machine, that the benchmark starts.
Workers are warm. All kinds are measured in turn; the table has medians. Processor time is that of
the chunks, wherever they are computed, and of this process, which hands them out and writes them.
On a machine that others use, the wall's figures, and so the efficiency, say little.

The second table is a projection and no measurement: the processor time of a run with 2 workers,
times the runs, by the efficiency of 2 workers, which is taken to hold for all numbers of them. One
process writes all chunks, and sets a bound.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from comparisons.experiments.montecarlo.chunk_files import CHUNK, ChunkFiles
from comparisons.experiments.montecarlo.config import FILTER_NAMES
from comparisons.experiments.montecarlo.runs import Records, recorded_steps
from comparisons.experiments.montecarlo.study import run_chunk
from comparisons.experiments.montecarlo.workers import spread
from comparisons.experiments.scenarios.scenario import read_scenario
from comparisons.experiments.scenarios.world import World, build_world

CORES = (2, 16, 128)
Work = Callable[[int, str | None], "Taken"]


@dataclass(frozen=True)
class Kind:
    """A way to compute. scheduler: the address of a Dask cluster with so many workers."""

    name: str
    workers: int
    scheduler: str | None = None


@dataclass(frozen=True)
class Taken:
    """Seconds of one study: on the wall, of the processor in its chunks, and in this process."""

    wall_s: float
    chunks_s: float
    own_s: float


def timed_chunk(name: str, world: World, chunk: int) -> tuple[Records, float]:
    """A chunk of runs, and the processor time that it took."""
    began = time.process_time()
    records = run_chunk(name, world, chunk)
    return records, time.process_time() - began


def study(filter_: str, world: World, steps: int, chunks: int) -> Work:
    """Return what computes the chunks and writes them, as a study does."""

    def work(workers: int, scheduler: str | None) -> Taken:
        with tempfile.TemporaryDirectory() as folder:
            files = ChunkFiles(Path(folder), "scaling", steps)
            wall, own, spent = time.perf_counter(), time.process_time(), 0.0
            tasks = [(filter_, world, chunk) for chunk in range(chunks)]
            for place, (records, cpu_s) in spread(timed_chunk, tasks, workers, scheduler):
                files.write(filter_, place, records)
                spent += cpu_s
            own_s = time.process_time() - own - (spent if workers == 1 and not scheduler else 0.0)
            return Taken(time.perf_counter() - wall, spent, own_s)

    return work


def measured(work: Work, kinds: Sequence[Kind], repeat: int) -> dict[Kind, list[Taken]]:
    """Each kind in turn, after a first round that warms the workers and is not counted."""
    found: dict[Kind, list[Taken]] = {kind: [] for kind in kinds}
    for _ in range(repeat + 1):
        for kind in kinds:
            found[kind].append(work(kind.workers, kind.scheduler))
    return {kind: taken[1:] for kind, taken in found.items()}


def projected_hours(cores: int, core_hours: float, efficiency: float, own_hours: float) -> float:
    """Return the hours on so many cores; own_hours: of the one process that writes the chunks."""
    return max(core_hours / (cores * efficiency), own_hours)


def report(found: dict[Kind, list[Taken]], runs: int, target: int, price: float | None) -> None:
    """Print the curve of each way to compute, and the projection from it."""
    print(
        f"workers              runs/s  efficiency   cpu ms/run   own cpu ms/run   (of {runs} runs)"
    )
    rates = {kind: median(runs / one.wall_s for one in taken) for kind, taken in found.items()}
    for kind, taken in found.items():
        base = next(rate for one, rate in rates.items() if one.name == kind.name)
        efficiency = rates[kind] / (kind.workers * base)
        cpu, own = (1e3 * median(x) / runs for x in _columns(taken))
        row = f"{kind.name:10} {kind.workers:2d}   {rates[kind]:13.1f}  {efficiency:10.2f}"
        print(f"{row}  {cpu:11.2f}  {own:15.2f}")
    print(f"\n{target:,} runs of one filter, projected, not measured")
    print("workers    core-hours  " + "  ".join(f"h on {n:3d}" for n in CORES) + "  least h")
    for name in dict.fromkeys(kind.name for kind in found):
        one, two = (kind for kind in found if kind.name == name)
        cpu, own = (median(x) / runs * target / 3600.0 for x in _columns(found[two]))
        efficiency = min(1.0, rates[two] / (2.0 * rates[one]))
        hours = [projected_hours(n, cpu, efficiency, own) for n in CORES]
        cost = "" if price is None else f"  {price * cpu / efficiency:.2f} at {price} a core-hour"
        row = f"{name:10} {cpu:10.2f}  " + "  ".join(f"{h:8.3f}" for h in hours)
        print(f"{row}  {own:7.3f}{cost}")


def _columns(taken: Sequence[Taken]) -> tuple[list[float], list[float]]:
    return [one.chunks_s for one in taken], [one.own_s for one in taken]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenario", default="circle")
    parser.add_argument("--filter", default="ekf", choices=FILTER_NAMES)
    parser.add_argument("--chunks", type=int, default=4, help=f"of {CHUNK} runs, in each study")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--target", type=int, default=100_000, help="runs of the projection")
    parser.add_argument("--price", type=float, help="of a core-hour, in your currency")
    choices = parser.parse_args()
    scenario = read_scenario(choices.scenario)
    world, steps = build_world(scenario), len(recorded_steps(scenario.steps))
    kinds = [Kind("joblib", 1), Kind("joblib", 2)]
    with ExitStack() as stack:
        try:
            from distributed import LocalCluster
        except ImportError:
            print("dask: not installed, left out (pip install 'slamcheck[dask]')")
        else:
            start: Any = LocalCluster
            for n in (1, 2):
                started = start(n_workers=n, threads_per_worker=1, dashboard_address=":0")
                kinds.append(Kind("dask", n, stack.enter_context(started).scheduler_address))
        work = study(choices.filter, world, steps, choices.chunks)
        found = measured(work, kinds, choices.repeat)
    report(found, choices.chunks * CHUNK, choices.target, choices.price)


if __name__ == "__main__":
    main()
