"""Dead reckoning against SLAM on a waypoint run (Misono 2007, section 4.1, Figs. 5 and 6).

    python benchmarks/waypoint_run.py [--seeds 10] [--plot docs/waypoint-run.png]

Left, one drive that all estimate; right, where the robot truly goes when it navigates by what it
believes. Prints root mean square errors and the true distance from the base at the end.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from comparisons.runs.ekf_build import EkfChoices, fused_positions
from comparisons.runs.ekf_run import run_ekf
from comparisons.runs.navigator import Array, direction_cosine_navigator
from comparisons.runs.timeline import build_timeline
from ekf_reference.kalman import FilterDivergedError
from graphslam.increments import dead_reckoned

NAMES = {"dead reckoning": "", "misono": "misono", "misono-full": "misono-full"}
COLOURS = ("#999999", "#d1495b", "#00798c")


def drive(seed: int) -> tuple[Array, dict[str, Array]]:
    """True poses of one drive that the truth steers, and what is estimated of it."""
    log = simulate(np.random.default_rng(seed), WaypointRun())
    assert log.truth.poses is not None
    estimates = {}
    for name, filter_name in NAMES.items():
        choices = EkfChoices(filter_name or "full", "known", "on")
        positions = fused_positions(log, choices)
        timeline = build_timeline(log, positions)
        if filter_name:
            estimates[name] = run_ekf(log, timeline, choices, positions).estimate.pose
        else:
            estimates[name] = dead_reckoned(log.prior.pose, timeline.control)
    return log.truth.poses.pose, estimates


def navigate(seed: int, name: str) -> Array | None:
    """True poses of a drive that the estimate steers; None when the filter broke down."""
    pilot = direction_cosine_navigator(complete=name == "misono-full", slam=bool(NAMES[name]))
    try:
        log = simulate(np.random.default_rng(seed), WaypointRun(), pilot)
    except FilterDivergedError:
        return None
    assert log.truth.poses is not None
    return log.truth.poses.pose


def main() -> None:
    """Run all, print a table, draw the first seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--plot", type=Path)
    choices = parser.parse_args()
    drives = [drive(seed) for seed in range(choices.seeds)]
    journeys = {name: [navigate(seed, name) for seed in range(choices.seeds)] for name in NAMES}
    print(f"{'':16} {'error along one drive [m]':>28} {'from the base, navigating [m]':>32}")
    for name in NAMES:
        error = [np.sqrt(np.mean(np.sum((e[name] - t)[:, :2] ** 2, axis=1))) for t, e in drives]
        end = [np.inf if path is None else np.hypot(*path[-1, :2]) for path in journeys[name]]
        print(
            f"{name:16} median {np.median(error):6.2f}, worst {max(error):6.2f}"
            f"    median {np.median(end):6.2f}, worst {max(end):6.2f}"
        )
    if choices.plot is not None:
        plot(*drives[0], {name: paths[0] for name, paths in journeys.items()}, choices.plot)


def plot(
    true: Array, estimates: dict[str, Array], paths: dict[str, Array | None], to: Path
) -> None:
    """Estimates of one drive, and where the robot goes by them."""
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    left.plot(true[:, 0], true[:, 1], color="#cccccc", linewidth=3.0, label="truth")
    for (name, estimate), colour in zip(estimates.items(), COLOURS, strict=True):
        left.plot(estimate[:, 0], estimate[:, 1], color=colour, label=name, linewidth=1.2)
        path = paths[name]
        if path is not None:
            right.plot(path[:, 0], path[:, 1], color=colour, label=name, linewidth=1.2)
    for axis, title in (
        (left, "one drive, estimated"),
        (right, "where the robot truly goes by it"),
    ):
        axis.plot(*WaypointRun().waypoint.T, "*", color="#444444", label="waypoints")
        axis.plot(0.0, 0.0, "s", color="#444444", label="base")
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("east [m]")
        axis.set_aspect("equal")
        axis.grid(visible=True, color="#eeeeee")
    left.set_ylabel("north [m]")
    left.legend(fontsize=8)
    figure.savefig(to, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
