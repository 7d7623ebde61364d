"""Run the experiments behind figures, once each, and draw."""

from __future__ import annotations

import time
from collections.abc import Callable

from comparisons.errors import InputError
from comparisons.experiments.montecarlo.workers import check_workers, spread
from comparisons.figures import package_versions
from comparisons.report.picture import blank, encoded
from ekf_reference.core.state import FilterDivergedError
from research.documents.interface import (
    AnyFigure,
    FigureResult,
    ReproductionResult,
    SkippedResult,
    Sources,
)
from research.documents.registry import chosen

Progress = Callable[[str, int, int], None]


def reproduce(
    names: tuple[str, ...],
    sources: Sources,
    workers: int = 1,
    progress: Progress = lambda stage, done, total: None,
) -> ReproductionResult:
    """The figures of these names in the catalogue's order; the same with any number of workers.

    Raises InputError for unknown names, unreadable data, or where nothing can be run.
    """
    check_workers(workers)
    start, figures = time.perf_counter(), chosen(names)
    lacking = {figure.name: _lacking(figure, sources) for figure in figures}
    groups: dict[str, list[str]] = {}
    for figure in figures:
        if not lacking[figure.name]:
            groups.setdefault(figure.experiment.name, []).append(figure.name)
    if not groups:
        reasons = [f"{name} {reason}" for name, reason in lacking.items()]
        raise InputError(f"nothing to run: {', '.join(reasons)}")
    tasks = [(tuple(group), sources) for group in groups.values()]
    progress("figures", 0, len(tasks))
    each = list[tuple[list[FigureResult], float]]()
    for place, found in spread(_experiment, tasks, workers):
        each.append(found)
        progress(f"figures ({', '.join(tasks[place][0])} done)", len(each), len(tasks))
    done = {figure.name: figure for found, _ in each for figure in found}
    return ReproductionResult(
        holds=all(figure.holds for figure in done.values()),
        drives=sources.drives,
        seconds=round(time.perf_counter() - start, 3),
        cpu_s=round(sum(cpu_s for _, cpu_s in each), 3),
        figures=tuple(done[figure.name] for figure in figures if figure.name in done),
        skipped=tuple(
            SkippedResult(figure.name, figure.title, figure.source, reason)
            for figure in figures
            if (reason := lacking[figure.name])
        ),
        versions=package_versions(),
    )


def _lacking(figure: AnyFigure, sources: Sources) -> str:
    """What a figure's experiment needs and has not got, empty where it can run."""
    needs = figure.experiment.needs
    if needs is not None and sources.folder(needs) is None:
        return f"needs --data FOLDER with {needs}/"
    return ""


def _experiment(names: tuple[str, ...], sources: Sources) -> tuple[list[FigureResult], float]:
    """Run the experiment of figures; by name, which is how processes tell each other.

    Return the figures, and the processor time of all of them together.
    """
    figures = chosen(names)
    start, cpu = time.perf_counter(), time.process_time()
    try:
        data = figures[0].experiment.run(sources)
    except (InputError, FilterDivergedError) as error:
        raise InputError(f"{', '.join(names)}: {error}") from None
    seconds, cpu_s = time.perf_counter() - start, time.process_time() - cpu
    results = list[FigureResult]()
    for figure in figures:
        canvas = blank(*figure.size)
        figure.draw(canvas, data)
        png, pdf = encoded(canvas)
        claims = figure.judged(data)
        one = FigureResult(
            name=figure.name,
            title=figure.title,
            source=figure.source,
            says=figure.says,
            log=data.log,
            seconds=round(seconds, 3),
            cpu_s=round(cpu_s, 3),
            shared=tuple(name for name in names if name != figure.name),
            holds=all(claim.holds for claim in claims),
            claims=claims,
            png=png,
            pdf=pdf,
        )
        results.append(one)
    return results, cpu_s
