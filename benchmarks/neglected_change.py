"""What dense maps lose by ignoring correlation, on simulated drives that close a loop.

    python benchmarks/neglected_change.py [--seeds 10] [--figures FOLDER]

One dense point per region, seen once. agreement: eq. 3.16 summed, against a filter with the points
in its state (the least of all seeds). explained: against the error by truth, over all seeds;
slope: 1 where the change takes away what it claims to; expected: what is explained then. bounded:
share of changes within two sigmas of the error layer; median: of change over sigma.
"""

from __future__ import annotations

import argparse
import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import numpy as np

from comparisons.experiments.reproduction.decorrelation_example import decorrelation_example
from comparisons.experiments.reproduction.dense_figures import (
    decorrelation_figure,
    displacement_figure,
    neglected_figure,
)
from comparisons.experiments.reproduction.neglected_change import NeglectedChange, neglected_change
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive
from comparisons.logs.simulate.drive import simulate as simulate_landmarks
from comparisons.logs.simulate.scan_drive import dense_slam, dense_slam_fine, occupancy, simulate
from comparisons.report.picture import save

SICK = (0.02, math.radians(0.1))
TABLE_3_1 = (0.15, math.radians(1.5))
TABLE_4_1 = (0.10, math.radians(1.0))
ROWS = {
    "scan-loop": ("scan-loop", TABLE_3_1),
    "scan-loop-fine": ("scan-loop-fine", SICK),
    "occupancy-loop": ("occupancy-loop", SICK),
    "its noisy beams": ("occupancy-loop", TABLE_4_1),
    "simulated-loop": ("simulated-loop", SICK),
}


def drive(name: str, seed: int) -> Log:
    """One simulated log."""
    rng = np.random.default_rng(seed)
    if name == "simulated-loop":
        return simulate_landmarks(rng, Drive(extra_s=10.0))
    made = {"scan-loop": dense_slam, "scan-loop-fine": dense_slam_fine, "occupancy-loop": occupancy}
    return simulate(rng, made[name]())


def pooled(each: list[NeglectedChange]) -> NeglectedChange:
    """The regions of several drives."""
    columns = zip(*(vars(one).values() for one in each), strict=True)
    return NeglectedChange(*(np.concatenate(column) for column in columns))


def main() -> None:
    """Print the table, and draw the first seed's figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()
    columns = "regions agreement explained expected slope  sigma_m bounded median"
    print(f"{'log':<16} {columns}")
    for title, (name, sigma) in ROWS.items():
        each = [
            neglected_change(drive(name, seed), sigma, np.random.default_rng(100 + seed))
            for seed in range(options.seeds)
        ]
        found = pooled(each)
        print(
            f"{title:<16} {len(found.time_s):7d} {min(one.agreement for one in each):9.4f} "
            f"{found.explained:9.2f} {found.expected:8.2f} {found.slope:5.2f} "
            f"{np.median(found.sigma_m):8.3f} {found.within_two_sigmas:7.3f} "
            f"{np.median(found.in_sigmas):6.2f}"
        )
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        example = decorrelation_example(drive("simulated-loop", 0))
        save(decorrelation_figure(example), options.figures / "decorrelation.png")
        save(displacement_figure(example), options.figures / "displacement.png")
        save(neglected_figure(found), options.figures / "neglected.png")


if __name__ == "__main__":
    main()
