"""Association with more than position: trees by their diameter, reflectors by their intensity.

    python -m research.attributes [--seeds 10] [--victoria-park DIR] [--car-park DIR]
                                    [--loops 2] [--lost 5 10 20 40] [--every 20]

Simulated: pairs of trees 0.6 m apart along Nieto's loop, scored by the true landmarks. Victoria
Park: what is recognised after blind stretches of so many seconds, what the diameters scatter by,
and the whole run without and with them. Car park: what intensities say.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from comparisons.adapters.attributes import measured_attributes
from comparisons.adapters.ekf_factory import build_association, build_ekf, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.filter_loop import run_filter_loop
from comparisons.adapters.time_window import cut_log
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import assess
from comparisons.checks.association import PartitionScore, score_partition
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from comparisons.logs.readers import acfr_car_park, victoria_park
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.simulate.worlds import LandmarkWorld, nieto_loop
from ekf_reference.association.attributes import RememberedAttributes
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import Trace
from research.script import options

LandmarkIndices = NDArray[np.intp]
ASSOCIATIONS, USE = ("nn", "jcbb"), ("off", "on")
APART_M = 0.6
DIAMETERS_M = (0.15, 0.9)
LONG_S = 60.0
FARTHEST_LAG = 20
LAG_S = 0.5
AFTER_S = 5.0


def paired_trees(seed: int, loops: float) -> Log:
    """Nieto's loop, a second tree beside every landmark, each of its own diameter."""
    rng = np.random.default_rng(seed)
    world = nieto_loop()
    turn = rng.uniform(0.0, 2.0 * np.pi, len(world.landmark))
    beside = world.landmark + APART_M * np.column_stack((np.cos(turn), np.sin(turn)))
    world = LandmarkWorld(world.path, np.vstack((world.landmark, beside)))
    log = simulate(rng, Drive(loops=0, extra_s=loops * Drive.loop_s), world)
    seen = log.measurements
    diameter = rng.uniform(*DIAMETERS_M, len(world.landmark))[seen.landmark]
    log = replace(log, measurements=replace(seen, diameter_m=diameter))
    sigma = np.sqrt(measured_attributes(log).variance[:, 0])
    measured = rng.normal(diameter, sigma)
    return replace(log, measurements=replace(seen, diameter_m=measured))


def run(log: Log, filter_name: str, association: str, attributes: str) -> EkfRun:
    """The filter over a log."""
    choices = settle(
        EkfConfig(filter=filter_name, association=association, attributes=attributes), log
    )
    return run_ekf(log, build_timeline(log), choices)


def scored(done: EkfRun, true: LandmarkIndices) -> PartitionScore:
    """How the run's measurements are put together, beside another's (M,), where both know."""
    true = true[: len(done.landmark_index)]
    return score_partition(done.landmark_index[true >= 0], true[true >= 0])


def simulated(seeds: int, loops: float) -> None:
    """Pairs of trees, by nearest neighbour and joint compatibility."""
    print(f"pairs of trees {APART_M} m apart, {seeds} drives: precision, recall, landmarks, ATE")
    for association, attributes in product(ASSOCIATIONS, USE):
        rows = []
        for seed in range(seeds):
            log = paired_trees(seed, loops)
            done = run(log, "compressed", association, attributes)
            score = scored(done, log.measurements.landmark)
            accuracy = assess(done.estimate, log, labelled=False)
            assert accuracy is not None
            assert accuracy.ate_m is not None
            rows.append(
                (score.precision, score.recall, len(done.estimate.landmark), accuracy.ate_m)
            )
        median, worst = np.median(rows, axis=0), np.min(rows, axis=0)
        print(
            f"{association:5} attributes {attributes:4} {median[0]:.3f} {median[1]:.3f} "
            f"{median[2]:.0f} {median[3]:.2f} m (worst {worst[0]:.3f} {worst[1]:.3f})"
        )


def scatter(log: Log, landmark_index: LandmarkIndices) -> None:
    """Diameter errors over pairs of distant measurements of one landmark (Guivant 2002, eq. 15)."""
    rng, used = np.random.default_rng(0), np.flatnonzero(landmark_index >= 0)
    first, second = [], []
    for landmark in range(int(landmark_index.max()) + 1):
        rows = used[landmark_index[used] == landmark]
        a, b = rng.choice(rows, (2, 400))
        apart = np.abs(log.measurements.time_s[a] - log.measurements.time_s[b]) > LONG_S
        first.append(a[apart])
        second.append(b[apart])
    a, b = np.concatenate(first), np.concatenate(second)
    seen = log.measurements
    error = (seen.diameter_m[a] - seen.diameter_m[b]) ** 2
    by = np.column_stack((seen.range_m[a] ** 2 + seen.range_m[b] ** 2, np.full(len(a), 2.0)))
    width, shape = np.sqrt(nnls(by, error)[0])
    variance = measured_attributes(log).variance[:, 0]
    share = error / (variance[a] + variance[b])
    print(
        f"diameters over {len(a)} pairs of measurements more than {LONG_S:g} s apart: least "
        "squares "
        f"{width:.4f} rad and {shape:.3f} m; as stated, mean square {share.mean():.2f}, median "
        f"{np.median(share):.2f} (0.45 of a Gaussian)"
    )
    order = used[np.lexsort((seen.time_s[used], landmark_index[used]))]
    mean = np.bincount(landmark_index[used], seen.diameter_m[used]) / np.bincount(
        landmark_index[used]
    )
    off = seen.diameter_m[order] - mean[landmark_index[order]]
    alike = []
    for lag in range(1, FARTHEST_LAG + 1):
        same = landmark_index[order[lag:]] == landmark_index[order[:-lag]]
        same &= seen.time_s[order[lag:]] - seen.time_s[order[:-lag]] < LAG_S * lag
        alike.append(float(np.corrcoef(off[lag:][same], off[:-lag][same])[0, 1]))
    print(
        f"  autocorrelation over measurements in a row {alike[0]:.2f}, {alike[4]:.2f} (5), "
        f"{alike[19]:.2f} (20); 1 + twice its sum to {FARTHEST_LAG}: {1.0 + 2.0 * sum(alike):.1f}"
    )


def park(log: Log) -> None:
    """Victoria Park without and with diameters."""
    reference = run(log, "compressed", "nn", "off").landmark_index
    scatter(log, reference)
    print("Victoria Park, attributes: pairs' precision and recall, landmarks, ambiguous,")
    print("  candidates, GPS median and RMS (aligned)")
    for association, attributes in product(ASSOCIATIONS, USE):
        done = run(log, "compressed", association, attributes)
        score = scored(done, reference)
        accuracy = assess(done.estimate, log, labelled=False)
        assert accuracy is not None
        print(
            f"{association:5} {attributes:4} {score.precision:.3f} {score.recall:.3f} "
            f"{len(done.estimate.landmark)} {done.unused['ambiguous']} "
            f"{done.unused['candidate']} {accuracy.gps_median_aligned_m:.2f} "
            f"{accuracy.gps_rms_aligned_m:.2f} m",
            flush=True,
        )


class BlindStretch(NamedTuple):
    """A blind stretch, and what was made of the measurements (S,) after it.

    attributes: `on` or `off`, for them. known: landmarks in the map before. rows: the measurements'
    numbers. landmark_indices: the landmarks they were taken for, or -1.
    """

    length_s: float
    attributes: str
    known: int
    rows: LandmarkIndices
    landmark_indices: LandmarkIndices


def blindly(
    log: Log, ekf: Ekf, begin_s: float, length_s: float
) -> tuple[LandmarkIndices, LandmarkIndices]:
    """Run a filter on from an epoch, at first without measurements; rows and landmark indices."""
    sees_s, seen_s = begin_s + length_s, log.measurements.time_s
    rows = np.flatnonzero((seen_s > sees_s) & (seen_s <= sees_s + AFTER_S))
    rest = cut_log(log, begin_s - log.prior.time_s, sees_s + AFTER_S - log.prior.time_s + 1.0)
    rest = replace(rest, measurements=log.measurements.chosen(rows))
    # The instants stay, and with them the steps.
    timeline = build_timeline(rest, looks=seen_s[(seen_s > begin_s) & (seen_s <= sees_s)])
    epochs = run_filter_loop(ekf, rest, timeline)
    return rows, np.concatenate([epoch.landmark_indices for epoch in epochs])


def lost(log: Log, association: str, blind_s: Sequence[float], every_s: float) -> None:
    """Blind from here on for a while: is what is seen afterwards taken for what it is?

    At regular times the filter, which goes by position but remembers diameters, is copied twice;
    both copies drive on without measurements, and only one of them uses diameters afterwards. The
    filter that was never blind says what is right.
    """
    log = replace(log, positions=None)
    choices = settle(EkfConfig(filter="compressed", association=association, attributes="on"), log)
    timeline, ekf = build_timeline(log), build_ekf(log, choices, Trace())
    using = ekf.association
    assert isinstance(using, RememberedAttributes)
    by_position = build_association(log, choices.model_copy(update={"attributes": "off"}))
    ekf.association = RememberedAttributes(by_position, using.memory)
    true = np.full(len(log.measurements.time_s), -1, dtype=np.intp)
    found: list[BlindStretch] = []
    begins = np.arange(
        log.prior.time_s + 2.0 * every_s, log.end_s - max(blind_s) - AFTER_S, every_s
    )
    starts = set(timeline.epoch_time_s[np.searchsorted(timeline.epoch_time_s, begins)].tolist())
    for epoch in run_filter_loop(ekf, log, timeline):
        true[epoch.rows] = epoch.landmark_indices
        for length, attributes in product(blind_s, USE) if epoch.time_s in starts else ():
            copied, rule = copy.deepcopy((ekf, using))
            if attributes == "on":
                copied.association = rule
            seen = blindly(log, copied, epoch.time_s, length)
            found.append(BlindStretch(length, attributes, ekf.state.landmark_count, *seen))
    print_stretches(f"{log.name}, blind for, {association}", found, true)


def print_stretches(title: str, found: list[BlindStretch], true: LandmarkIndices) -> None:
    """How the measurements after blind stretches were taken, by length and use of attributes.

    true: (M,) what the filter that was never blind took every measurement for.
    """
    print(
        f"{title}, attributes: measurements of known landmarks in the "
        f"{AFTER_S:g} s after, taken for the right one, a wrong one, unused; stretches mostly right"
    )
    for length in dict.fromkeys(one.length_s for one in found):
        right: dict[str, list[float]] = {}
        for attributes in USE:
            counts, right[attributes] = np.zeros(3), []
            for one in found:
                known = (true[one.rows] >= 0) & (true[one.rows] < one.known)
                if one[:2] != (length, attributes) or not known.any():
                    continue
                said, meant = one.landmark_indices[known], true[one.rows][known]
                hit, unused = said == meant, said < 0
                counts += (hit.sum(), (~hit & ~unused).sum(), unused.sum())
                right[attributes].append(float(hit.mean()))
            share = 100.0 * counts / counts.sum()
            print(
                f"{length:4g} s {attributes:4} {share[0]:.1f} {share[1]:.1f} {share[2]:.1f} %; "
                f"{sum(r > 0.5 for r in right[attributes])} of {len(right[attributes])}",
                flush=True,
            )
        more = np.sign(np.subtract(right["on"], right["off"]))
        print(f"     more right with them after {(more > 0).sum()}, less after {(more < 0).sum()}")


def car_park(folder: Path) -> None:
    """What the intensity of a lit run says: of beacons and of everything else that shines."""
    log = acfr_car_park.read(folder)
    truth = log.truth.landmarks
    assert truth is not None
    runs = {attributes: run(log, "full", "nn", attributes) for attributes in USE}
    for attributes, done in runs.items():
        away = np.linalg.norm(done.estimate.landmark[:, None] - truth.position_m, axis=2)
        beacon = away.min(axis=1) <= 0.5
        accuracy = assess(done.estimate, log, labelled=False)
        assert accuracy is not None
        print(
            f"car park, attributes {attributes}: {beacon.sum()} landmarks at beacons, "
            f"{(~beacon).sum()} elsewhere, {done.unused['ambiguous']} ambiguous, beacons' RMSE "
            f"{accuracy.landmark_rmse_m:.3f} m"
        )
        if attributes == "off":
            intensities(log, done.landmark_index, beacon)
    times = np.unique(log.measurements.time_s)
    scan = np.searchsorted(times, log.measurements.time_s)
    for every in (5, 10, 20, 40):
        kept = scan % every == 0
        part, reported = replace(log, measurements=log.measurements.chosen(kept)), []
        for attributes in USE:
            score = scored(run(part, "full", "nn", attributes), runs["off"].landmark_index[kept])
            reported.append(f"{attributes} {score.precision:.3f} {score.recall:.3f}")
        print(f"  every {every} scans, pairs' precision and recall: {', '.join(reported)}")


def intensities(log: Log, landmark_index: LandmarkIndices, beacon: NDArray[np.bool_]) -> None:
    """Intensities by distance, and how they vary. beacon: (L,) which landmarks are one."""
    used, seen = landmark_index >= 0, log.measurements
    of_beacon = used & beacon[landmark_index]
    distance, lit = (one[: len(used)] for one in (seen.range_m, seen.intensity))
    for low, high in ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0)):
        near = used & (distance >= low) & (distance < high)
        cells = [
            f"{name} {lit[rows].mean():.0f} +- {lit[rows].std():.0f} ({rows.sum()})"
            for name, rows in (("beacons", near & of_beacon), ("others", near & ~of_beacon))
            if rows.any()
        ]
        print(f"  intensity at {low:g} to {high:g} m: {', '.join(cells)}")
    mean = np.bincount(landmark_index[used], lit[used]) / np.bincount(landmark_index[used])
    within = lit[used] - mean[landmark_index[used]]
    print(
        f"  within landmarks {within.std():.0f}, between beacons {mean[beacon].std():.0f}, "
        f"median of all {np.median(lit):.0f}"
    )


def main() -> None:
    """Run what was asked for."""
    blind = (5.0, 10.0, 20.0, 40.0)
    given = options(
        __doc__, seeds=10, loops=2.0, victoria_park=Path, car_park=Path, lost=blind, every=20.0
    )
    if given.seeds:
        simulated(given.seeds, given.loops)
        lost(paired_trees(0, given.loops), "nn", given.lost, given.every)
    if given.car_park is not None:
        car_park(given.car_park)
    if given.victoria_park is not None:
        log = victoria_park.read(given.victoria_park)
        for association in ASSOCIATIONS:
            lost(log, association, given.lost, given.every)
        park(log)


if __name__ == "__main__":
    main()
