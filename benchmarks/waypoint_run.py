"""Dead reckoning against SLAM on a waypoint run (Misono 2007, section 4.1, Figs. 5 and 6).

    python benchmarks/waypoint_run.py [--seeds 10] [--plot docs/waypoint-run.png]

Left, one drive that all estimate; right, where the robot truly goes when it navigates by what it
believes. Prints root mean square errors, landmarks in the map (45 obstacles, not all come into
view), and the true distance from the base at the end. `misono` is as published, and no estimator
is given labels or positions but those that are called `aided`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from comparisons.experiments.reproduction.interface import Sources
from comparisons.experiments.reproduction.misono import (
    DRAWN,
    ESTIMATORS,
    Drives,
    Journeys,
    draw_estimates,
    draw_journeys,
    drives,
    journeys,
)
from comparisons.report.picture import blank, save


def main() -> None:
    """Run all, print a table, draw the first seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--plot", type=Path)
    choices = parser.parse_args()
    sources = Sources(drives=choices.seeds)
    estimated, steered = drives(sources), journeys(sources)
    print(
        f"{'':18} {'error along one drive [m]':>28} {'landmarks':>12}"
        f" {'from the base, navigating [m]':>32}"
    )
    for name in ESTIMATORS:
        error, end = [one.rms_m(name) for one in estimated.each], steered.ends_m(name)
        mapped = [one.landmarks[name] for one in estimated.each]
        print(
            f"{name:18} median {np.median(error):6.2f}, worst {max(error):6.2f}"
            f"    {min(mapped):3} to {max(mapped):3}"
            f"    median {np.median(end):6.2f}, worst {max(end):6.2f}"
        )
    if choices.plot is not None:
        plot(estimated, steered, choices.plot)


def plot(estimated: Drives, steered: Journeys, to: Path) -> None:
    """Estimates of one drive, and where the robot goes by them."""
    figure = blank(9.0, 4.6)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    draw_estimates(left, estimated.each[0], DRAWN, "one drive, estimated")
    draw_journeys(right, steered, "where the robot truly goes by it")
    save(figure, to)


if __name__ == "__main__":
    main()
