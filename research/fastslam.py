"""FastSLAM on Victoria Park: error, depletion and cost over the number of particles.

    python -m research.fastslam [--particles 10 30 100] [--seeds 1] [--labelled | --data DIR]
        [--agreement [--wheelbase F ...]]

By default the raw detections of Victoria Park (--data), which every particle associates for itself
by the likeliest pairs. A row a number of particles and seed: median
distance to the GPS, also after the rigid motion that fits best; particles of the first tenth and
of the middle of the log that have descendants at its end; mean share of the effective sample size;
resamplings; landmarks that most particles have; seconds of processor time, and how many times
faster than the log's own time.

--labelled: the bundled log `victoria-park` instead, with its labels; it has no GPS, so its error
is the median distance from the EKF's trajectory. --agreement: the clouds of `slamcheck run --third
fastslam` against the smoother, over stretches of the bundled Victoria Park and of simulated loops
of so many seeds, where FastSLAM alone has a wheelbase that is wrong by the factors F (1). p is that
of the energy distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import kstest

from comparisons.adapters.ekf_factory import build_ekf, settle
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.timeline import Timeline, build_timeline
from comparisons.arrays import Array
from comparisons.checks.accuracy import assess_trajectory
from comparisons.config import EkfConfig
from comparisons.extensions.fastslam.check import CloudCheck, check_clouds
from comparisons.extensions.fastslam.config import FastSlamConfig
from comparisons.extensions.fastslam.drive import Sampling, build_fastslam, run_fastslam
from comparisons.extensions.fastslam.stretches import StretchComparison
from comparisons.jobs.run import Comparison, compare
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.readers import victoria_park
from ekf_reference.core.trace import Trace
from research.script import options, present
from research.timing import ROOT, timed

DATA = ROOT.parent / "shared" / "data" / "victoria_park"
CLOUDS = FastSlamConfig().clouds
VERDICTS = {True: "agree", False: "disagree", None: "no verdict"}
HEAD = (
    f"{'particles':>9} {'seed':>4} {'error m':>8} {'aligned m':>9} {'first 10 %':>10} "
    f"{'middle':>6} {'ESS/N':>6} {'resampled':>9} {'landmarks':>9} {'cpu s':>7} {'real time':>9}"
)


def ekf_trajectory(log: Log, timeline: Timeline) -> Array:
    """The EKF's poses (K, 3), by the log's labels."""
    ekf = build_ekf(log, settle(EkfConfig(), log), Trace())
    return np.array([ekf.read_pose().pose for _ in run_filter_loop(ekf, log, timeline)])


def errors(log: Log, timeline: Timeline, mean: Array, reference: Array | None) -> tuple[float, str]:
    """Median distance from the reference, or to the GPS; and the same aligned."""
    if reference is not None:
        return float(np.median(np.linalg.norm((mean - reference)[:, :2], axis=1))), ""
    found = present(assess_trajectory(timeline.epoch_time_s, mean, log))
    return present(found.gps_median_m), f"{found.gps_median_aligned_m:.2f}"


def row(log: Log, timeline: Timeline, sampling: Sampling, reference: Array | None) -> str:
    """Run once."""
    slam = build_fastslam(log, sampling, known=log.measurements.labelled)
    cloud, cpu_s = timed(run_fastslam, slam, log, timeline)
    error_m, aligned_m = errors(log, timeline, cloud.mean, reference)
    distinct, n = slam.history.distinct(), sampling.particles
    resampled = sum(parents is not None for parents in slam.history.parents)
    landmarks = int((slam.mixture_map().share > 0.5).sum())
    span_s = timeline.epoch_time_s[-1] - timeline.epoch_time_s[0]
    return (
        f"{n:>9} {sampling.seed:>4} {error_m:>8.2f} {aligned_m:>9} "
        f"{distinct[len(distinct) // 10]:>10} {distinct[len(distinct) // 2]:>6} "
        f"{np.mean(slam.history.effective) / n:>6.2f} "
        f"{resampled:>9} {landmarks:>9} {cpu_s:>7.1f} {span_s / cpu_s:>9.1f}"
    )


def agreement(particles: int, seeds: int, wheelbases: Sequence[float]) -> None:
    """Print a row a seed and wheelbase, how many disagree, and whether p is uniform."""
    print(
        f"{'log':>14} {'wheelbase':>9} {'particles':>9} {'seed':>4} {'stretches':>9} {'mean s':>6} "
        f"{'energy':>6} {'p':>6} {'shift^2':>7} {'spread':>6} {'independent':>11} {'cpu s':>6}"
        "  verdict"
    )
    real = compare(open_log("victoria-park"))
    agreement_row(real, 1.0, Sampling(particles))
    found: dict[float, list[CloudCheck]] = {factor: [] for factor in wheelbases}
    for seed in range(seeds):
        loop = compare(open_log("simulated-loop", choices=SimulationChoices(seed=seed)))
        for factor in wheelbases:
            found[factor].append(agreement_row(loop, factor, Sampling(particles, seed=seed)))
    for factor, checks in found.items():
        said = [check.agrees for check in checks]
        uniform = kstest([check.p for check in checks], "uniform").pvalue
        print(
            f"wheelbase x {factor:g}: {said.count(False)} of {seeds} disagree, "
            f"{said.count(True)} agree, {said.count(None)} without verdict; "
            f"p uniform: Kolmogorov and Smirnov's p {uniform:.2g}"
        )


def agreement_row(found: Comparison, wheelbase: float, sampling: Sampling) -> CloudCheck:
    """Compare once; FastSLAM alone has a wheelbase that is wrong by a factor."""
    log = found.prepared.log if wheelbase == 1.0 else with_wheelbase(found.prepared.log, wheelbase)
    clouds, cpu_s = timed(StretchComparison(found.known.gaps, log, sampling).run, CLOUDS)
    check = check_clouds(clouds)
    length_s = np.mean([one.end_s - one.begin_s for one in check.stretches])
    exact = check.exact
    print(
        f"{log.name:>14} {wheelbase:>9g} {sampling.particles:>9} {sampling.seed:>4} "
        f"{len(check.stretches):>9} {length_s:>6.1f} {check.energy:>6.2f} {check.p:>6.4f} "
        f"{check.squared_shift:>7.2f} {check.spread:>6.2f} {check.independent:>11.1f} "
        f"{cpu_s:>6.1f}  {VERDICTS[check.agrees]}"
        + (f" (exact posterior: p {exact.clouds:.4f})" if exact is not None else ""),
        flush=True,
    )
    return check


def with_wheelbase(log: Log, factor: float) -> Log:
    """The log with a wheelbase that is wrong by a factor."""
    odometry = log.odometry
    assert isinstance(odometry, SteeringOdometry)
    vehicle = replace(odometry.vehicle, wheelbase_m=factor * odometry.vehicle.wheelbase_m)
    return replace(log, odometry=replace(odometry, vehicle=vehicle))


def main() -> None:
    """Print the table."""
    given = options(
        __doc__,
        particles=(10, 30, 100),
        seeds=1,
        labelled=False,
        data=DATA,
        agreement=False,
        wheelbase=(1.0,),
    )
    if given.agreement:
        for particles in given.particles:
            agreement(particles, given.seeds, given.wheelbase)
        return
    log = open_log("victoria-park") if given.labelled else victoria_park.read(given.data)
    timeline = build_timeline(log)
    reference = ekf_trajectory(log, timeline) if given.labelled else None
    default = Sampling(1)
    print(
        f"{log.name}, {len(timeline.epoch_time_s):,} epochs, proposal {default.proposal}, "
        f"choice {default.choice}"
    )
    print(HEAD)
    for particles in given.particles:
        for seed in range(given.seeds):
            print(row(log, timeline, Sampling(particles, seed=seed), reference), flush=True)


if __name__ == "__main__":
    main()
