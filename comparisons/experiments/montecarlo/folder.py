"""What a Monte Carlo study leaves beside its chunks: settings, figures, curves, a short table."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console

from comparisons.atomic import write_whole
from comparisons.experiments.montecarlo.chunk_files import CONFIG, LOGS
from comparisons.experiments.montecarlo.models import (
    ConsistencyResult,
    FailureResult,
    LastPosesResult,
    MonteCarloFilterResult,
    MonteCarloResult,
    PairResult,
)
from comparisons.experiments.montecarlo.page import study_page
from comparisons.experiments.montecarlo.plots import curves_figure
from comparisons.experiments.montecarlo.statistics import (
    DOF,
    LEVEL,
    Consistency,
    FilterFigures,
    Pair,
    inside_at_end,
    per_run,
)
from comparisons.experiments.montecarlo.study import Outcome
from comparisons.report.model import finite
from comparisons.report.picture import save

_MOST_FAILURES = 5


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
        final_map=outcome.final_map,
        failures={
            name: [FailureResult(seed=one.seed, reason=one.reason) for one in failed]
            for name, failed in outcome.failures.items()
        },
    )


def write_montecarlo(outcome: Outcome, result: MonteCarloResult, folder: Path) -> None:
    """Write the settings, the figures, those of each run, page and picture, each whole."""
    config = outcome.study.config.toml()
    write_whole(folder / CONFIG, lambda part: part.write_text(config, encoding="utf-8"))
    text = result.model_dump_json(indent=2) + "\n"
    write_whole(folder / "montecarlo.json", lambda part: part.write_text(text, encoding="utf-8"))
    page = study_page(outcome, remarks(outcome))
    write_whole(folder / "report.html", lambda part: part.write_text(page, encoding="utf-8"))
    rows = _run_rows(outcome)
    write_whole(folder / "runs.csv", lambda part: part.write_text(rows, encoding="utf-8"))
    write_whole(folder / "curves.png", lambda part: save(curves_figure(outcome), part))


def _run_rows(outcome: Outcome) -> str:
    """A line per run and filter; empty where there is no such figure."""
    lines = ["seed,filter,ate_m,heading_rmse_rad,landmark_rmse_m,pose_nees,last_pose_nees"]
    for name, figures in outcome.figures.items():
        kept = figures.kept
        run = per_run(kept)
        columns = [run[f"{what}_rmse"] for what in ("position", "heading", "landmarks")]
        columns += [run["pose_nees"], kept.last.pose_nees]
        for seed, row in enumerate(zip(*(one.tolist() for one in columns), strict=True)):
            lines.append(",".join([str(seed), name, *(_cell(value) for value in row)]))
    return "\n".join(lines) + "\n"


def _cell(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


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
            f"{name:10}" + "".join(f"{_reported(figures.consistency[block]):>14}" for block in DOF)
        )
    lines.append(f"{'RMSE':10}{'position m':>14}{'heading rad':>14}{'landmarks m':>14}")
    for name, figures in outcome.figures.items():
        lines.append(f"{name:10}" + "".join(f"{value:14.4f}" for value in figures.rmse.values()))
    lines += remarks(outcome)
    if outcome.reused:
        lines.append(f"runs of commands that were not made again: {outcome.reused}")
    if outcome.damaged:
        lines.append(f"damaged chunk files, computed again: {outcome.damaged}")
    console.print("\n".join(lines), highlight=False, markup=False)


def remarks(outcome: Outcome) -> list[str]:
    """What stands beside the figures: runs that are left out, and what was not handed in."""
    lines = []
    for name, figures in outcome.figures.items():
        failed = outcome.failures.get(name, ())
        if failed:
            lines.append(f"{name}: {len(failed)} of {outcome.study.config.runs} runs failed")
        elif figures.lost:
            lines.append(f"{name}: {figures.lost} runs broke down and are left out")
        for one in failed[:_MOST_FAILURES]:
            kept = "" if one.log is None else f"; its log is {LOGS}/{one.log.name}"
            lines.append(f"  seed {one.seed}: {one.reason}{kept}")
        if len(failed) > _MOST_FAILURES:
            lines.append(f"  and {len(failed) - _MOST_FAILURES} more, in montecarlo.json")
        absent = [block for block, c in figures.consistency.items() if c.place == "not given"]
        if absent:
            lines.append(f"{name}: no covariances, so no NEES, of {', '.join(absent)}")
    if outcome.final_map:
        lines.append("landmarks: of the map at the end, as an estimate holds no other")
    return lines


def _interval(band: tuple[float, float]) -> str:
    return f"{band[0]:.2f} to {band[1]:.2f}"


def _reported(consistency: Consistency) -> str:
    if consistency.place == "not given":
        return "none"
    mark = "" if consistency.place == "inside" else f"{consistency.place} "
    return f"{mark}{consistency.mean:.2f}"


def _filter(figures: FilterFigures) -> MonteCarloFilterResult:
    inside, of, band = inside_at_end(figures.kept)
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
        last_pose_inside=LastPosesResult(inside=inside, of=of, band=band),
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
        lower=pair.lower,
        higher=pair.higher,
        family_interval=(finite(pair.family_interval[0]), finite(pair.family_interval[1])),
        sign_p=finite(pair.sign_p),
    )
