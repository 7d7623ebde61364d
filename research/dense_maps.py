"""What each of the documents' settings of dense maps does to the occupancy layer.

    python -m research.dense_maps [--among 80] [--seeds N] [--rules NAME ...]
    python -m research.dense_maps --correlation [--among 80] [--seeds 1]
    python -m research.dense_maps --particles [--seeds 1]

The documents' settings beside those that runs use, and each of them alone, on simulated drives of
one loop (Nieto 2005, sections 3.9 and 4.1.3) with more landmarks among and behind the objects; six
and eight drives if left out. --rules: some of the rows. --correlation: what regions cover, and how
far the closing of the loop deforms them (Fig. 3.9), by the least correlation of their landmarks
alone, as section 3.5 has it. --particles: weights of particles (Fig. 4.10), and how far they and
Gaussians are from the surfaces over raw returns (Fig. 4.12), without and with those dropped that
have come to lie on others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.checks.accuracy import match_by_distance, rigid_motion
from comparisons.config import MapConfig
from comparisons.documented.row import Preset
from comparisons.extensions.dense_maps.accuracy import OCCUPIED, distance_to_segments
from comparisons.extensions.dense_maps.job import DenseMapping, map_log
from comparisons.logs.log import Log
from comparisons.logs.simulate.scan_drive import ScanExperiment, dense_slam, occupancy, simulate
from comparisons.logs.simulate.scan_worlds import MORE_LANDMARKS, with_landmarks_among
from ekf_reference.dense.layers.layer import LayerSamples
from research.script import options, present

Array = NDArray[np.float64]

FIRST_LOOPS = {dense_slam: 6, occupancy: 8}
"""Drives of one loop, from seed 0."""
CORRELATIONS = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.2, -1.0)
ALONE: Mapping[str, Mapping[str, Any]] = {
    "least_correlation=0.5": {"least_correlation": 0.5},
    "known_apart_m=0": {"known_apart_m": 0.0},
    "longest_edge_m=inf": {"longest_edge_m": math.inf},
    "flip_test=ellipses": {"flip_test": "ellipses"},
    "delayed=false": {"delayed": False},
    "virtual_landmarks=false": {"virtual_landmarks": False},
    "p_occupied=0.9, p_free=0.3": {"p_occupied": 0.9, "p_free": 0.3},
}
"""Settings of the documents, and a lower correlation, each alone."""
PARTICLES: Mapping[str, tuple[Preset, Mapping[str, Any]]] = {
    "nieto-2005": ("nieto-2005", {}),
    "nieto-2005, thinned": ("nieto-2005", {"thinned": True}),
    "recommended": ("recommended", {}),
    "recommended, all kept": ("recommended", {"thinned": False}),
}
_ROUNDS = (1, 10)


def errors_by_rule(seeds: int | None, among: int, rules: Sequence[str]) -> None:
    """What each of the documents' settings does to the occupancy layer, after the first loop.

    rules: titles of the rows, all where there is none.
    """
    print("means over drives of one loop; distances of occupied cells to the surfaces [m], median")
    print("/ 95 %; aligned: after the landmarks' motion onto the true ones; regions: when made")
    for experiment, table in FIRST_LOOPS.items():
        drives, name = seeds or table, experiment().name
        print(f"{name}, {among} landmarks more, {drives} drives")
        print(f"{'':30} {RULE_COLUMNS}")
        logs = [log_among(experiment(), among, seed) for seed in range(drives)]
        for title, preset, fields in (
            ("recommended", "recommended", {}),
            ("nieto-2005", "nieto-2005", {}),
            ("nieto-2005, correlation 0.5", "nieto-2005", {"least_correlation": 0.5}),
            *((title, "recommended", fields) for title, fields in ALONE.items()),
        ):
            if rules and title not in rules:
                continue
            each = mapped(logs, preset, ("occupancy",), fields)
            print(f"{title:30} {rule_row(each)}", flush=True)


RULE_COLUMNS = (
    "dense map    aligned      one grid     aligned      regions  correlated  at once  late  never"
)


def rule_row(mapped: Sequence[DenseMapping]) -> str:
    """Figures of drives, in the order of RULE_COLUMNS."""
    reported = []
    for layer in ("occupancy", "classic"):
        for which in range(2):
            each = [inside_regions(one, layer)[which] for one in mapped]
            quantiles = [np.percentile(d, (50.0, 95.0)) for d in each if len(d)]
            median, most = np.mean(quantiles, axis=0) if quantiles else (math.nan, math.nan)
            reported.append(f"{median:5.3f} / {most:4.2f}")
    regions = [one.dense.dense.regions for one in mapped]
    tallies = [one.dense.dense.tally for one in mapped]
    total = sum(t.returns for t in tallies)
    at_once, late = sum(t.fused for t in tallies) / total, sum(t.late for t in tallies) / total
    correlated = sum(int(r.by_correlation.sum()) for r in regions)
    return (
        f"{' '.join(reported)} {sum(len(r.base) for r in regions):8d} {correlated:11d} "
        f"{at_once:8.1%} {late:5.1%} {1.0 - at_once - late:6.1%}"
    )


def by_correlation(seeds: int, among: int) -> None:
    """Coverage against deformation over the least correlation of a region's landmarks."""
    logs = [log_among(dense_slam(), among, seed) for seed in range(seeds)]
    print(f"scan-loop, {among} landmarks more, {seeds} drives; deformed: change of an edge by the")
    print("update that moved the regions the most [m], median / 95 %; surfaces: median [m]")
    print("correlation  regions  covered  deformed       surfaces")
    for least in CORRELATIONS:
        each = mapped(logs, "nieto-2005", ("points",), {"least_correlation": least})
        tallies = [one.dense.dense.tally for one in each]
        covered = sum(t.fused + t.late for t in tallies) / sum(t.returns for t in tallies)
        regions = sum(len(one.placed.triangle) for one in each)
        change = np.concatenate([deformation(one) for one in each])
        median, most = np.percentile(change, (50.0, 95.0)) if len(change) else (math.nan,) * 2
        off = np.concatenate([distances(one, "points")[0] for one in each])
        near = float(np.median(off)) if len(off) else math.nan
        row = f"{least:11g} {regions:8d} {covered:8.1%}  {median:5.3f} / {most:5.3f}"
        print(f"{row}  {near:8.3f}", flush=True)


def by_particles(seeds: int) -> None:
    """Shares of particles by weight; of particles and Gaussians the distance over raw returns'."""
    for rounds in _ROUNDS:
        experiment = occupancy(rounds)
        logs = [log_among(experiment, MORE_LANDMARKS, seed) for seed in range(seeds)]
        print(
            f"{experiment.name}, {rounds} rounds, {MORE_LANDMARKS} landmarks more, {seeds} drives"
        )
        print(f"{'':22} particles  > 0.8  < 0.5  off  Gaussians   off")
        for title, (preset, fields) in PARTICLES.items():
            each = mapped(logs, preset, ("points", "particles", "sog"), fields)
            weight = np.concatenate([one.layers["particles"].occupancy for one in each])
            shares = f"{(weight > OCCUPIED).mean():6.1%} {(weight < 0.5).mean():6.1%}"
            off = {
                name: np.median(
                    [m.errors[name].median_m / m.errors["points"].median_m for m in each]
                )
                for name in ("particles", "sog")
            }
            count, gaussians = (
                sum(len(one.layers[name].point) for one in each) // seeds for name in off
            )
            row = f"{title:22} {count:9d} {shares} {off['particles']:4.2f}"
            print(f"{row}  {gaussians:9d}  {off['sog']:4.2f}", flush=True)


def log_among(experiment: ScanExperiment, more: int, seed: int) -> Log:
    """A drive with so many more landmarks among and behind the objects."""
    world = with_landmarks_among(experiment.world, more)
    return simulate(np.random.default_rng(seed), replace(experiment, world=world))


def mapped(
    logs: Sequence[Log], preset: str, layers: Sequence[str], fields: Mapping[str, Any]
) -> list[DenseMapping]:
    """Map drives of one experiment by a preset's settings but for some."""
    config = MapConfig.of(
        preset=preset,
        log={"source": logs[0].name},
        extensions={"dense_maps": {"layers": layers, **fields}},
    )
    return [map_log(log, config) for log in logs]


def deformation(one: DenseMapping) -> Array:
    """(R,) greatest change of an edge [m] of each region that there was, by the largest update."""
    before = one.dense.before
    if before is None:
        return np.empty(0)
    after = edges(one.placed.triangle[: len(before.triangle)])
    change: Array = np.abs(after - edges(before.triangle)).max(axis=1)
    return change


def edges(triangle: Array) -> Array:
    """(R, 3) lengths of the edges of triangles (R, 3, 2)."""
    length: Array = np.linalg.norm(triangle - np.roll(triangle, 1, axis=1), axis=2)
    return length


def inside_regions(one: DenseMapping, layer: str) -> tuple[Array, Array]:
    """As `distances`, of what lies in a region of the dense map; (N,) and (N,)."""
    if layer != "classic":
        return distances(one, layer)
    held = one.classic
    kept = np.flatnonzero(one.placed.locate(held.point).region >= 0)
    there = LayerSamples(held.point[kept], held.occupancy[kept], held.region[kept])
    return distances(replace(one, classic=there), layer)


def distances(one: DenseMapping, name: str) -> tuple[Array, Array]:
    """(N,) of occupied samples to the surfaces: as they are, and landmarks on the true ones."""
    samples = one.classic if name == "classic" else one.layers[name]
    point = samples.point[samples.occupancy > OCCUPIED]
    landmark, true = one.dense.landmark, present(one.log.truth.landmarks).position_m
    segment = present(one.log.truth.surfaces).segment
    ours, theirs = match_by_distance(landmark, true)
    move = rigid_motion(landmark[ours], true[theirs])
    return distance_to_segments(point, segment), distance_to_segments(move(point), segment)


def main() -> None:
    """Measure and print."""
    asked = options(
        __doc__, seeds=int, among=MORE_LANDMARKS, rules=(), correlation=False, particles=False
    )
    if asked.particles:
        by_particles(asked.seeds or 1)
    elif asked.correlation:
        by_correlation(asked.seeds or 1, asked.among)
    else:
        errors_by_rule(asked.seeds, asked.among, asked.rules)


if __name__ == "__main__":
    main()
