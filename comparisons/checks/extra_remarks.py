"""Remarks on what a run was asked for besides: scans, dense maps, motion."""

from __future__ import annotations

from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.extensions.dense_maps.check import DenseAgreement
from comparisons.extensions.dense_maps.source import DenseRun, DenseWatcher
from comparisons.logs.log import Log
from comparisons.logs.transforms.scan_motion import BEYOND
from ekf_reference.dense.dynamic import places


def on_scans(log: Log, motion: ScanMotion | None) -> list[str]:
    """Remarks on the scans' motion, if there is one."""
    if motion is None:
        return []
    beyond = log.provenance.get(BEYOND)
    told = [f"{beyond} sightings lie outside the time of the scans and were left out"]
    return motion.remarks + (told if beyond else [])


def on_dense(mapped: DenseRun | None, compared: DenseAgreement | None) -> list[str]:
    """Remarks on the dense map, if one was asked for."""
    if mapped is None or compared is not None:
        return []
    return [
        f"no return fell into one of {len(mapped.dense.regions.base)} regions, so no dense maps "
        "could be compared"
    ]


def on_motion(watcher: DenseWatcher | None) -> list[str]:
    """Remarks where motion was looked for: what was found, and whether most of it could be."""
    layer = None if watcher is None else watcher.dense.dynamic
    if watcher is None or layer is None:
        return []
    placed = watcher.dense.regions.placed(watcher.dense.landmark)
    count = int(places(layer.points(placed)).max(initial=-1)) + 1
    found = f"something moves in {count} places, {layer.area_m2(placed):.1f} m2 in all"
    remarks = [found if count else "nothing was seen to move"]
    if watcher.moves.compared <= watcher.moves.deformed:
        remarks.append(
            "whether anything moves is hardly known: of "
            f"{watcher.moves.compared + watcher.moves.deformed} pairs of maps "
            f"{watcher.moves.deformed} could not be compared, since their region had changed its "
            "shape; it takes three landmarks that stand still"
        )
    return remarks
