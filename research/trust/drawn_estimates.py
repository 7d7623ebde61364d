"""Estimates of filters with a fault, drawn from models, data, times, algebra and lines of code."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.errors import InputError
from comparisons.estimates.external import ExternalEstimate
from comparisons.faults.fault import Family, Fault
from comparisons.faults.streams import stream_families, stream_faults
from comparisons.faults.timing import timing_families, timing_faults
from comparisons.faults.tried import TriedFaults
from comparisons.jobs.check import check
from comparisons.logs.log import Log
from comparisons.logs.stamps import at_instants
from comparisons.plane import pose_difference
from ekf_reference.core.state import FilterDivergedError
from research.filter_steps import counted_steps
from research.script import present, print_head, print_row
from research.trust.changed_lines import changed_line, estimate_of
from research.trust.strangers import Car

LEAST_SIGMA = 0.1
OUTCOMES = "own words", "other words", "nothing", "accepted"
_FACTORS, _OFFSETS = (0.5, 0.9, 1.2, 2.0, 3.0), (-0.1, 0.01, 0.2)
LINES = "a stranger's line"

Drawn = tuple[str, ExternalEstimate | None]
"""What is otherwise, and the estimate with it; None where the filter breaks down."""


class CheckedEstimate(NamedTuple):
    """What a check says. said: faults that it names. runs: what it cost, in runs of a filter."""

    said: tuple[str, ...]
    accepted: bool
    runs: float
    wall_s: float

    def outcome(self, words: str) -> str:
        """Return how a fault was named, of OUTCOMES."""
        if self.accepted:
            return "accepted"
        if not self.said:
            return "nothing"
        return "own words" if words in self.said[0] else "other words"


def run_of(log: Log, fault: Fault | None) -> EkfRun | None:
    """The reference filter's run with a fault; None where it breaks down."""
    try:
        with np.errstate(all="ignore"):
            fed = log if fault is None or fault.feed is None else fault.feed(log)
            plants = [] if fault is None or fault.plant is None else [fault.plant]
            config, setup = settle(EkfConfig(), fed), FilterSetup(modify=plants)
            run = run_ekf(fed, build_timeline(fed), config, None, setup)
    except (FilterDivergedError, InputError, np.linalg.LinAlgError, ValueError, ArithmeticError):
        return None
    return None if run.breakdown else run


def handed_in(run: EkfRun | None) -> ExternalEstimate | None:
    """Return the poses, covariances and map of a run, of an EKF as its author says."""
    if run is None or not np.isfinite(run.estimate.pose).all():
        return None
    known = run.estimate
    return ExternalEstimate(
        time_s=known.time_s,
        pose=known.pose,
        pose_covariance=known.pose_covariance,
        information="filtered",
        estimator="ekf",
    )


def sources(log: Log, rng: np.random.Generator) -> Mapping[str, Callable[[], Drawn]]:
    """Return what draws an estimate, by where its fault is."""
    tried = TriedFaults(log)

    def any_of(faults: Sequence[Fault | Family]) -> Fault:
        fault = faults[int(rng.integers(len(faults)))]
        if isinstance(fault, Fault):
            return fault
        return fault.member(float(rng.choice(_FACTORS if fault.factor else _OFFSETS)))

    def planted(faults: Sequence[Fault | Family]) -> Callable[[], Drawn]:
        def draw() -> Drawn:
            fault = any_of(faults)
            return fault.what, handed_in(run_of(log, fault))

        return draw

    without_plant = (one for one in stream_faults(log) if one.plant is None)
    fed: list[Fault | Family] = [*without_plant, *stream_families(log)]

    def of_data() -> Drawn:
        fault = any_of(fed)
        try:
            return fault.what, estimate_of(present(fault.feed)(log), Car)
        except InputError:
            return fault.what, None

    def of_lines() -> Drawn:
        line = changed_line(rng)
        return line.words, estimate_of(log, line.kind)

    return {
        "models and algebra": planted([*tried.single, *tried.numbered]),
        "two changes": planted(tried.joined),
        "times": planted([*timing_faults(log), *timing_families()]),
        "data of a stranger's filter": of_data,
        LINES: of_lines,
    }


def moved_sigma(sound: EkfRun, given: ExternalEstimate) -> float:
    """How far a fault moves the poses that both have, in the sound filter's sigma."""
    known = sound.estimate
    time_s = at_instants(given.time_s, known.time_s)
    _, ours, theirs = np.intersect1d(known.time_s, time_s, return_indices=True)
    if len(ours) < len(known.time_s) - 1:
        raise ValueError("an estimate that does not have the filter's times")
    variance = np.diagonal(known.pose_covariance[ours], 0, 1, 2)
    off = pose_difference(given.pose[theirs], known.pose[ours])
    sigma = np.abs(off) / np.sqrt(np.maximum(variance, 1e-20))
    return float(np.nan_to_num(sigma, nan=0.0).max())


def checked(log: Log, given: ExternalEstimate) -> CheckedEstimate:
    """Hand an estimate to `check`, and count what it costs."""
    began_s = time.perf_counter()
    with counted_steps() as counter, np.errstate(all="ignore"):
        causes = check(log, given).causes
    runs = counter.steps / len(build_timeline(log).control)
    said = tuple(cause.evidence for cause in causes if cause.gap == "fault")
    return CheckedEstimate(said, not causes, runs, time.perf_counter() - began_s)


def print_estimates(log: Log, rng: np.random.Generator, count: int, *, listed: bool) -> None:
    """Draw, check, and print a table by source. listed: what is said of each as well."""
    sound, draws = present(run_of(log, None)), sources(log, rng)
    results: list[tuple[str, str, CheckedEstimate]] = []
    while len(results) < count:
        source = str(rng.choice(list(draws)))
        words, given = draws[source]()
        if given is None or moved_sigma(sound, given) < LEAST_SIGMA:
            continue
        found = checked(log, given)
        outcome = found.outcome(words)
        results.append((source, outcome, found))
        if listed:
            cost = f"{found.runs:.1f} runs, {found.wall_s:.0f} s"
            print(f"{outcome:12} {source}: {words} ({cost})", flush=True)
            print(f"{'':13}{'; '.join(found.said)[:300]}", flush=True)
    print_head("source", "drawn", *OUTCOMES, "mean runs", "most runs", "mean s")
    for source in (*draws, "all"):
        some = [one for one in results if source in (one[0], "all")]
        counts = [sum(outcome == one for _, one, _ in some) for outcome in OUTCOMES]
        runs = [one.runs for _, _, one in some] or [0.0]
        wall_s = [one.wall_s for _, _, one in some] or [0.0]
        figures = f"{np.mean(runs):.1f}", f"{max(runs):.1f}", f"{np.mean(wall_s):.0f}"
        print_row(source, len(some), *counts, *figures)
