"""Remarks on what a run was asked for besides: scans, dense maps, motion."""

from __future__ import annotations

from comparisons.checks.dense_agreement import DenseAgreement
from comparisons.logs.log import Log
from comparisons.runs.dense_run import DenseRun, DenseWatcher
from comparisons.runs.scan_log import BEYOND
from comparisons.runs.scan_motion import ScanMotion


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
    """A remark where motion was looked for, and most of it would not have been found."""
    if watcher is None or watcher.moves.compared > watcher.moves.deformed:
        return []
    return [
        "whether anything moves is hardly known: of "
        f"{watcher.moves.compared + watcher.moves.deformed} pairs of maps "
        f"{watcher.moves.deformed} could not be compared, since their region had changed its "
        "shape; it takes three landmarks that stand still"
    ]
