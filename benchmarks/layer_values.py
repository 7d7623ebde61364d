"""Association by what a layer of the dense map holds around landmarks (Nieto 2005, section 6.4).

    python benchmarks/layer_values.py [--seeds 5] [--loops 1] [--car-park DIR]

Simulated: Nieto's poles of different colours, two of them within one gate, with and without the
layer, scored by the true poles; and with colours that are mixed up from scan to scan, which tell
nothing. Car park: what the intensities of raw scans say of its reflectors.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.accuracy import assess
from comparisons.checks.association import score_partition
from comparisons.extensions.dense_maps.source import DenseWatcher
from comparisons.logs.log import Log
from comparisons.logs.readers import acfr_car_park
from comparisons.logs.simulate.drive import Drive
from comparisons.logs.simulate.scan_drive import ScanExperiment, simulate
from comparisons.logs.simulate.scan_worlds import ScanWorld
from comparisons.logs.simulate.scanners import Planar
from comparisons.logs.simulate.worlds import nieto_loop
from comparisons.pipeline.compare import run_filter
from comparisons.pipeline.prepare import prepare
from comparisons.settings import run_config

Array = NDArray[np.float64]

APART_M = 0.6
DIAMETER_M = 0.2
COLOURS = (1.0, 3.0)
SIGMA_COLOUR = 0.3


def coloured_poles(seed: int, loops: float, *, mixed: bool = False) -> Log:
    """Nieto's loop, every landmark one of two poles of different colours.

    mixed: each return has one of the colours at random.
    """
    rng, plain = np.random.default_rng(seed), nieto_loop()
    turn = rng.uniform(0.0, 2.0 * np.pi, len(plain.landmark))
    beside = plain.landmark + APART_M * np.column_stack((np.cos(turn), np.sin(turn)))
    landmark = np.vstack((plain.landmark, beside))
    count = len(landmark)
    pole = np.column_stack((landmark, np.full(count, DIAMETER_M)))
    world = ScanWorld(
        path=plain.path, landmark=landmark, pole=pole, pole_height_m=np.full(count, 2.0)
    )
    drive = Drive(
        loops=0, extra_s=loops * Drive.loop_s, sigma_range_m=0.05,
        sigma_bearing_rad=math.radians(0.3), max_range_m=20.0, sigma_speed_mps=0.5,
        sigma_steering_rad=math.radians(5.0),
    )  # fmt: skip
    scanner = Planar(
        max_range_m=drive.max_range_m, sigma_range_m=0.02, sigma_beam_rad=math.radians(0.1)
    )
    log = simulate(rng, ScanExperiment("coloured-poles", __doc__, world, drive, scanner))
    first = rng.integers(0, 2, count // 2)
    colour = np.array(COLOURS)[np.concatenate((first, 1 - first))]
    scans, path = log.scans, log.truth.poses
    assert scans is not None
    assert path is not None
    pose = np.column_stack([np.interp(scans.time_s, path.time_s, c) for c in path.pose.T])
    shown = np.zeros_like(scans.range_m)
    for k, (way, at) in enumerate(zip(scans.range_m, pose, strict=True)):
        met = np.flatnonzero(np.isfinite(way))
        ray = at[2] + scans.angle_rad[met]
        point = at[:2] + way[met, None] * np.column_stack((np.cos(ray), np.sin(ray)))
        which = np.linalg.norm(point[:, None] - landmark, axis=2).argmin(axis=1)
        own = rng.choice(COLOURS, len(met)) if mixed else colour[which]
        shown[k, met] = rng.normal(own, SIGMA_COLOUR)
    return replace(log, scans=replace(scans, intensity=shown))


def run(log: Log, association: str, attributes: str) -> tuple[EkfRun, DenseWatcher | None]:
    """The filter, beside it the layer where it is asked for."""
    config = run_config(association=association, attributes=attributes)
    done, beside = run_filter(prepare(log, config))
    return done, beside.find(DenseWatcher)


def simulated(seeds: int, loops: float) -> None:
    """Pairs of poles, by nearest neighbour and joint compatibility."""
    print(f"pairs of poles {APART_M} m apart, {seeds} drives, medians (worst):")
    print("  pairs' precision and recall, measurements left out as ambiguous, landmarks, ATE,")
    print("  share of the landmarks that the layer knows")
    for association in ("nn", "jcbb"):
        for name, attributes in (("off", "off"), ("layer", "layer"), ("mixed", "layer")):
            rows = []
            for seed in range(seeds):
                log = coloured_poles(seed, loops, mixed=name == "mixed")
                done, watcher = run(log, association, attributes)
                score = score_partition(
                    done.landmark_index, log.measurements.landmark[: len(done.landmark_index)]
                )
                accuracy = assess(done.estimate, log, labelled=False)
                assert accuracy is not None
                count = len(done.estimate.landmark)
                known = np.nan
                if watcher is not None:
                    known = float((watcher.values_at(np.arange(count)).returns > 0).mean())
                left_out = done.unused["ambiguous"]
                rows.append((score.precision, score.recall, left_out, count, accuracy.ate_m, known))
            table = np.array(rows, dtype=float)
            middle, worst = np.median(table, axis=0), table[:, :2].min(axis=0)
            print(
                f"{association:5} {name:6} {middle[0]:.3f} {middle[1]:.3f} ({worst[0]:.3f} "
                f"{worst[1]:.3f}) {middle[2]:.0f} {middle[3]:.0f} {middle[4]:.2f} m "
                f"{middle[5]:.2f}",
                flush=True,
            )


def car_park(folder: Path) -> None:
    """What the layer of intensities says there; the run that has all scans is the reference."""
    log = acfr_car_park.read(folder)
    truth = log.truth.landmarks
    assert truth is not None
    for attributes in ("off", "layer"):
        done, watcher = run(log, "nn", attributes)
        away = np.linalg.norm(done.estimate.landmark[:, None] - truth.position_m[None], axis=2).min(
            axis=1
        )
        accuracy = assess(done.estimate, log, labelled=False)
        assert accuracy is not None
        print(
            f"car park, {attributes}: {(away <= 0.5).sum()} landmarks at beacons, "
            f"{(away > 0.5).sum()} elsewhere, {done.unused['ambiguous']} ambiguous, beacons' RMSE "
            f"{accuracy.landmark_rmse_m:.3f} m"
        )
        if watcher is not None:
            held = watcher.values_at(np.arange(len(away)))
            for name, rows in (("beacons", away <= 0.5), ("others", away > 0.5)):
                rows = rows & (held.returns > 0)
                mean, within = held.mean[rows], np.sqrt(held.variance[rows])
                print(
                    f"  {name}: {rows.sum()} in the layer, intensity {mean.mean():.2f} +- "
                    f"{mean.std():.2f} between them, {within.mean():.2f} within"
                )
    reference, times = run(log, "nn", "off")[0].landmark_index, np.unique(log.measurements.time_s)
    scan = np.searchsorted(times, log.measurements.time_s)
    for every in (5, 10, 20, 40):
        kept = scan % every == 0
        part, reported = replace(log, measurements=log.measurements.chosen(kept)), []
        for attributes in ("off", "layer"):
            landmark_index = run(part, "nn", attributes)[0].landmark_index
            true = reference[kept][: len(landmark_index)]
            score = score_partition(landmark_index[true >= 0], true[true >= 0])
            reported.append(f"{attributes} {score.precision:.3f} {score.recall:.3f}")
        print(
            f"  every {every} scans, pairs' precision and recall: {', '.join(reported)}", flush=True
        )


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--loops", type=float, default=1.2)
    parser.add_argument("--car-park", type=Path)
    given = parser.parse_args()
    if given.seeds:
        simulated(given.seeds, given.loops)
    if given.car_park is not None:
        car_park(given.car_park)


if __name__ == "__main__":
    main()
