"""Scan odometry's evidence in results and tables, of whichever command ran it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np
from rich.markup import escape
from rich.table import Table

from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.extensions.scan_motion.increments import IncrementCheck
from comparisons.report.models import IncrementResult, ScanOdometryResult

_SURE = 2.0
"""Sigmas too small by more than this factor are remarked upon."""


def scan_odometry_result(motion: ScanMotion, *, guess: bool, seconds: float) -> ScanOdometryResult:
    """What became of the scans. guess: by the wheels, where there are any."""
    matches = [m for m in motion.matches if m is not None]
    return ScanOdometryResult(
        guess="wheels" if motion.wheels is not None and guess else "none",
        scans=len(motion.source.row),
        used=len(motion.row),
        failures=by_reason(f.reason for f in motion.failures),
        breaks=motion.breaks,
        weak=sum(m.open_directions > 0 for m in matches),
        overlap=float(np.median([m.overlap for m in matches])) if matches else None,
        residual_m=float(np.median([m.residual_m for m in matches])) if matches else None,
        scans_per_second=len(motion.source.row) / seconds,
    )


def increment_result(check: IncrementCheck | None) -> IncrementResult | None:
    """How honest the increments are, where something tells."""
    return None if check is None else IncrementResult(**vars(check))


def increment_remarks(check: IncrementCheck | None) -> list[str]:
    """A sentence where the increments are much surer than they may be."""
    if check is None or check.factor <= _SURE:
        return []
    return [
        f"the increments are surer than they may be: by {check.against} their sigmas should be "
        f"{check.factor:.1f} times as large"
    ]


def add_scan_odometry(
    table: Table, o: ScanOdometryResult, increments: IncrementResult | None
) -> None:
    """Scans used and failed, matches, and the increments' honesty."""
    table.add_row(
        "scan odometry",
        f"{o.used:,} of {o.scans:,} scans used, {o.breaks} new beginnings, {o.weak} with a "
        f"direction open; guess: {o.guess}; {o.scans_per_second:.0f} scans/s",
    )
    for reason, count in o.failures.items():
        table.add_row("", escape(f"{count} failed: {reason}"))
    if o.overlap is not None and o.residual_m is not None:
        table.add_row(
            "matches", f"overlap {o.overlap:.2f}, residual {o.residual_m:.3f} m (medians)"
        )
    if increments is not None:
        table.add_row("increments", _increments(increments))


def by_reason(reasons: Iterable[str]) -> dict[str, int]:
    """Counts of reasons, their numbers left out."""
    return dict(Counter(re.sub(r"[-\d.]+(?:e[-+]?\d+)?", "…", r) for r in reasons).most_common())


def _increments(i: IncrementResult) -> str:
    if i.reference_factor is not None:
        return (
            f"by positions over windows: sigmas {i.factor:.2f} times as large would be most "
            f"likely (with the positions' {i.reference_factor:.2f} times)"
        )
    return (
        f"by truth: NEES {3.0 * i.nees:.2f} of 3 (band {3.0 * i.band[0]:.2f} to "
        f"{3.0 * i.band[1]:.2f}); sigmas {i.factor:.2f} times as large would fit"
    )
