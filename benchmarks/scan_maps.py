"""DenseSLAM between scan landmarks (Nieto 2005, section 6.2.1): layers before and after the loop.

    python benchmarks/scan_maps.py [--log scan-slam-maps] [--first 0] [--seeds 3]

Per drive: the filter's error at all times and at the end, the largest sigma of its position,
regions, median distances of what the layers hold to the true surfaces before the update that moved
the map the most and in the end, and processor time.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import numpy as np

from comparisons.config import MapConfig
from comparisons.extensions.dense_maps.accuracy import surface_error
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.pipeline.dense_map import map_log

LAYERS = ("occupancy", "sog")


def measured(name: str, seed: int) -> str:
    """One drive, as a row."""
    log = open_log(name, choices=SimulationChoices(seed))
    start = time.process_time()
    extensions = {"scan_landmarks": {"landmarks": "scans"}, "dense_maps": {"layers": LAYERS}}
    m = map_log(log, MapConfig.of(extensions=extensions))
    cpu_s = time.process_time() - start
    truth, surfaces, before = log.truth.poses, log.truth.surfaces, m.dense.before
    if truth is None or surfaces is None:
        raise ValueError(f"{name}: no true poses, or no true surfaces")
    e = m.ekf.estimate
    off = np.hypot(*(e.pose - truth.at(e.time_s))[:, :2].T)
    sigma = np.sqrt(max(np.linalg.eigvalsh(spread[:2, :2])[-1] for spread in e.pose_covariance))
    figures = [
        float(np.sqrt(np.square(off).mean())),
        float(off[-1]),
        float(sigma),
        len(m.placed.triangle),
    ]
    for layer in LAYERS:
        first = float("nan")
        if before is not None:
            first = surface_error(before.layers[layer], surfaces.segment).median_m
        figures += [first, m.errors[layer].median_m]
    return " ".join(f"{value:8.3g}" for value in (*figures, cpu_s))


def main() -> None:
    """Run all and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--log", default="scan-slam-maps")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=3)
    choices = parser.parse_args()
    names = ["ate", "end", "sigma", "regions"]
    names += [f"{layer} {when}" for layer in ("og", "sog") for when in ("bef.", "aft.")]
    names.append("cpu_s")
    print("seed", " ".join(f"{name:>8}" for name in names))
    for seed in range(choices.first, choices.first + choices.seeds):
        print(f"{seed:4}", measured(choices.log, seed), flush=True)


if __name__ == "__main__":
    main()
