"""Dynamic regions over seeds: what is found, what is not, and what that spares the filter.

Against the thesis' two experiments (Nieto 2005, section 6.3.3): cell precision and recall on two
lanes, places found where three changed, cells found where nothing moves, and the error of a filter
with a landmark on a vehicle, with and without the dynamic layer, on the same logs.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from comparisons.checks.accuracy import assess
from comparisons.config import MapConfig
from comparisons.experiments.reproduction.dynamic_accuracy import middles, score_dynamic
from comparisons.logs.simulate.scan_drive import (
    ScanExperiment,
    dynamic_lanes,
    dynamic_places,
    simulate,
)
from comparisons.pipeline.dense_map import DenseMapping, map_log
from ekf_reference.dense.dynamic import DynamicLayer


def mapped(
    experiment: ScanExperiment, seed: int, *, looking: bool = True
) -> tuple[DenseMapping, DynamicLayer]:
    """A drive's map, and its dynamic layer; an empty one where it was not to look."""
    log = simulate(np.random.default_rng(seed), experiment)
    asked = {"dynamic": {}} if looking else {"dense_maps": {"layers": ["points"]}}
    mapping = map_log(log, MapConfig.of(extensions=asked))
    return mapping, mapping.dense.dense.dynamic or DynamicLayer()


def still(experiment: ScanExperiment) -> ScanExperiment:
    """The same without anything that moves."""
    return replace(experiment, world=replace(experiment.world, movers=()))


def main() -> None:
    """Print one line per question."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=30.0, help="of the drives with lanes")
    arguments = parser.parse_args()
    seeds = range(arguments.seeds)

    def lanes(*, carried: bool = False) -> ScanExperiment:
        experiment = dynamic_lanes(carried=carried)
        return replace(experiment, drive=replace(experiment.drive, loop_s=arguments.seconds))

    scores = []
    for seed in seeds:
        experiment = lanes()
        mapping, layer = mapped(experiment, seed)
        score = score_dynamic(
            layer, mapping.placed, experiment.world.movers, mapping.log.duration_s
        )
        scores.append((score.precision, score.recall))
    low, mean = np.min(scores, axis=0), np.mean(scores, axis=0)
    print(
        f"lanes: precision {mean[0]:.3f} (least {low[0]:.3f}), recall {mean[1]:.3f} ({low[1]:.3f})"
    )
    counts = []
    for seed in seeds:
        mapping, layer = mapped(dynamic_places(), seed)
        counts.append(len(middles(layer.points(mapping.placed))))
    exact = sum(count == 3 for count in counts)
    print(f"places: 3 found in {exact} of {len(counts)} drives, in all: {sorted(counts)}")
    for name, experiment in (("lanes", lanes()), ("places", dynamic_places())):
        flagged = known = drives = 0
        for seed in seeds:
            mapping, layer = mapped(still(experiment), seed)
            cells = len(layer.points(mapping.placed))
            flagged, drives = flagged + cells, drives + (cells > 0)
            known += len(layer.grid.samples(mapping.placed).point)
        print(
            f"{name}, nothing moving: {flagged} of {known} cells found, in {drives} of "
            f"{len(seeds)} drives"
        )
    errors = []
    for seed in seeds:
        pair = []
        for looking in (False, True):
            mapping, _ = mapped(lanes(carried=True), seed, looking=looking)
            accuracy = assess(mapping.ekf.estimate, mapping.log, labelled=True)
            pair.append(np.nan if accuracy is None else accuracy.ate_m or np.nan)
        errors.append(pair)
    without, within = np.transpose(errors)
    print(
        f"landmark on a vehicle: ATE {np.mean(without):.3f} m without removal, "
        f"{np.mean(within):.3f} m with; smaller in {np.count_nonzero(within < without)} of "
        f"{len(seeds)} drives"
    )


if __name__ == "__main__":
    main()
