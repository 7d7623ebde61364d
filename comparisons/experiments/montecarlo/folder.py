"""What a Monte Carlo study leaves beside its chunks: settings, figures, curves, a short table."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from comparisons.atomic import write_whole
from comparisons.experiments.montecarlo.chunk_files import CONFIG
from comparisons.experiments.montecarlo.models import (
    ConsistencyResult,
    MonteCarloFilterResult,
    MonteCarloResult,
    PairResult,
)
from comparisons.experiments.montecarlo.plots import curves_figure
from comparisons.experiments.montecarlo.statistics import (
    DOF,
    LEVEL,
    Consistency,
    FilterFigures,
    Pair,
)
from comparisons.experiments.montecarlo.study import Outcome
from comparisons.report.model import finite
from comparisons.report.picture import save


def build_montecarlo_result(outcome: Outcome) -> MonteCarloResult:
    """The figures, without what depends on the machine."""
    study = outcome.study
    return MonteCarloResult(
        config=study.config.model_dump(mode="json"),
        scenario=study.name,
        description=study.scenario.description,
        sha256=study.sha256,
        runs=study.config.runs,
        steps=study.scenario.steps,
        recorded_steps=len(outcome.time_s),
        duration_s=study.scenario.steps * study.scenario.step_s,
        landmarks=outcome.landmarks,
        level=LEVEL,
        filters={name: _filter(figures) for name, figures in outcome.figures.items()},
        pairs=[_pair(pair) for pair in outcome.pairs],
    )


def write_montecarlo(outcome: Outcome, result: MonteCarloResult, folder: Path) -> None:
    """Write config.toml, montecarlo.json and curves.png, each whole or not at all."""
    config = outcome.study.config.toml()
    write_whole(folder / CONFIG, lambda part: part.write_text(config, encoding="utf-8"))
    text = result.model_dump_json(indent=2) + "\n"
    write_whole(folder / "montecarlo.json", lambda part: part.write_text(text, encoding="utf-8"))
    write_whole(folder / "curves.png", lambda part: save(curves_figure(outcome), part))


def print_montecarlo(outcome: Outcome, console: Console) -> None:
    """One row per filter; what lies outside its band is told in words, too."""
    study = outcome.study
    bands = next(iter(outcome.figures.values())).consistency
    lines = [
        f"{study.name}: {study.config.runs} runs of {study.scenario.steps:,} steps, "
        f"{outcome.landmarks} landmarks",
        f"{'ANEES':10}" + "".join(f"{name:>14}" for name in DOF),
        f"{'95 % band':10}" + "".join(f"{_interval(bands[name].band):>14}" for name in DOF),
    ]
    for name, figures in outcome.figures.items():
        lines.append(
            f"{name:10}" + "".join(f"{_told(figures.consistency[block]):>14}" for block in DOF)
        )
    lines.append(f"{'RMSE':10}{'position m':>14}{'heading rad':>14}{'landmarks m':>14}")
    for name, figures in outcome.figures.items():
        lines.append(f"{name:10}" + "".join(f"{value:14.4f}" for value in figures.rmse.values()))
    for name, figures in outcome.figures.items():
        if figures.lost:
            lines.append(f"{name}: {figures.lost} runs broke down and are left out")
    if outcome.damaged:
        lines.append(f"damaged chunk files, computed again: {outcome.damaged}")
    console.print("\n".join(lines), highlight=False, markup=False)


def _interval(band: tuple[float, float]) -> str:
    return f"{band[0]:.2f} to {band[1]:.2f}"


def _told(consistency: Consistency) -> str:
    mark = "" if consistency.place == "inside" else f"{consistency.place} "
    return f"{mark}{consistency.mean:.2f}"


def _filter(figures: FilterFigures) -> MonteCarloFilterResult:
    return MonteCarloFilterResult(
        lost=figures.lost,
        consistency={
            name: ConsistencyResult(
                anees=finite(c.mean),
                band=(finite(c.band[0]), finite(c.band[1])),
                place=c.place,
                share_above=finite(c.share_above),
            )
            for name, c in figures.consistency.items()
        },
        rmse_position_m=finite(figures.rmse["position"]),
        rmse_heading_rad=finite(figures.rmse["heading"]),
        rmse_landmark_m=finite(figures.rmse["landmarks"]),
    )


def _pair(pair: Pair) -> PairResult:
    low, high = pair.interval
    return PairResult(
        first=pair.first,
        second=pair.second,
        what=pair.what,
        mean=finite(pair.mean),
        interval=(finite(low), finite(high)),
        runs=pair.runs,
    )
