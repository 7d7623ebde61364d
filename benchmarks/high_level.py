"""High level landmarks: what they are worth to the vehicle, and what looking for them costs.

    python benchmarks/high_level.py [--only drives size] [--seeds 10] [--loops 2] [--every 20]
                                    [--sizes 11 101 1001] [--searches 20]

drives: `occupancy-loop` (Nieto 2005, section 6.1.3) with and without them, seed by seed; errors
of the vehicle over the whole drive and from the second loop on. size: one search in a patch of
regions, alike in maps of all sizes; times are of the processor.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections import Counter
from collections.abc import Sequence

import numpy as np
from dense_maps import Patches  # type: ignore[import-not-found]
from numpy.typing import NDArray

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.extensions.high_level.source import HighLevelOptions, HighLevelSource
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.scan_landmarks.high_level import Around, search

Array = NDArray[np.float64]

LOOP_S = 77.0
COLUMNS = ("position [m]", "heading [deg]", "position, 2nd", "heading, 2nd", "NEES")


def errors(log: Log, run: EkfRun) -> Array:
    """(5,) of the vehicle: root mean squares over the drive and after a loop, and mean NEES."""
    poses, time_s = log.truth.poses, run.estimate.time_s
    assert poses is not None
    error = run.departed - poses.at(time_s)
    error[:, 2] = wrap_angle(error[:, 2])
    covariance = run.estimate.pose_covariance[1:]
    nees = np.einsum("ki,ki->k", error[1:], np.linalg.solve(covariance, error[1:, :, None])[..., 0])
    later = time_s > LOOP_S

    def rms(rows: NDArray[np.bool_]) -> tuple[float, float]:
        squared = np.square(error[rows])
        position, heading = squared[:, :2].sum(axis=1).mean(), squared[:, 2].mean()
        return float(np.sqrt(position)), float(np.degrees(np.sqrt(heading)))

    return np.array((*rms(time_s >= 0.0), *rms(later), float(nees.mean())))


def driven(log: Log, source: HighLevelSource | None) -> Array:
    """The filter's errors with a source, or without."""
    setup = FilterSetup() if source is None else FilterSetup(source=source)
    config = settle(EkfConfig(), log)
    return errors(log, run_ekf(log, build_timeline(log), config, setup=setup))


def value_of_landmarks(seeds: int, loops: int, every_s: float) -> None:
    """Paired over the seeds."""
    pairs, looks, found, kept = [], Counter[str](), [], []
    print(f"occupancy-loop, {loops} loops, a search every {every_s:g} s; without -> with")
    print("seed  found  kept   " + "   ".join(f"{name:>16}" for name in COLUMNS))
    for seed in range(seeds):
        log = open_log("occupancy-loop", None, 1, SimulationChoices(seed, loops, 1.0))
        source = HighLevelSource(log, HighLevelOptions(every_s))
        pair = driven(log, None), driven(log, source)
        made = source.run()
        pairs.append(pair)
        looks.update(made.looks)
        found.append(len(made.landmark_index))
        kept.append(int(np.count_nonzero(made.landmark_index >= 0)))
        print(f"{seed:4d}  {found[-1]:5d}  {kept[-1]:4d}   " + shown(*pair), flush=True)
    both = np.array(pairs)
    change = both[:, 1] - both[:, 0]
    print(f"mean  {np.mean(found):5.1f}  {np.mean(kept):4.1f}   " + shown(*both.mean(axis=0)))
    spread = change.std(axis=0, ddof=1) / np.sqrt(seeds) if seeds > 1 else np.full(5, np.nan)
    reported = zip(COLUMNS, change.mean(axis=0), spread, (change < 0.0).sum(axis=0), strict=True)
    for name, mean, sigma, less in reported:
        print(f"{name:16} changes by {mean:+.3f} +- {sigma:.3f}; less in {less} of {seeds} drives")
    print("looks: " + ", ".join(f"{n} {name}" for name, n in looks.most_common()))


def shown(without: Array, with_them: Array) -> str:
    """Two rows of errors side by side."""
    pairs = zip(without, with_them, strict=True)
    return "   ".join(f"{a:6.3f} -> {b:6.3f}" for a, b in pairs)


def cost_against_size(sizes: Sequence[int], searches: int) -> None:
    """The same search in maps of all sizes, taking turns."""
    maps = [Patches.built(max(1, round(size / 10))) for size in sizes]
    for one in maps:
        for number in range(20):  # what was seen three times only is not occupied yet
            one.take(np.random.default_rng(number), number)
    around = [of_patches(one) for one in maps]
    spent, corners = np.empty((len(maps), searches)), [0] * len(maps)
    none = np.empty((0, 4, 2))
    for turn in range(searches):
        for row, one in enumerate(around):
            start = time.thread_time()
            made = search(one, none)
            spent[row, turn] = 1e3 * (time.thread_time() - start)
            corners[row] = len(made.corner)
    print("ms per search")
    print("regions  median   95 %   to the first  corners")
    for patches, times, number in zip(maps, spent, corners, strict=True):
        median, most = np.percentile(times, (50.0, 95.0))
        share = median / np.median(spent[0])
        regions = len(patches.dense.regions.base)
        print(f"{regions:7d}  {median:6.1f}  {most:5.1f}  {share:12.2f}  {number:7d}")


def of_patches(one: Patches) -> Around:
    """What a search reads, the vehicle in the first patch."""
    layers, placed = one.dense.layers, one.dense.regions.placed(one.landmark)
    return Around(layers["occupancy"], layers["sog"], placed, np.zeros(3), one.landmark)


def main() -> None:
    """Measure and print."""
    parts = ("drives", "size")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", nargs="+", choices=parts, default=parts)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--loops", type=int, default=2)
    parser.add_argument("--every", type=float, default=20.0, help="seconds between two searches")
    parser.add_argument("--sizes", type=int, nargs="+", default=[11, 101, 1001])
    parser.add_argument("--searches", type=int, default=20)
    choices = parser.parse_args()
    if "drives" in choices.only:
        value_of_landmarks(choices.seeds, choices.loops, choices.every)
    if "size" in choices.only:
        cost_against_size(choices.sizes, choices.searches)


if __name__ == "__main__":
    main()
