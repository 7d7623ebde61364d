"""Guivant, Masson and Nebot 2002, section 4.2: updates made in parts, and what comes of them.

"A gradual equivalent update will work better than a single large update": measured by the distance
of the filter to the smoother that linearises anew, on simulated loops, on the Victoria Park log
that comes with gtsam, and with --data on MR.CLAM.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure as Canvas

from comparisons.config import EkfConfig, RunConfig
from comparisons.experiments.reproduction.claims import Claims, at_least, at_most, theirs
from comparisons.experiments.reproduction.drawing import chart
from comparisons.experiments.reproduction.drives import Drives
from comparisons.experiments.reproduction.interface import Experiment, Sources
from comparisons.jobs.run import compare
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.report.marks import EKF_COLOUR, SCANS_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR

FOLDER = "mrclam"
ONE = "one update"
SPLITS: Mapping[str, Mapping[str, float]] = {
    ONE: {},
    "1 degree, 1 m": {"split_turn_rad": float(np.deg2rad(1.0)), "split_move_m": 1.0},
    "0.1 degree, 0.05 m": {"split_turn_rad": float(np.deg2rad(0.1)), "split_move_m": 0.05},
    "half of a variance": {"split_shrink": 0.5},
}
NOISY = 3.0
"""Factor on the noise of the second kind of simulated loops, which close with larger errors."""
_COLOURS = (TRUTH_COLOUR, EKF_COLOUR, SMOOTHER_COLOUR, SCANS_COLOUR)


@dataclass(frozen=True, kw_only=True)
class SplitRun:
    """A filter with one splitting of its updates. gap: linearisation gap [smoother's sigma].

    optimism: its variance over the smoother's in the worst direction.
    """

    gap: float
    optimism: float


@dataclass(frozen=True)
class SplitLog:
    """Medians over one or more drives, by splitting."""

    name: str
    runs: Mapping[str, SplitRun]


def split(sources: Sources) -> Drives[SplitLog]:
    """Run every splitting on every log."""
    found = tuple(_median(name, [runs(log) for log in logs]) for name, logs in _logs(sources))
    return Drives("; ".join(one.name for one in found), found)


def _logs(sources: Sources) -> Iterator[tuple[str, list[Log]]]:
    for name, scale in (("simulated loops", 1.0), (f"loops of {NOISY:g} times the noise", NOISY)):
        drives = [
            open_log("simulated-loop", choices=SimulationChoices(seed, noise_scale=scale))
            for seed in range(sources.drives)
        ]
        yield f"{name} ({sources.drives})", drives
    yield "Victoria Park (gtsam)", [open_log("victoria-park")]
    folder = sources.folder(FOLDER)
    for path in () if folder is None else sorted(folder.glob("MRCLAM_Dataset*")):
        yield path.name.replace("MRCLAM_Dataset", "MR.CLAM "), [open_log(str(path))]


def runs(log: Log) -> dict[str, SplitRun]:
    """Run every splitting on one log."""
    found: dict[str, SplitRun] = {}
    for name, bounds in SPLITS.items():
        said = compare(log, RunConfig(ekf=EkfConfig.of(**bounds))).agreement
        found[name] = SplitRun(gap=said.linearisation.sigma, optimism=said.optimism)
    return found


def _median(name: str, drives: list[dict[str, SplitRun]]) -> SplitLog:
    runs = {}
    for split in SPLITS:
        each = [(drive[split].gap, drive[split].optimism) for drive in drives]
        gap, optimism = np.median(each, axis=0).tolist()
        runs[split] = SplitRun(gap=gap, optimism=optimism)
    return SplitLog(name, runs)


def claims(found: Drives[SplitLog]) -> Claims:
    """Parts work better than one update."""
    for one in found.each:
        whole, *finer = one.runs.items()
        of_one = whole[1]
        for name, run in finer:
            why = theirs(
                f"{run.gap:.2f} sigma, {of_one.gap:.2f} in one update: a part linearises the "
                "new measurement anew, what went before stays as it was"
            )
            text = (
                f"a gradual update works better: {one.name}, parts of {name} (linearisation "
                "gap over that of one update)"
            )
            yield at_most(text, run.gap / of_one.gap, 1.0, why=why)
            yield at_least(
                f"and is less optimistic: {one.name}, parts of {name} (least variance over the "
                "smoother's, over that of one update)",
                run.optimism / of_one.optimism,
                1.0,
                why=theirs(f"{run.optimism:.3f}, {of_one.optimism:.3f} in one update"),
            )


def draw(canvas: Canvas, found: Drives[SplitLog]) -> None:
    """Gap and optimism by log and splitting."""
    axes = canvas.subplots(1, 2)
    place = np.arange(len(found.each))
    for number, (name, colour) in enumerate(zip(SPLITS, _COLOURS, strict=True)):
        at = place + 0.2 * (number - 1.5)
        for axis, field in zip(axes, ("gap", "optimism"), strict=True):
            values = [getattr(one.runs[name], field) for one in found.each]
            axis.bar(at, values, 0.18, color=colour, label=name)
    for axis, title in zip(axes, ("linearisation gap [sigma]", "optimism (1: none)"), strict=True):
        chart(axis, title, "", "")
        axis.set_yscale("log")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.set_xticks(place, [one.name for one in found.each], fontsize=7, rotation=12)


SPLIT = Experiment("Guivant's updates in parts", split, takes=(FOLDER,))
