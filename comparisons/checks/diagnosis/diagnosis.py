"""What would make a trajectory fit: known ways for poses to be wrong, tried one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from comparisons.arrays import Array
from comparisons.checks.accuracy import aligned
from comparisons.checks.causes import Cause

_EXPLAINS = 0.35
"""A correction explains a difference when this share of it is left, or less."""
_NO_MATTER_M = 0.01
_LATEST_S = 2.0
_LEAST_SCALE = 0.005
_LEAST_HEADING_RAD = np.deg2rad(3.0)
_LEAST_ALONE_RAD = np.deg2rad(0.1)
"""Heading that is off where the positions are right."""
_MOST_TURNED_RAD = 5e-3
"""Another point of the vehicle has its heading; a path that is late at an even speed has not."""


@dataclass(frozen=True)
class Paths:
    """A path and its reference at the same times (K,). pose, reference: (K, 3)."""

    time_s: Array
    pose: Array
    reference: Array

    @property
    def rms_m(self) -> float:
        """Of the positions' difference."""
        return rms(self.pose[:, :2] - self.reference[:, :2])


def diagnose(paths: Paths) -> list[Cause]:
    """Corrections that take most of a difference away, the most telling first; may be none."""
    tries = [_heading, _clockwise]
    if paths.rms_m > _NO_MATTER_M:
        tries += [_frame, _late, _mirrored, _scaled, _lever]
    found = [cause for cause in (attempt(paths) for attempt in tries) if cause is not None]
    return [cause for _, cause in sorted(found, key=lambda pair: pair[0])]


def rms(error: Array) -> float:
    """Root mean square length of vectors (K, 2)."""
    return float(np.sqrt(np.square(error).sum(axis=1).mean()))


def _heading(paths: Paths) -> tuple[float, Cause] | None:
    """Headings that are off by much the same everywhere, whatever the positions do."""
    each = np.exp(1j * (paths.pose[:, 2] - paths.reference[:, 2]))
    mean, together = float(np.angle(each.mean())), float(abs(each.mean()))
    alone = paths.rms_m <= _NO_MATTER_M
    if abs(mean) < (_LEAST_ALONE_RAD if alone else _LEAST_HEADING_RAD) or together < 0.98:
        return None
    varies = float(np.std(np.angle(each * np.exp(-1j * mean))))
    if (alone and varies > _EXPLAINS * abs(mean)) or (not alone and _frame(paths) is not None):
        return None
    return 0.0, Cause(
        "heading",
        f"all headings are off by {np.degrees(mean):.1f} degrees, the positions by "
        f"{paths.rms_m:.2f} m (RMS)",
        "look at the heading's zero and sense: counter-clockwise from east is expected",
    )


def _clockwise(paths: Paths) -> tuple[float, Cause] | None:
    """Headings counted the other way, from whatever direction."""
    both = np.exp(1j * (paths.pose[:, 2] + paths.reference[:, 2])).mean()
    as_is = np.exp(1j * (paths.pose[:, 2] - paths.reference[:, 2])).mean()
    if paths.rms_m > _NO_MATTER_M or abs(both) < 0.98 or abs(as_is) > 0.9:
        return None
    return 0.0, Cause(
        "heading",
        "all headings turn the other way: clockwise, from "
        f"{np.degrees(float(np.angle(both))):.0f} degrees",
        "look at the heading's sense: counter-clockwise from east is expected",
    )


def _lever(paths: Paths) -> tuple[float, Cause] | None:
    """The path of another point of the vehicle."""
    off = (paths.pose[:, :2] - paths.reference[:, :2]) @ (1.0, 1.0j)
    body = off * np.exp(-1j * paths.reference[:, 2])
    left = float(np.sqrt(np.mean(np.abs(body - body.mean()) ** 2)))
    turned = np.angle(np.exp(1j * (paths.pose[:, 2] - paths.reference[:, 2])))
    if left > _EXPLAINS * paths.rms_m or np.sqrt(np.mean(turned**2)) > _MOST_TURNED_RAD:
        return None
    forward, side = float(body.mean().real), float(body.mean().imag)
    return left / paths.rms_m, Cause(
        "lever",
        f"{forward:.3f} m forward and {side:.3f} m left of the log's point of the vehicle the path "
        f"fits to {left:.3f} m (RMS), {paths.rms_m:.3f} m before",
        "look at which point of the vehicle is written: axle, sensor or antenna",
    )


def _frame(paths: Paths) -> tuple[float, Cause] | None:
    ours, theirs = paths.pose[:, :2], paths.reference[:, :2]
    left = rms(aligned(ours, theirs) - theirs)
    if left > _EXPLAINS * paths.rms_m:
        return None
    centred = (ours - ours.mean(axis=0)) @ (1.0, 1.0j)
    turn = float(np.angle(np.vdot(centred, (theirs - theirs.mean(axis=0)) @ (1.0, 1.0j))))
    shift = float(np.linalg.norm((theirs - ours).mean(axis=0)))
    return left / paths.rms_m, Cause(
        "frame",
        f"turned by {np.degrees(turn):.2f} degrees and shifted by {shift:.2f} m the path fits to "
        f"{left:.3f} m (RMS), {paths.rms_m:.3f} m before",
        "look at the prior: both must begin at the log's pose, in the log's frame; or at the map's "
        "first landmarks",
    )


def _late(paths: Paths) -> tuple[float, Cause] | None:
    """The same path, some time too early or too late."""

    def left(delay: float) -> float:
        at = paths.time_s + delay
        moved = [np.interp(at, paths.time_s, paths.pose[:, i]) for i in range(2)]
        return rms(np.column_stack(moved) - paths.reference[:, :2])

    delays = np.linspace(-_LATEST_S, _LATEST_S, 41)
    coarse = float(delays[int(np.argmin([left(d) for d in delays]))])
    best = minimize_scalar(left, bounds=(coarse - 0.1, coarse + 0.1), method="bounded")
    if abs(best.x) < 0.005 or best.fun > _EXPLAINS * paths.rms_m:
        return None
    return best.fun / paths.rms_m, Cause(
        "time",
        f"{abs(best.x):.3f} s {'later' if best.x > 0 else 'earlier'} the path fits to "
        f"{best.fun:.3f} m (RMS), {paths.rms_m:.3f} m before",
        "look at the clocks: stamps of odometry against sightings, the interval of a prediction",
    )


def _mirrored(paths: Paths) -> tuple[float, Cause] | None:
    flipped = paths.pose[:, :2] * (1.0, -1.0)
    left = rms(aligned(flipped, paths.reference[:, :2]) - paths.reference[:, :2])
    straight = rms(aligned(paths.pose[:, :2], paths.reference[:, :2]) - paths.reference[:, :2])
    if left > _EXPLAINS * straight:
        return None
    return left / paths.rms_m, Cause(
        "mirrored",
        f"the path's mirror image fits to {left:.3f} m (RMS), the path itself to {straight:.3f} m",
        "look at the sense of steering, yaw rate or bearing, and at the order of the axes",
    )


def _scaled(paths: Paths) -> tuple[float, Cause] | None:
    ours, theirs = paths.pose[:, :2], paths.reference[:, :2]
    a, b = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    u, v = a @ (1.0, 1.0j), b @ (1.0, 1.0j)
    factor = np.vdot(u, v) / max(np.vdot(u, u).real, 1e-12)
    left = float(np.sqrt(np.mean(np.abs(factor * u - v) ** 2)))
    straight = rms(aligned(ours, theirs) - theirs)
    if abs(abs(factor) - 1.0) < _LEAST_SCALE or left > _EXPLAINS * straight:
        return None
    return left / paths.rms_m, Cause(
        "scale",
        f"{abs(factor):.4f} times as large the path fits to {left:.3f} m (RMS), {straight:.3f} m "
        "as it is",
        "look at units and scale: metres, the speed's calibration, the wheel's radius",
    )
