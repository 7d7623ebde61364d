"""The golden runs: commands whose results a change of structure must not change."""

import re
from collections.abc import Iterable
from pathlib import Path

from comparisons.logs.log_folder import write_log_folder
from tests.scenarios import scenario

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
_TABLE = """\
victoria-park: run victoria-park
loop-0-full-known: run simulated-loop --seed 0 --filter full --association known
loop-0-misono-full-jcbb: run simulated-loop --seed 0 --filter misono-full --association jcbb
loop-1-compressed-nn: run simulated-loop --seed 1 --filter compressed --association nn
loop-1-full-euclidean: run simulated-loop --seed 1 --filter full --association euclidean
loop-2-misono-jcbb: run simulated-loop --seed 2 --filter misono --association jcbb
loop-2-compressed-consensus: run simulated-loop --seed 2 --filter compressed --association consensus
loop-3-suboptimal-euclidean: run simulated-loop --seed 3 --filter compressed-suboptimal \
--association euclidean
loop-3-misono-known: run simulated-loop --seed 3 --filter misono --association known
loop-4-misono-full-consensus: run simulated-loop --seed 4 --filter misono-full \
--association consensus
loop-4-suboptimal-nn: run simulated-loop --seed 4 --filter compressed-suboptimal --association nn
loop-gnc: run simulated-loop --robust gnc --association jcbb
loop-own: run simulated-loop --seed 3 --smoother-association own
loop-isam2: run simulated-loop --smoother isam2 --robust huber
waypoint-misono: run waypoint-run --filter misono --gps on
waypoint-misono-full: run waypoint-run --filter misono-full --gps on
car-park: run {shared}/acfr_car_park
car-park-both: run {shared}/acfr_car_park --motion both
car-park-scan: run {shared}/acfr_car_park --motion scan --gps on
car-park-half: run {shared}/acfr_car_park --gps half
car-park-trees: run {shared}/acfr_car_park --features trees --association nn --attributes on \
--gps on
mrclam-2-nn: run {shared}/mrclam/MRCLAM_Dataset6 --robot 2 --association nn
scan-slam-own: run {work}/short --landmarks scans --smoother-matcher generalised-icp \
--template-extraction per-segment
scan-slam-fused: run {work}/short --landmarks scans --merge-landmarks
scan-maps-dense: run scan-slam-maps --landmarks scans --dense occupancy
scan-loop-dense: run scan-loop-fine --dense points --dense sog --resolution 0.4
high-level-dense: run occupancy-loop --high-level --dense occupancy
dynamic-lanes: run dynamic-lanes --dynamic
solve: solve {shared}/mrclam/MRCLAM_Dataset6 --robot 3 --robust gnc
solve-loop: solve simulated-loop --association own
odometry: odometry scan-loop-fine
odometry-car-park: odometry {shared}/acfr_car_park --gps on
map: map occupancy-loop
map-scans: map scan-slam-maps --landmarks scans --layer occupancy --layer sog
map-dynamic: map dynamic-places --dynamic --layer points
traced: run simulated-loop --seed 4 --trace
check: check simulated-loop --seed 4 --estimate {work}/traced/ekf
check-path: check simulated-loop --seed 4 --estimate {work}/traced/ekf/trajectory.tum
montecarlo: montecarlo circle --runs 25 --filters ekf,riekf --workers 1
"""
CASES: dict[str, str] = dict(line.split(": ", 1) for line in _TABLE.splitlines())
"""Command lines by name. {work}: the folder in which the folders of all cases are."""


def words(name: str, work: Path) -> list[str]:
    """Return a case's command line, with its folders filled in and its output in `work`."""
    filled = CASES[name].format(shared=SHARED, work=work)
    return [*filled.split(), "--out", str(work / name)]


def with_before(names: Iterable[str]) -> list[str]:
    """Return the names, each after that of the case whose output it reads."""
    found: list[str] = []
    for name in names:
        found += [one for one in re.findall(r"\{work\}/([\w-]+)", CASES[name]) if one in CASES]
        found.append(name)
    return list(dict.fromkeys(found))


def lacks_data(name: str) -> bool:
    """Return whether a case reads a real log that is not on this machine."""
    return "{shared}" in CASES[name] and not SHARED.is_dir()


def make_logs(work: Path) -> None:
    """Make the log that cases read from `work`."""
    write_log_folder(scenario("scan-slam", seed=1, seconds=14.0), work / "short")
