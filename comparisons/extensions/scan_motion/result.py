"""Scan odometry's evidence in results and tables, of whichever command ran it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Annotated

import numpy as np

from comparisons.adapters.scan_odometry import ScanMotion
from comparisons.checks.accuracy import accuracy_rows
from comparisons.checks.finding import Basis
from comparisons.extensions.scan_motion.increments import IncrementCheck
from comparisons.extensions.scan_motion.three_way import ThreeWay
from comparisons.figures import METRES, LeftOut, Less, Model, More, Named, band, rows_of
from comparisons.words import Row
from graphslam.scan.loop_closure import Closed

_SURE = 2.0
"""Sigmas too small by more than this factor are remarked upon."""


def scan_odometry_result(motion: ScanMotion, *, seconds: float) -> ScanOdometryResult:
    """What became of the scans."""
    matches = [m for m in motion.matches if m is not None]
    return ScanOdometryResult(
        guess="wheels" if motion.guessed else "none",
        scans=len(motion.source.row),
        used=len(motion.row),
        failures=by_reason(f.reason for f in motion.failures),
        breaks=motion.breaks,
        weak=sum(m.open_directions > 0 for m in matches),
        overlap=float(np.median([m.overlap for m in matches])) if matches else None,
        residual_m=float(np.median([m.residual_m for m in matches])) if matches else None,
        scans_per_second=len(motion.source.row) / seconds,
    )


def increment_remarks(check: IncrementCheck | None) -> list[str]:
    """Remark on increments whose sigmas are much too small."""
    if check is None or check.factor <= _SURE:
        return []
    return [
        f"the sigmas of the scan odometry are too small: by {check.against} they should be "
        f"{check.factor:.1f} times as large"
    ]


def scan_odometry_rows(o: ScanOdometryResult, increments: IncrementCheck | None) -> list[Row]:
    """Return scans used and failed, matches, and how honest the increments are."""
    group = "Scan odometry"
    rows = rows_of(group, o, ["used", "breaks", "weak", "guess", "scans_per_second"])
    rows += [Row(group, f"scans failed: {why}", f"{count}") for why, count in o.failures.items()]
    return [*rows, *rows_of(group, o, ["overlap", "residual_m"]), *_increments(increments)]


def three_way_rows(three: ThreeWay) -> list[Row]:
    """Return how both estimates on wheels compare with the smoother on scans, and its accuracy."""
    rows = []
    for name, pair in (("EKF on wheels", three.ekf), ("smoother on wheels", three.smoother)):
        group, agrees = f"{name} and smoother on scans", "yes" if pair.agrees else "no"
        far = f"{pair.outside} of {pair.landmarks}"
        rows += [
            Row(group, "maps agree", agrees, "yes", pair.agrees),
            Row(group, "landmarks: difference (rms)", f"{pair.rms_m:.3f} m"),
            Row(group, "landmarks: difference, aligned (rms)", f"{pair.rms_aligned_m:.3f} m"),
            Row(group, "landmarks beyond the 99 % region", far),
        ]
    return [*rows, *accuracy_rows("the smoother on scans", three.accuracy)]


def by_reason(reasons: Iterable[str]) -> dict[str, int]:
    """Counts of reasons, their numbers left out."""
    return dict(Counter(re.sub(r"[-\d.]+(?:e[-+]?\d+)?", "…", r) for r in reasons).most_common())


def _increments(i: IncrementCheck | None) -> list[Row]:
    if i is None:
        return []
    group = f"Increments of the scans against {i.against}"
    rows = rows_of(group, i)
    if i.reference_factor is not None:
        return rows
    low, high = i.band
    limits = f"{band(f'{3.0 * low:.2f}', f'{3.0 * high:.2f}')} (95 %)"
    inside = i.band.holds(i.nees)
    return [Row(group, "NEES, mean (expected 3)", f"{3.0 * i.nees:.2f}", limits, inside), *rows]


class LoopResult(Model):
    """Loop closure.

    Attributes:
        tried: pairs of poses that were tried.
        closed: pairs that were closed.
        reasons: number of the other pairs, by reason.
    """

    tried: Annotated[int, Named("pairs of poses tried")]
    closed: Annotated[int, Named("pairs of poses closed")]
    reasons: dict[str, int]

    @classmethod
    def of(cls, closed: Closed) -> LoopResult:
        """Return it of loop closures, and all that were tried."""
        outcomes = [attempt.outcome for attempt in closed.attempts]
        return cls(
            tried=len(outcomes),
            closed=len(closed.loop_closures.first),
            reasons=by_reason(outcome for outcome in outcomes if outcome != "accepted"),
        )

    def rows(self) -> list[Row]:
        """Return rows of the table."""
        return rows_of("Loop closure", self)


class ScanOdometryResult(Model):
    """Entry `scan_odometry`: motion from scans.

    Attributes:
        guess: first guess of an alignment.
        scans: scans of the log.
        used: scans that gave an increment.
        failures: scans without an increment, by reason.
        breaks: times that the odometry started anew.
        weak: increments that leave a direction open.
        overlap: median share of returns that meet the map.
        residual_m: median distance of these returns from the map.
        scans_per_second: speed.
    """

    guess: Annotated[str, Named("first guess of an alignment", "{}")]
    scans: int
    used: Annotated[int, Named("scans used", "{:,} of {.scans:,}")]
    failures: dict[str, int]
    breaks: Annotated[int, Named("restarts after scans without a match")]
    weak: Annotated[int, Named("increments with an unobservable direction")]
    overlap: Annotated[More[float | None], Named("overlap of matched scans (median)", "{:.2f}")]
    residual_m: Annotated[Less[float | None], Named("residual of matched scans (median)", METRES)]
    scans_per_second: Annotated[LeftOut[float], Named("scans per second", "{:.0f}")]


class ScanOdometryFinding(Basis[ScanOdometryResult]):
    """What became of the scans, where a job moves by them alone."""

    def __init__(self, odometry: ScanOdometryResult, increments: IncrementCheck | None) -> None:
        """increments: against the wheels; None without these."""
        entries = {"odometry": odometry, "increments": increments}
        super().__init__(odometry, entries=entries)
        self._rows = scan_odometry_rows(odometry, increments)
        used = f"{odometry.used:,} of {odometry.scans:,} scans used, {odometry.breaks} restarts"
        self.lines = [("scans", used)]

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return self._rows
