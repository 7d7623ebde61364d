"""High level landmarks: what they are worth to the vehicle.

    python -m research.high_level [--first 100] [--seeds 30] [--loops 2] [--every 20]

`occupancy-loop` (Nieto 2005, section 6.1.3) with and without them, seed by seed; errors of the
vehicle over the whole drive and from the second loop on, and whether they differ. The 30 seeds from
100 were chosen before any of them was driven; the settings, on seeds 0 to 9.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.timeline import build_timeline
from comparisons.config import EkfConfig
from comparisons.extensions.high_level.source import HighLevelOptions, HighLevelSource
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.statistics import mean_band, squared_distance
from ekf_reference.core.geometry import wrap_angle

Array = NDArray[np.float64]

LOOP_S = 77.0
LEVEL = 0.05
ERRORS = ("position [m]", "heading [deg]", "position, 2nd", "heading, 2nd")
COLUMNS = (*ERRORS, "NEES", "NEES, end")


class HighLevelSeed(NamedTuple):
    """Of one seed. error: (2, 6) without and with landmarks; number: found, kept, measured."""

    error: Array
    number: tuple[int, int, int]
    looks: Mapping[str, int]


def errors(log: Log, run: EkfRun) -> Array:
    """(6,) of the vehicle: root mean squares over the drive and after a loop; NEES, mean, last."""
    poses, time_s = log.truth.poses, run.estimate.time_s
    assert poses is not None
    error = run.departed - poses.at(time_s)
    error[:, 2] = wrap_angle(error[:, 2])
    covariance = run.estimate.pose_covariance[1:]
    nees = squared_distance(error[1:], covariance)
    later = time_s > LOOP_S

    def rms(rows: NDArray[np.bool_]) -> tuple[float, float]:
        squared = np.square(error[rows])
        position, heading = squared[:, :2].sum(axis=1).mean(), squared[:, 2].mean()
        return float(np.sqrt(position)), float(np.degrees(np.sqrt(heading)))

    return np.array((*rms(time_s >= 0.0), *rms(later), nees.mean(), nees[-1]))


def driven(seed: int, loops: int, every_s: float) -> HighLevelSeed:
    """Without and with them; without, no map is made."""
    log = open_log("occupancy-loop", None, 1, SimulationChoices(seed, loops, 1.0))
    source = HighLevelSource(log, HighLevelOptions(every_s=every_s))
    config, timeline = settle(EkfConfig(), log), build_timeline(log)
    setups = FilterSetup(), FilterSetup(source=source)
    both = [errors(log, run_ekf(log, timeline, config, setup=setup)) for setup in setups]
    made = source.run()
    kept = int(np.count_nonzero(made.landmark_index >= 0))
    number = len(made.landmark_index), kept, made.looks.get("seen", 0)
    return HighLevelSeed(np.array(both), number, made.looks)


def value_of_landmarks(seeds: Sequence[int], loops: int, every_s: float) -> None:
    """Paired over the seeds."""
    print(f"occupancy-loop, {loops} loops, a search every {every_s:g} s; without -> with")
    print("seed  found  kept  measured   " + "   ".join(f"{name:>16}" for name in COLUMNS))
    drives, looks = list[HighLevelSeed](), Counter[str]()
    for seed in seeds:
        drives.append(driven(seed, loops, every_s))
        looks.update(drives[-1].looks)
        found, kept, measured = drives[-1].number
        pair = shown(*drives[-1].error)
        print(f"{seed:4d}  {found:5d}  {kept:4d}  {measured:8d}   {pair}", flush=True)
    error = np.array([one.error for one in drives])
    found, kept, measured = np.mean([one.number for one in drives], axis=0)
    pair = shown(*error.mean(axis=0))
    print(f"mean  {found:5.1f}  {kept:4.1f}  {measured:8.1f}   {pair}")
    print("looks: " + ", ".join(f"{n} {name}" for name, n in looks.most_common()))
    low, high = mean_band(len(seeds), 3)
    print(f"NEES: 95 % band of the mean at one instant {low:.2f} to {high:.2f}")
    if len(seeds) > 1:
        print("\n".join(judged(error[:, 1] - error[:, 0])))


def judged(change: Array) -> list[str]:
    """Mean changes (n, 6) by the paired t test and the sign test, both two-sided, and a verdict.

    A gain is a mean error that is smaller at 5 % by the t test, by Holm's correction for all four.
    """
    lines = ["change              mean  std. error       t   p (t)   less in   p (sign)"]
    count = len(change)
    t, p = stats.ttest_1samp(change, 0.0)
    sigma = change.std(axis=0, ddof=1) / np.sqrt(count)
    for k, name in enumerate(COLUMNS):
        less, more = int((change[:, k] < 0.0).sum()), int((change[:, k] > 0.0).sum())
        sign = stats.binomtest(less, less + more).pvalue if less + more else np.nan
        lines.append(
            f"{name:15} {change[:, k].mean():+8.4f}  {sigma[k]:10.4f}  {t[k]:+6.2f}  {p[k]:7.4f}"
            f"  {less:2d} of {count:2d}  {sign:9.4f}"
        )
    order = np.argsort(p[: len(ERRORS)])
    holm = np.maximum.accumulate(p[order] * np.arange(len(ERRORS), 0, -1))
    gains = [
        ERRORS[k] for k, p_all in zip(order, holm, strict=True) if p_all < LEVEL and t[k] < 0.0
    ]
    verdict = "gain significant at 5 %: " + "; ".join(gains) if gains else "no significant gain"
    return [*lines, verdict]


def shown(without: Array, with_them: Array) -> str:
    """Two rows of errors side by side."""
    pairs = zip(without, with_them, strict=True)
    return "   ".join(f"{a:6.3f} -> {b:6.3f}" for a, b in pairs)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--seeds", type=int, default=30, help="number of seeds")
    parser.add_argument("--loops", type=int, default=2)
    parser.add_argument("--every", type=float, default=20.0, help="seconds between two searches")
    choices = parser.parse_args()
    seeds = range(choices.first, choices.first + choices.seeds)
    value_of_landmarks(seeds, choices.loops, choices.every)


if __name__ == "__main__":
    main()
