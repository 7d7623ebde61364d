"""How far off an alignment may begin: templates of a scan, and of the dense map (Nieto 2005, 6.2).

    python benchmarks/enriched_templates.py [--seeds 2] [--draws 4] [--errors 0.25 1 2 3 4 6]
                                            [--figure basin.png]

`occupancy-loop`, its dense map from the true poses, so that it is known where every template is.
bare: the returns of one scan in the rectangle of a high level landmark; enriched: the Gaussians of
the layer in the same rectangle. Both are aligned with scans from elsewhere, from one start off by
so much and turned by 10 degrees a metre; done when within 0.3 m and 5 degrees.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from dense_maps import view_of  # type: ignore[import-not-found]
from numpy.typing import NDArray

from comparisons.adapters.planar_scans import PlanarScans
from comparisons.experiments.reproduction.basin import converges, offsets
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.source import build_map
from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.report.picture import blank, save
from ekf_reference.dense.layers.gaussians import Gaussians
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.high_level import Around, search, to_world, within
from ekf_reference.scan_landmarks.templates import Template
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians

Array = NDArray[np.float64]

MEASURED = RelativePose()
EVERY = 30
"""Scans between two searches."""
LEAST_RETURNS = 25
APART_M = 6.0
"""Least way between the scan of a template and one that it is aligned with."""
SCANS = 4


class Case(NamedTuple):
    """Two templates of one thing, their true poses in a scan (3,), and the scan."""

    bare: SumOfGaussians
    bare_pose: Array
    enriched: SumOfGaussians
    enriched_pose: Array
    scan: SumOfGaussians


def cases(seed: int) -> Iterator[Case]:
    """All landmarks of a drive, each with a few scans."""
    log = open_log("occupancy-loop", None, 1, SimulationChoices(seed, 1, 1.0))
    truth, scans = log.truth, PlanarScans(log)
    assert truth.poses is not None
    assert truth.landmarks is not None
    landmark, pose = truth.landmarks.position_m, truth.poses.at(scans.time_s)
    dense = build_map(DenseMapsConfig(layers=("occupancy", "sog")))
    shapes = []
    for number, at in enumerate(pose):
        view = view_of(at, landmark, np.arange(len(landmark)))
        scan = scans.scan(number, at)
        dense.predicted(view)
        dense.updated(view)
        dense.insert(view, scan)
        shapes.append(of_scan(scan.bearing_rad, scan.range_m, scan.sensor))
    layers, placed = dense.layers, dense.regions.placed(landmark)
    known: list[Array] = []
    for at in pose[::EVERY]:
        sog = cast(Gaussians, layers["sog"])
        around = Around(layers["occupancy"], sog, placed, at, landmark)
        for one in search(around, np.reshape(known, (-1, 4, 2))).found:
            area = to_world(one.place, one.rectangle)
            known.append(area)
            inside = [within(area, to_world(p, s.mean)) for p, s in zip(pose, shapes, strict=True)]
            count = np.array([np.count_nonzero(rows) for rows in inside])
            best = int(count.argmax())
            bare = Template.of_segment(shapes[best], np.flatnonzero(inside[best]))
            place = MEASURED.invert(pose[best], bare.pose[None]).landmark[0]
            away = np.linalg.norm(pose[:, :2] - pose[best, :2], axis=1) > APART_M
            other = np.flatnonzero(away & (count >= LEAST_RETURNS))
            for row in other[:: max(1, len(other) // SCANS)][:SCANS].tolist():
                yield Case(
                    bare.shape,
                    MEASURED.predict(pose[row], place[None]).z[0],
                    one.template.shape,
                    MEASURED.predict(pose[row], one.place[None]).z[0],
                    shapes[row],
                )


def success(seeds: int, draws: int, errors: Sequence[float]) -> tuple[Array, int]:
    """(E, 2) shares of starts that lead home, bare and enriched, and the number of cases."""
    rng = np.random.default_rng(0)
    all_cases = [case for seed in range(seeds) for case in cases(seed)]
    won = np.zeros((len(errors), 2))
    for row, error in enumerate(errors):
        for case in all_cases:
            for off in offsets(rng, error, draws):
                won[row, 0] += converges(case.bare, case.bare_pose, case.scan, off)
                won[row, 1] += converges(case.enriched, case.enriched_pose, case.scan, off)
    return won / (draws * len(all_cases)), len(all_cases)


def draw(errors: Sequence[float], share: Array, path: Path) -> None:
    """Both curves."""
    figure = blank(6.0, 4.0)
    axis = figure.add_subplot()
    axis.plot(errors, 100.0 * share[:, 0], "o--", color="#d1495b", label="one scan's returns")
    axis.plot(errors, 100.0 * share[:, 1], "s-", color="#00798c", label="the dense map's Gaussians")
    axis.set_xlabel("initial error [m], and 10 degrees a metre")
    axis.set_ylabel("alignments that succeed [%]")
    axis.set_ylim(0.0, 105.0)
    axis.grid(visible=True, color="#eeeeee")
    axis.legend(title="template", fontsize=8)
    save(figure, path)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--errors", type=float, nargs="+", default=[0.25, 1.0, 2.0, 3.0, 4.0, 6.0])
    parser.add_argument("--figure", type=Path)
    choices = parser.parse_args()
    share, count = success(choices.seeds, choices.draws, choices.errors)
    print(f"{count} pairs of a template and a scan from elsewhere, {choices.draws} starts each")
    print("error [m]    bare  enriched")
    for error, (bare, enriched) in zip(choices.errors, share, strict=True):
        print(f"{error:9.2f}  {bare:6.1%}  {enriched:8.1%}")
    if choices.figure is not None:
        draw(choices.errors, share, choices.figure)


if __name__ == "__main__":
    main()
