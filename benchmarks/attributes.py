"""Association with more than position: trees by their diameter, reflectors by their intensity.

    python benchmarks/attributes.py [--seeds 10] [--victoria-park DIR] [--car-park DIR]

Simulated: pairs of trees 0.6 m apart along Nieto's loop, scored by the true landmarks. Victoria
Park: what is recognised after blind stretches, what the diameters scatter by, and the whole run
without and with them. Car park: what intensities say.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from comparisons.adapters.attributes import measured_attributes
from comparisons.adapters.ekf_factory import build_association, build_ekf, settle
from comparisons.adapters.ekf_run import EkfRun, run_ekf
from comparisons.adapters.timeline import build_timeline
from comparisons.checks.accuracy import assess
from comparisons.checks.association import score_partition
from comparisons.config import EkfConfig
from comparisons.logs.log import Log
from comparisons.logs.readers import acfr_car_park, victoria_park
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.logs.simulate.worlds import World, nieto_loop
from ekf_reference.association.attributes import RememberedAttributes
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.trace import Trace

LandmarkIndices = NDArray[np.intp]
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
    world = World(world.path, np.vstack((world.landmark, beside)))
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


def simulated(seeds: int, loops: float) -> None:
    """Pairs of trees, by nearest neighbour and joint compatibility."""
    print(f"pairs of trees {APART_M} m apart, {seeds} drives: precision, recall, landmarks, ATE")
    for association in ("nn", "jcbb"):
        for attributes in ("off", "on"):
            rows = []
            for seed in range(seeds):
                log = paired_trees(seed, loops)
                done = run(log, "compressed", association, attributes)
                score = score_partition(
                    done.landmark_index, log.measurements.landmark[: len(done.landmark_index)]
                )
                accuracy = assess(done.estimate, log, labelled=False)
                ate = np.nan if accuracy is None else accuracy.ate_m
                rows.append((score.precision, score.recall, len(done.estimate.landmark), ate))
            median = np.median(np.array(rows, dtype=float), axis=0)
            worst = np.min(np.array(rows, dtype=float)[:, :2], axis=0)
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
    for association in ("nn", "jcbb"):
        for attributes in ("off", "on"):
            done = run(log, "compressed", association, attributes)
            true = reference[: len(done.landmark_index)]
            score = score_partition(done.landmark_index[true >= 0], true[true >= 0])
            accuracy = assess(done.estimate, log, labelled=False)
            assert accuracy is not None
            print(
                f"{association:5} {attributes:4} {score.precision:.3f} {score.recall:.3f} "
                f"{len(done.estimate.landmark)} {done.unused['ambiguous']} "
                f"{done.unused['candidate']} {accuracy.gps_median_aligned_m:.2f} "
                f"{accuracy.gps_rms_aligned_m:.2f} m",
                flush=True,
            )


class Course:
    """A filter stepped through a log, so that it can be copied on the way and go on blindly."""

    def __init__(self, log: Log) -> None:
        """Stands before the first epoch."""
        self.timeline, seen = build_timeline(log), log.measurements
        self.time_s = self.timeline.epoch_time_s
        self._until = self.timeline.steps_until(), self.timeline.measurements_until()
        self._z = np.column_stack((seen.range_m, seen.bearing_rad))
        self._sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
        self._label, self._reported = seen.landmark, measured_attributes(log)

    def rows(self, epoch: int) -> LandmarkIndices:
        """The measurements of an epoch."""
        return np.arange(self._until[1][epoch], self._until[1][epoch + 1])

    def move(self, ekf: Ekf, epoch: int) -> None:
        """Predict up to an epoch from the one before."""
        steps, line = self._until[0], self.timeline
        for i in range(int(steps[epoch - 1]) if epoch else 0, int(steps[epoch])):
            duration = float(line.step_duration_s[i])
            ekf.predict(line.control[i], line.control_covariance[i], duration)

    def look(self, ekf: Ekf, epoch: int) -> LandmarkIndices:
        """Fuse what is seen there."""
        rows = self.rows(epoch)
        if not len(rows):
            return np.zeros(0, dtype=np.intp)
        return ekf.observe(
            self._z[rows],
            self._sigma[rows],
            self._label[rows],
            float(self.time_s[epoch]),
            self._reported.take(rows),
        )


class Stretch(NamedTuple):
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
    course: Course, ekf: Ekf, epoch: int, length_s: float
) -> tuple[LandmarkIndices, LandmarkIndices]:
    """Run a filter on from an epoch without measurements; return rows and landmark indices."""
    landmark_indices, rows = [], []
    for j in range(epoch + 1, len(course.time_s)):
        since = course.time_s[j] - course.time_s[epoch]
        if since > length_s + AFTER_S:
            break
        course.move(ekf, j)
        if since > length_s:
            rows.append(course.rows(j))
            landmark_indices.append(course.look(ekf, j))
    return np.concatenate(rows), np.concatenate(landmark_indices)


def lost(log: Log, association: str, blind_s: list[float], every_s: float) -> None:
    """Blind from here on for a while: is what is seen afterwards taken for what it is?

    At regular times the filter, which goes by position but remembers diameters, is copied twice;
    both copies drive on without measurements, and only one of them uses diameters afterwards. The
    filter that was never blind says what is right.
    """
    choices = settle(EkfConfig(filter="compressed", association=association, attributes="on"), log)
    course, ekf = Course(log), build_ekf(log, choices, Trace())
    using = ekf.association
    assert isinstance(using, RememberedAttributes)
    by_position = build_association(log, choices.model_copy(update={"attributes": "off"}))
    ekf.association = RememberedAttributes(by_position, using.memory)
    true = np.full(len(log.measurements.time_s), -1, dtype=np.intp)
    found: list[Stretch] = []
    begins = np.arange(
        log.prior.time_s + 2.0 * every_s, log.end_s - max(blind_s) - AFTER_S, every_s
    )
    starts = set(np.searchsorted(course.time_s, begins).tolist())
    for k in range(len(course.time_s)):
        course.move(ekf, k)
        true[course.rows(k)] = course.look(ekf, k)
        if k not in starts:
            continue
        for length in blind_s:
            for attributes in ("off", "on"):
                copied, rule = copy.deepcopy((ekf, using))
                if attributes == "on":
                    copied.association = rule
                seen = blindly(course, copied, k, length)
                found.append(Stretch(length, attributes, ekf.state.landmark_count, *seen))
    print_stretches(log, association, blind_s, found, true)


def print_stretches(
    log: Log, association: str, blind_s: list[float], found: list[Stretch], true: LandmarkIndices
) -> None:
    """How the measurements after blind stretches were taken, by length and use of attributes.

    true: (M,) what the filter that was never blind took every measurement for.
    """
    print(
        f"{log.name}, blind for, {association}, attributes: measurements of known landmarks in the "
        f"{AFTER_S:g} s after, taken for the right one, a wrong one, unused; stretches mostly right"
    )
    for length in blind_s:
        right: dict[str, list[float]] = {}
        for attributes in ("off", "on"):
            counts, right[attributes] = np.zeros(3), []
            for one in found:
                known = (true[one.rows] >= 0) & (true[one.rows] < one.known)
                if one[:2] != (length, attributes) or not known.any():
                    continue
                said, meant = one.landmark_indices[known], true[one.rows][known]
                counts += [(said == meant).sum(), ((said >= 0) & (said != meant)).sum(),
                           (said < 0).sum()]  # fmt: skip
                right[attributes].append(float((said == meant).mean()))
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
    for attributes in ("off", "on"):
        done = run(log, "full", "nn", attributes)
        place, landmark_index = done.estimate.landmark, done.landmark_index
        away = np.linalg.norm(place[:, None] - truth.position_m[None], axis=2).min(axis=1)
        beacon = away <= 0.5
        accuracy = assess(done.estimate, log, labelled=False)
        assert accuracy is not None
        print(
            f"car park, attributes {attributes}: {beacon.sum()} landmarks at beacons, "
            f"{(~beacon).sum()} elsewhere, {done.unused['ambiguous']} ambiguous, beacons' RMSE "
            f"{accuracy.landmark_rmse_m:.3f} m"
        )
        if attributes == "on":
            continue
        used = landmark_index >= 0
        of_beacon = np.zeros(len(landmark_index), dtype=bool)
        of_beacon[used] = beacon[landmark_index[used]]
        distance, lit = (
            log.measurements.range_m[: len(landmark_index)],
            log.measurements.intensity[: len(landmark_index)],
        )
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

    reference, times = (
        run(log, "full", "nn", "off").landmark_index,
        np.unique(log.measurements.time_s),
    )
    scan = np.searchsorted(times, log.measurements.time_s)
    for every in (5, 10, 20, 40):
        kept = scan % every == 0
        part, reported = replace(log, measurements=log.measurements.chosen(kept)), []
        for attributes in ("off", "on"):
            landmark_index = run(part, "full", "nn", attributes).landmark_index
            true = reference[kept][: len(landmark_index)]
            score = score_partition(landmark_index[true >= 0], true[true >= 0])
            reported.append(f"{attributes} {score.precision:.3f} {score.recall:.3f}")
        print(f"  every {every} scans, pairs' precision and recall: {', '.join(reported)}")


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--loops", type=float, default=2.0)
    parser.add_argument("--victoria-park", type=Path)
    parser.add_argument("--lost", type=float, nargs="+", default=[5.0, 10.0, 20.0, 40.0])
    parser.add_argument("--every", type=float, default=20.0)
    parser.add_argument("--car-park", type=Path)
    given = parser.parse_args()
    if given.seeds:
        simulated(given.seeds, given.loops)
        lost(paired_trees(0, given.loops), "nn", given.lost, given.every)
    if given.car_park is not None:
        car_park(given.car_park)
    if given.victoria_park is not None:
        log = victoria_park.read(given.victoria_park)
        for association in ("nn", "jcbb"):
            lost(log, association, given.lost, given.every)
        park(log)


if __name__ == "__main__":
    main()
