"""Run the experiments behind figures, once each, and draw."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from comparisons.errors import InputError
from comparisons.experiments.montecarlo.workers import check_workers, spread
from comparisons.experiments.reproduction.interface import AnyFigure, Reproduced, Skipped, Sources
from comparisons.experiments.reproduction.registry import chosen
from comparisons.report.picture import blank, encoded
from ekf_reference.core.state import FilterDivergedError
from graphslam.scan.libraries import MissingLibraryError, require

Progress = Callable[[str, int, int], None]


def reproduce(
    names: tuple[str, ...],
    sources: Sources,
    workers: int = 1,
    progress: Progress = lambda stage, done, total: None,
) -> list[Reproduced | Skipped]:
    """The figures of these names in the catalogue's order; the same with any number of workers.

    Raises InputError for unknown names, unreadable data, or where nothing can be run.
    """
    check_workers(workers)
    figures = chosen(names)
    results: dict[str, Reproduced | Skipped] = {}
    groups: dict[str, list[str]] = {}
    for figure in figures:
        if reason := _lacking(figure, sources):
            results[figure.name] = Skipped(figure, reason)
        else:
            groups.setdefault(figure.experiment.name, []).append(figure.name)
    if not groups:
        reasons = [
            f"{r.figure.name} {r.reason}" for r in results.values() if isinstance(r, Skipped)
        ]
        raise InputError(f"nothing to run: {', '.join(reasons)}")
    tasks = [(tuple(group), sources) for group in groups.values()]
    progress("figures", 0, len(tasks))
    for done, (place, found) in enumerate(spread(_experiment, tasks, workers), start=1):
        results |= {r.figure.name: r for r in found}
        progress(f"figures ({', '.join(tasks[place][0])} done)", done, len(tasks))
    return [results[figure.name] for figure in figures]


def _lacking(figure: AnyFigure, sources: Sources) -> str:
    """What a figure's experiment needs and has not got, empty where it can run."""
    needs, library = figure.experiment.needs, figure.experiment.library
    if needs is not None and sources.folder(needs) is None:
        return f"needs --data FOLDER with {needs}/"
    try:
        require({} if library is None else {library: figure.name})
    except MissingLibraryError as error:
        return str(error).removeprefix(f"{figure.name} ")
    return ""


def _experiment(names: tuple[str, ...], sources: Sources) -> list[Reproduced]:
    """One experiment and its figures; by name, which is how processes tell each other."""
    figures = chosen(names)
    start, cpu = time.perf_counter(), time.process_time()
    try:
        data = figures[0].experiment.run(sources)
    except (InputError, FilterDivergedError) as error:
        raise InputError(f"{', '.join(names)}: {error}") from None
    spent = time.perf_counter() - start, time.process_time() - cpu
    return [_drawn(figure, data, spent, names) for figure in figures]


def _drawn(
    figure: AnyFigure, data: Any, spent: tuple[float, float], group: Sequence[str]
) -> Reproduced:
    canvas = blank(*figure.size)
    figure.draw(canvas, data)
    png, pdf = encoded(canvas)
    others = tuple(name for name in group if name != figure.name)
    return Reproduced(
        figure=figure,
        claims=figure.judged(data),
        log=data.log,
        seconds=spent[0],
        cpu_s=spent[1],
        shared=others,
        png=png,
        pdf=pdf,
    )
