"""The golden runs: commands whose results a change of structure must not change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from comparisons.logs.log_folder import write_log_folder
from tests.scenarios import scenario

FILTERS = ("full", "compressed", "compressed-suboptimal", "misono", "misono-full")
ASSOCIATIONS = ("known", "nn", "jcbb", "euclidean", "consensus")


@dataclass(frozen=True)
class Case:
    """One command line.

    argv: with {shared}, {work} and {name} filled in. quick: part of `make test`. before: the case
    whose output folder this one reads.
    """

    name: str
    argv: str
    quick: bool = False
    before: str = ""

    @property
    def needs_data(self) -> bool:
        """The case reads a real log."""
        return "{shared}" in self.argv


def _loops() -> list[Case]:
    return [
        Case(
            f"loop-{seed}-{filter_}-{association}",
            f"run simulated-loop --seed {seed} --filter {filter_} --association {association}",
            quick=(seed, filter_, association)
            in ((0, "full", "known"), (1, "compressed", "nn"), (2, "misono", "jcbb")),
        )
        for seed in range(5)
        for filter_ in FILTERS
        for association in ASSOCIATIONS
    ]


CAR_PARK = "{shared}/acfr_car_park"
MRCLAM = "{shared}/mrclam/MRCLAM_Dataset6"

CASES = {
    case.name: case
    for case in (
        Case("victoria-park", "run victoria-park", quick=True),
        *_loops(),
        Case("loop-gnc", "run simulated-loop --robust gnc --association jcbb"),
        Case("loop-own", "run simulated-loop --seed 3 --smoother-association own", quick=True),
        Case("loop-isam2", "run simulated-loop --smoother isam2 --robust huber"),
        Case("waypoint-misono", "run waypoint-run --filter misono --gps on", quick=True),
        Case("waypoint-misono-full", "run waypoint-run --filter misono-full --gps on"),
        Case("car-park", f"run {CAR_PARK}", quick=True),
        Case("car-park-both", f"run {CAR_PARK} --motion both"),
        Case("car-park-scan", f"run {CAR_PARK} --motion scan --gps on"),
        Case("car-park-half", f"run {CAR_PARK} --gps half"),
        Case(
            "car-park-trees",
            f"run {CAR_PARK} --features trees --association nn --attributes on --gps on",
        ),
        Case("mrclam-2", f"run {MRCLAM} --robot 2"),
        Case("mrclam-2-nn", f"run {MRCLAM} --robot 2 --association nn"),
        Case(
            "scan-slam-own",
            "run {work}/short --landmarks scans --smoother-matcher generalised-icp "
            "--template-extraction per-segment",
        ),
        Case("scan-slam-fused", "run {work}/short --landmarks scans --merge-landmarks"),
        Case("scan-slam-enriched", "run {work}/short --landmarks scans --map-aided-matching"),
        Case("scan-slam-maps", "run scan-slam-maps --landmarks scans --dense occupancy"),
        Case("scan-loop-dense", "run scan-loop-fine --dense points --dense sog --resolution 0.4"),
        Case("high-level", "run occupancy-loop --high-level"),
        Case("high-level-dense", "run occupancy-loop --high-level --dense occupancy"),
        Case("dynamic-lanes", "run dynamic-lanes --dynamic"),
        Case("solve", f"solve {MRCLAM} --robot 3 --robust gnc"),
        Case("solve-loop", "solve simulated-loop --association own", quick=True),
        Case("odometry", "odometry scan-loop-fine"),
        Case("odometry-car-park", f"odometry {CAR_PARK} --gps on"),
        Case("map", "map occupancy-loop"),
        Case("map-scans", "map scan-slam-maps --landmarks scans --layer occupancy --layer sog"),
        Case("map-dynamic", "map dynamic-places --dynamic --layer points"),
        Case("traced", "run simulated-loop --seed 4 --trace"),
        Case(
            "check",
            "check simulated-loop --seed 4 --estimate {work}/traced/ekf",
            before="traced",
        ),
        Case(
            "check-path",
            "check simulated-loop --seed 4 --estimate {work}/traced/ekf/trajectory.tum",
            before="traced",
        ),
        Case("montecarlo", "montecarlo circle --runs 25 --filters ekf,riekf"),
    )
}


def _short(folder: Path) -> None:
    write_log_folder(scenario("scan-slam", seed=1, seconds=14.0), folder)


MADE: dict[str, Callable[[Path], None]] = {"{work}/short": _short}
"""Logs that are made before a case that names them."""
