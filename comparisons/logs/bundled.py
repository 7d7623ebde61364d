"""Logs that can be named instead of a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from comparisons.errors import InputError, quoted, shorten
from comparisons.logs.log import Log
from comparisons.logs.readers import READERS, read_log


@dataclass(frozen=True)
class SimulationChoices:
    """What a user may vary in a simulated log."""

    seed: int = 0
    loops: int = 1
    noise_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"--seed is {quoted(self.seed)}, expected 0 or more")
        if not 1 <= self.loops <= 1000:
            raise InputError(f"--loops is {quoted(self.loops)}, expected 1 to 1000")
        if not 0 < self.noise_scale <= 1e6:
            raise InputError(
                f"--noise-scale is {quoted(self.noise_scale)}, expected above 0, at most 1e6"
            )


_SIMULATED = ("--seed", "--loops", "--noise-scale")


class NamedLog(NamedTuple):
    """A log by name: what it is, how to get it, the options that it takes, where it is from.

    inconsistent: what it is known for, if an EKF is not consistent on it.
    """

    what: str
    open: Callable[[SimulationChoices], Log]
    takes: tuple[str, ...] = _SIMULATED
    kind: str = "simulated"
    inconsistent: str = ""


def _victoria_park(choices: SimulationChoices) -> Log:
    import gtsam

    path = gtsam.findExampleDataFile("victoria_park.txt")  # type: ignore[no-untyped-call]
    return READERS["gtsam-2d"].read(Path(path))


def _simulated_loop(choices: SimulationChoices) -> Log:
    from comparisons.logs.simulate.drive import Drive, simulate

    drive = Drive(loops=choices.loops, noise_scale=choices.noise_scale)
    return simulate(np.random.default_rng(choices.seed), drive)


def _waypoint_run(choices: SimulationChoices) -> Log:
    from comparisons.logs.simulate.waypoints import WaypointRun, simulate

    run = WaypointRun(noise_scale=choices.noise_scale)
    return simulate(np.random.default_rng(choices.seed), run)


def _scans(experiment: str, what: str, *, enclosed: bool = False, **options: bool) -> NamedLog:
    """A log of an experiment of scan_drive. enclosed: by landmarks among and behind the objects."""

    def simulated(choices: SimulationChoices) -> Log:
        from comparisons.logs.simulate import scan_drive

        made = getattr(scan_drive, experiment)(choices.loops, choices.noise_scale, **options)
        rng = np.random.default_rng(choices.seed)
        return scan_drive.simulate(rng, scan_drive.enclosed(made) if enclosed else made)

    return NamedLog(what, simulated)


NAMED: dict[str, NamedLog] = {
    "victoria-park": NamedLog(
        "Victoria Park, Sydney: 6,969 poses, 151 labelled trees",
        _victoria_park,
        (),
        "bundled with gtsam",
        "the known example of EKF inconsistency: disagree is to be expected",
    ),
    "simulated-loop": NamedLog(
        "255 m loop among 60 landmarks (Nieto 2005, section 2.9)", _simulated_loop
    ),
    "waypoint-run": NamedLog(
        "waypoints and back (Misono 2007, section 4.1)", _waypoint_run, ("--seed", "--noise-scale")
    ),
    "scan-loop": _scans("dense_slam", "laser scans, objects and landmarks (Nieto 2005, Fig. 3.17)"),
    "scan-loop-enclosed": _scans(
        "dense_slam", "scan-loop with landmarks among and behind the objects", enclosed=True
    ),
    "scan-loop-fine": _scans("dense_slam_fine", "scan-loop with the noise of a SICK laser"),
    "scan-loop-3d": _scans("dense_slam_in_space", "scan-loop with a 3D scanner of 16 rings"),
    "occupancy-loop": _scans("occupancy", "laser scans for occupancy maps (Nieto 2005, Fig. 4.2)"),
    "occupancy-loop-enclosed": _scans(
        "occupancy", "occupancy-loop with landmarks among and behind the objects", enclosed=True
    ),
    "dynamic-lanes": _scans(
        "dynamic_lanes", "static scanner, traffic (Nieto 2005, Fig. 6.9)", carried=True
    ),
    "dynamic-places": _scans(
        "dynamic_places", "objects added, removed between loops (Nieto 2005, Fig. 6.10)"
    ),
    "dynamic-places-enclosed": _scans(
        "dynamic_places", "dynamic-places with landmarks among and behind them", enclosed=True
    ),
    "scan-slam": _scans("scan_slam", "laser scans without point landmarks (Nieto 2005, Fig. 5.8)"),
    "scan-slam-maps": _scans(
        "scan_slam_with_maps", "scan-slam in half the area (Nieto 2005, Fig. 6.7)"
    ),
}


def recognised_format(name: str) -> str | None:
    """The format in which a path would be read, None for a bundled name and for no log at all."""
    path = Path(name)
    if not exists(path):
        return None
    return next((one for one, reader in READERS.items() if reader.recognises(path)), None)


def exists(path: Path) -> bool:
    """Whether a path names a file or folder; one that is too long, or has a null, does not."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def open_log(
    name: str,
    format_name: str | None = None,
    robot: int = 1,
    choices: SimulationChoices | None = None,
    topics: tuple[str, ...] = (),
) -> Log:
    """A log by bundled name, unless a path of that name exists, or by path.

    topics: of a ROS bag, which to read. Raises InputError, also for an option beside its default
    that the log does not take.
    """
    choices = choices or SimulationChoices()
    if format_name is None and name in NAMED and not Path(name).exists():
        _check_takes(name, NAMED[name].takes, robot, choices)
        if topics:
            raise InputError(f"--topic {shorten(topics[0])}: {name} is not a ROS bag")
        return NAMED[name].open(choices)
    path = Path(name)
    if not exists(path):
        from difflib import get_close_matches

        close = get_close_matches(path.name, NAMED, n=1, cutoff=0.7)
        near = f"; did you mean {close[0]}?" if close else ""
        raise InputError(
            f"{shorten(name, 200)}: no such file or folder{near} "
            "(slamcheck logs lists bundled names)"
        )
    found = format_name or recognised_format(name)
    if found in READERS:  # else the reader says what is wrong
        _check_takes(name, ("--robot",) if READERS[found].robots else (), robot, choices)
    return read_log(path, format_name, robot, topics)


def _check_takes(name: str, takes: tuple[str, ...], robot: int, choices: SimulationChoices) -> None:
    usual = vars(SimulationChoices())
    asked = [
        (f"--{key.replace('_', '-')}", value, usual[key]) for key, value in vars(choices).items()
    ]
    for option, value, default in (("--robot", robot, 1), *asked):
        if value != default and option not in takes:
            kind = "MR.CLAM folders" if option == "--robot" else "simulated logs"
            known = f"it takes {', '.join(takes)}" if takes else f"{option} is for {kind}"
            raise InputError(f"{name}: {option} {shorten(value)} does not apply; {known}")
