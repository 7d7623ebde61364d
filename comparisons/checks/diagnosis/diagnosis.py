"""What would make a trajectory fit: the simplest known way for poses to be wrong that explains it.

The path u (K,) is written as complex numbers, the reference as v. Ways are nested motions
u = a v + b, with what they leave open as their parameters. One with more parameters is taken
only where an F test says that it fits better, and not in what the reference itself leaves open:
the start's frame is known no better than the prior and the first measurements say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.plane import rms
from comparisons.statistics import f_quantile
from comparisons.words import Cause
from graphslam.sensor_frame import in_words

Complex = NDArray[np.complex128]
Fit = Callable[[Complex, Complex], tuple[complex, complex, str]]
"""From paths u and v (K,): a and b of u = a v + b, in words as well."""

MOTIONS = ("frame", "heading", "lever", "mirrored", "scale", "time")
"""Causes that are motions of the whole path."""
_EXPLAINS = 0.01
"""A correction explains a difference when this share of it is left, or less."""
_PARTLY = 0.35
"""It explains a part, when this share is: a fault of the filter's own often does."""
_NO_MATTER_M = 0.01
_LATEST_S = 2.0
_LEAST_DELAY_S = 0.005
_LEAST_SCALE = 0.005
_LEAST_HEADING_RAD = np.deg2rad(3.0)
_LEAST_ALONE_RAD = np.deg2rad(0.1)
"""Heading that is off where the positions are right."""
_NO_HEADINGS_RAD = 0.2
"""A path whose headings differ by more has none that tell anything."""
_SAME_HEADINGS = 0.9
"""Mean cosine of the differences from what headings are taken for."""
_CLEARLY_LESS = 0.5
"""So much is left at most of what a motion leaves, where another is named in its place."""
_INTERPOLATED = 0.7
"""So much of white noise is left between two poses."""
FEWEST = 5
"""With fewer poses some motion, and some fault of a filter, fits whatever is wrong."""
_FLOOR_M = 0.05
"""Standard deviation that a place has at least; a prior's is often next to nothing."""
_INDEPENDENT = 20
"""Of the numbers of a path, so many count in the F test: errors of its poses last."""
_SURE = 0.999
_EQUAL = 0.01**2
"""Mean square [sigma^2] of what is left where an estimate is a reference's but for a motion."""
_LIKE = 0.05**2
"""What is open there, as a grade of `like` allows."""
_FRAME_HINT = (
    "check that the filter starts at the log's prior pose, in the log's frame; check the first "
    "landmarks of the map"
)
_TIME_HINT = (
    "check the clocks: the time stamps of odometry and measurements, and the interval of a "
    "prediction"
)
_SCALE_HINT = "check units and scale: metres, the calibration of the speed, the wheel radius"
_MIRROR_HINT = "check the sign of steering, yaw rate and bearing, and the order of the axes"
_LEVER_HINT = "check which point of the vehicle the poses describe: axle, sensor or antenna"
_HEADING_HINT = "check the {} of the heading: it must be counter-clockwise from east"
_WRITTEN_HINT = (
    "in TUM qx, qy, qz, qw are 0, 0, sin(h/2), cos(h/2) of a heading h in radians; in CSV the "
    "column is named heading_rad, or heading_deg where it is in degrees"
)


@dataclass(frozen=True)
class Paths:
    """A path and a reference at the same times (K,). pose, reference: (K, 3).

    covariance: (K, 3, 3) of what the reference leaves open. name: the reference's.
    """

    time_s: Array
    pose: Array
    reference: Array
    covariance: Array
    name: str

    @cached_property
    def u(self) -> Complex:
        """The path's places (K,)."""
        return _complex(self.pose)

    @cached_property
    def v(self) -> Complex:
        """The reference's places (K,)."""
        return _complex(self.reference)

    @property
    def rms_m(self) -> float:
        """Of the positions' difference."""
        return rms(self.pose[:, :2] - self.reference[:, :2])

    @cached_property
    def _information(self) -> Array:
        spread: Array = self.covariance[:, :2, :2] + _FLOOR_M**2 * np.eye(2)
        return np.asarray(np.linalg.inv(spread), dtype=np.float64)

    def square(self, left: Array) -> float:
        """Mean square of what is left (K, 2), in the covariance, per degree of freedom."""
        at = np.isfinite(left).all(axis=1)
        each = np.einsum("ki,kij,kj->k", left[at], self._information[at], left[at])
        return float(each.mean()) / 2.0

    def motion(
        self,
        gap: str,
        free: int,
        left: Complex,
        said: str,
        hint: str,
        moved: PathTransform | None = None,
    ) -> PathMotion:
        """Return a motion that leaves so much (K,), NaN beyond the ends. said: where it leads."""
        error = np.column_stack((left.real, left.imag))
        return PathMotion(
            gap=gap,
            free=free,
            square=self.square(error),
            left_m=rms(error[np.isfinite(error).all(axis=1)]),
            place=said,
            hint=hint,
            moved=moved or PathTransform(),
        )


class PathTransform(NamedTuple):
    """How a path u = a (v + arm exp(i h)) + b came about, delay_s late, h the headings of v.

    yaw_rad: by which the frame at the end of the arm is turned.
    """

    a: complex = 1.0 + 0.0j
    b: complex = 0.0j
    delay_s: float = 0.0
    arm: complex = 0.0j
    yaw_rad: float = 0.0

    @property
    def turn_rad(self) -> float:
        """By which headings are turned."""
        return float(np.angle(self.a)) + self.yaw_rad


@dataclass(frozen=True, kw_only=True)
class PathMotion:
    """A motion fitted to a path. free: its parameters. square, left_m: what is left of it.

    place: where the trajectory is then, in words; empty where it is only late.
    """

    gap: str
    free: int
    square: float
    left_m: float
    place: str
    hint: str
    moved: PathTransform

    @property
    def said(self) -> str:
        """What it is, in words."""
        delay = self.moved.delay_s
        if not delay:
            return f"the trajectory is {self.place}"
        when = f"the time stamps are {abs(delay):.3f} s too {'late' if delay > 0.0 else 'early'}"
        return f"{when} and the trajectory is {self.place}" if self.place else when


class Diagnosis(NamedTuple):
    """whole: causes that explain a difference. partly: what takes most of it away, as evidence."""

    whole: list[Cause]
    partly: list[Cause]


def diagnose(references: Sequence[Paths]) -> Diagnosis:
    """Return the simplest motion that takes most of a difference away, and headings; may be none.

    references: the same path beside each reference that it may be of, the first being preferred;
    it is fitted to the one that fits best.
    """
    diagnosis = Diagnosis([], [])
    if len(references[0].time_s) < FEWEST:
        return diagnosis
    paths, motion = simplest_motion(references)
    for explained, heading in _headings(paths, motion):
        (diagnosis.whole if explained else diagnosis.partly).append(heading)
    left = motion.left_m / paths.rms_m if paths.rms_m > _NO_MATTER_M else np.inf
    if motion.gap and left <= _EXPLAINS:
        said = (
            f"{motion.said}; with this corrected, the RMS difference from {paths.name} falls from "
            f"{paths.rms_m:.3f} to {motion.left_m:.3f} m"
        )
        diagnosis.whole.append(Cause(motion.gap, said, motion.hint))
    elif motion.gap and left <= _PARTLY:
        said = (
            f"in part, {motion.said}; this explains {100.0 * (1.0 - left):.0f} % of the RMS "
            f"difference from {paths.name}, {paths.rms_m:.3f} m"
        )
        diagnosis.partly.append(Cause(motion.gap, said, motion.hint))
    return diagnosis


def simplest_motion(references: Sequence[Paths]) -> tuple[Paths, PathMotion]:
    """Return the simplest motion of a path, beside the reference that it fits best.

    references: as of `diagnose`. Its gap is empty where no motion is simplest.
    """
    found: list[tuple[Paths, list[PathMotion]]] = [
        (reference, list(_motions(reference))) for reference in references
    ]
    paths, motions = min(found, key=lambda pair: min(m.square for m in pair[1]))
    motion = _simplest(motions) if paths.rms_m > _NO_MATTER_M else motions[0]
    if motion.gap in ("", "frame", "time"):
        motion = _within(motions, motion)
    if motion.gap == "frame":
        motion = _on_vehicle(paths) or motion
    return paths, motion


def frame_at_start(paths: Paths, motion: PathMotion) -> PathMotion:
    """Return the frame in which a path starts where the reference does, whatever follows.

    motion: the frame, or the vehicle's, that fits all of the path.
    """
    arm, yaw = motion.moved.arm, motion.moved.yaw_rad
    a = complex(np.exp(1j * (paths.pose[0, 2] - paths.reference[0, 2] - yaw)))
    start = complex(paths.v[0] + arm * np.exp(1j * paths.reference[0, 2]))
    return _of_frame(paths, PathTransform(a, complex(paths.u[0] - a * start), arm=arm, yaw_rad=yaw))


def _of_frame(paths: Paths, moved: PathTransform) -> PathMotion:
    """A motion into another frame of the map, and of the vehicle where there is a yaw."""
    left = paths.u - moved.a * (paths.v + moved.arm * np.exp(1j * paths.reference[:, 2])) - moved.b
    said = _rotated_and_shifted(moved.a, moved.b)
    if not moved.yaw_rad:
        return paths.motion("frame", 3, left, said, _FRAME_HINT, moved)
    said = (
        f"that of a frame {in_words(moved.arm.real, moved.arm.imag)} of the "
        f"reference point and turned by {np.degrees(moved.yaw_rad):.1f} degrees, {said}"
    )
    return paths.motion("lever", 6, left, said, _LEVER_HINT, moved)


def _complex(points: Array) -> Complex:
    found: Complex = points[:, :2] @ np.array([1.0, 1.0j])
    return found


def _simplest(motions: Sequence[PathMotion]) -> PathMotion:
    """The one with the fewest parameters that none with more fits better (F test).

    What all of them leave adds to both: the covariance, unless one fits as only a path of the
    same estimator does.
    """
    best = min(motion.square for motion in motions)
    open_square = _LIKE if best <= _EQUAL else 1.0

    def better(more: PathMotion, motion: PathMotion) -> bool:
        added, left = more.free - motion.free, _INDEPENDENT - more.free
        limit = 1.0 + added * f_quantile(_SURE, added, left) / left
        return motion.square + open_square > limit * (more.square + open_square)

    ranked = sorted(motions, key=lambda motion: (motion.free, motion.square))
    return next(
        motion
        for motion in ranked
        if not any(more.free > motion.free and better(more, motion) for more in ranked)
    )


def _within(motions: Sequence[PathMotion], found: PathMotion) -> PathMotion:
    """Return what explains most by no frame at all, if it leaves less than what was found.

    For that was found as if all that the covariance allows were open, and only a frame is.
    motions: the first leaves all as it is.
    """
    alone = [
        motion
        for motion in motions
        if motion.gap in ("time", "scale", "lever") and motion.free <= 2
    ]
    for motion in sorted(alone, key=lambda one: (one.free, one.left_m)):
        if (
            motion.left_m <= _PARTLY * motions[0].left_m
            and motion.left_m < _CLEARLY_LESS * found.left_m
        ):
            found = motion
    return found


def _motions(paths: Paths) -> Iterator[PathMotion]:
    """All that are known, fitted, each in least squares."""
    u, v, motion = paths.u, paths.v, paths.motion
    yield motion("", 0, u - v, "", "")
    for free, fit in _FRAMES:
        a, b, said = fit(u, v)
        grown = abs(abs(a) - 1.0) > _LEAST_SCALE
        if not a or ("times" in said and not grown):
            continue  # a path without extent has no scale; or of a scale that is none
        gap, hint = ("scale", _SCALE_HINT) if grown else ("frame", _FRAME_HINT)
        yield motion(gap, free, (u - a * v - b) / abs(a), said, hint, PathTransform(a, b))
    for said, flipped in (
        ("y has the opposite sign", v.conj()),
        ("x has the opposite sign", -v.conj()),
        ("x and y are exchanged", 1j * v.conj()),
    ):
        yield motion("mirrored", 0, u - flipped, f"mirrored: {said}", _MIRROR_HINT)
    a, b, said = _rigid(u, v.conj())
    yield motion("mirrored", 3, u - a * v.conj() - b, f"mirrored and {said}", _MIRROR_HINT)
    late = list(_late(paths))
    as_is, moved = _heading_spreads(paths, late[-1][1])
    known = as_is <= _NO_HEADINGS_RAD
    if not known or as_is >= _INTERPOLATED * moved:
        for free, delay, left, (a, b, said) in late:
            if abs(delay) < _LEAST_DELAY_S:
                continue
            yield motion("time", 1 + free, left, said, _TIME_HINT, PathTransform(a, b, delay))
    if known and moved >= _INTERPOLATED * as_is:
        ahead = np.exp(1j * paths.reference[:, 2])
        arm = complex(np.mean((u - v) / ahead))
        said = f"that of a point {in_words(arm.real, arm.imag, digits=3)} of the reference point"
        yield motion("lever", 2, u - v - arm * ahead, said, _LEVER_HINT)


def _on_vehicle(paths: Paths) -> PathMotion | None:
    """Fit another frame of the vehicle, in another frame of the map.

    None where the headings tell of none.
    """
    ahead = np.exp(1j * paths.reference[:, 2])
    columns = np.column_stack((paths.v, ahead, np.ones(len(ahead))))
    turn = np.linalg.lstsq(columns, paths.u, rcond=None)[0][0]
    a = complex(np.exp(1j * np.angle(turn)))
    arm, b = np.linalg.lstsq(
        np.column_stack((a * ahead, np.ones(len(ahead)))), paths.u - a * paths.v, rcond=None
    )[0]
    yaws = np.angle(np.exp(1j * paths.pose[:, 2]) / (a * ahead))
    yaw = float(np.angle(np.mean(np.exp(1j * yaws))))
    if abs(yaw) < _LEAST_HEADING_RAD or _spread(yaws) > _PARTLY * abs(yaw):
        return None
    return _of_frame(paths, PathTransform(a, complex(b), arm=complex(arm), yaw_rad=yaw))


def _heading_spreads(paths: Paths, delay: float) -> tuple[float, float]:
    """Of the headings' differences as they are, and so late.

    Another point of the vehicle has its heading; a late path has a late one.
    """
    t, heading = paths.time_s, np.unwrap(paths.pose[:, 2])
    late = np.interp(t + delay, t, heading)
    return _spread(heading - paths.reference[:, 2]), _spread(late - paths.reference[:, 2])


def _spread(angle: Array) -> float:
    """Standard deviation of angles (K,) about their mean."""
    each = np.exp(1j * angle)
    return float(np.std(np.angle(each * np.exp(-1j * np.angle(each.mean())))))


def _shifted(u: Complex, v: Complex) -> tuple[complex, complex, str]:
    b = complex(np.mean(u - v))
    return 1.0 + 0.0j, b, f"shifted by {_place(b)} m"


def _turned(about: str) -> Fit:
    def fit(u: Complex, v: Complex) -> tuple[complex, complex, str]:
        c = complex(v[0]) if about else 0.0j
        a = complex(np.exp(1j * np.angle(np.vdot(v - c, u - c))))
        return a, c - a * c, f"rotated by {_degrees(a)} about the log's {about or 'origin'}"

    return fit


def _rigid(u: Complex, v: Complex) -> tuple[complex, complex, str]:
    a = complex(np.exp(1j * np.angle(np.vdot(v - v.mean(), u - u.mean()))))
    b = complex(u.mean() - a * v.mean())
    return a, b, _rotated_and_shifted(a, b)


def _grown(about: str) -> Fit:
    def fit(u: Complex, v: Complex) -> tuple[complex, complex, str]:
        c = complex(v[0]) if about else 0.0j
        size = max(float(np.vdot(v - c, v - c).real), 1e-12)
        a = float(np.vdot(v - c, u - c).real) / size
        said = f"{a:.4f} times as large, scaled about the log's {about or 'origin'}"
        return complex(a), c - a * c, said

    return fit


def _similar(u: Complex, v: Complex) -> tuple[complex, complex, str]:
    w = v - v.mean()
    a = complex(np.vdot(w, u - u.mean()) / max(float(np.vdot(w, w).real), 1e-12))
    b = complex(u.mean() - a * v.mean())
    return a, b, f"{abs(a):.4f} times as large, {_rotated_and_shifted(a, b)}"


_FRAMES: tuple[tuple[int, Fit], ...] = (
    (1, _turned("")),
    (1, _turned("start")),
    (2, _shifted),
    (3, _rigid),
    (1, _grown("")),
    (1, _grown("start")),
    (4, _similar),
)
"""Parameters, and u = a v + b."""


def _late(paths: Paths) -> Iterator[tuple[int, float, Complex, tuple[complex, complex, str]]]:
    """The same path some time too late or too early, alone, shifted, and in another frame.

    Free parameters beside the delay [s], what is left (K,), and the fit.
    """
    from scipy.optimize import minimize_scalar  # takes long to load, and is rarely needed

    t = paths.time_s
    latest = min(_LATEST_S, 0.25 * float(t[-1] - t[0]))
    delays = np.linspace(-latest, latest, 41)
    step = float(delays[1] - delays[0])
    for free, fit in ((0, _as_is), (2, _shifted), (3, _rigid)):
        square = partial(_late_square, paths, fit)
        coarse = float(delays[int(np.argmin([square(d) for d in delays]))])
        best = minimize_scalar(square, bounds=(coarse - step, coarse + step), method="bounded")
        yield free, float(best.x), *_at_delay(paths, fit, best.x)


def _late_square(paths: Paths, fit: Fit, delay: float) -> float:
    return float(np.nanmean(np.abs(_at_delay(paths, fit, delay)[0]) ** 2))


def _at_delay(paths: Paths, fit: Fit, delay: float) -> tuple[Complex, tuple[complex, complex, str]]:
    """What is left (K,) of a path that is so late, NaN beyond its ends; and the fit."""
    t, at = paths.time_s, paths.time_s + delay
    inside = (at >= t[0]) & (at <= t[-1])
    u = np.interp(at[inside], t, paths.u.real) + 1j * np.interp(at[inside], t, paths.u.imag)
    v = paths.v[inside]
    a, b, said = fit(u, v)
    left = np.full(len(t), np.nan + 0.0j)
    left[inside] = u - a * v - b
    return left, (a, b, said)


def _as_is(u: Complex, v: Complex) -> tuple[complex, complex, str]:
    return 1.0 + 0.0j, 0.0j, ""


def _headings(paths: Paths, motion: PathMotion) -> Iterator[tuple[bool, Cause]]:
    """Headings that are off by much the same everywhere, or counted the other way.

    With each whether it explains all of the difference.
    """
    alone = paths.rms_m <= _NO_MATTER_M
    if motion.gap == "mirrored":
        return
    if alone and (reported := _no_heading(paths)):
        yield True, Cause("heading", reported, _WRITTEN_HINT)
        return
    both = np.exp(1j * (paths.pose[:, 2] + paths.reference[:, 2])).mean()
    each = np.exp(1j * (paths.pose[:, 2] - paths.reference[:, 2]))
    if alone and abs(both) >= 0.98 and abs(each.mean()) <= 0.9:
        said = (
            f"all headings are clockwise instead of counter-clockwise, from "
            f"{np.degrees(float(np.angle(both))):.0f} degrees"
        )
        yield True, Cause("heading", said, _HEADING_HINT.format("sign"))
        return
    each = each * np.exp(-1j * motion.moved.turn_rad)
    mean, together = float(np.angle(each.mean())), float(abs(each.mean()))
    varies = _spread(np.angle(each))
    least = _LEAST_ALONE_RAD if alone else _LEAST_HEADING_RAD
    if abs(mean) < least or together < 0.98 or (alone and varies > _PARTLY * abs(mean)):
        return
    said = (
        f"all headings differ by {np.degrees(mean):.1f} degrees from those of {paths.name}, the "
        f"positions by {motion.left_m:.2f} m (RMS)"
    )
    explained = varies <= _EXPLAINS * abs(mean)
    yield explained, Cause("heading", said, _HEADING_HINT.format("zero and sign"))


def _no_heading(paths: Paths) -> str:
    """Evidence where what is written is none: one value, degrees, or not halved."""
    own, right = paths.pose[:, 2], paths.reference[:, 2]
    if _spread(right) <= _NO_HEADINGS_RAD:
        return ""
    if _spread(own) < _LEAST_ALONE_RAD:
        angle = np.degrees(float(np.angle(np.exp(1j * own).mean())))
        return f"all headings are {angle:.0f} degrees, but those of {paths.name} vary"
    wrapped = np.angle(np.exp(1j * right))
    for factor, said in (
        (180.0 / np.pi, "the headings are in degrees instead of radians"),
        (2.0, "the angle of the quaternions is not halved: they contain sin(h), cos(h)"),
    ):
        for of in (right, wrapped, wrapped % (2.0 * np.pi)):
            if np.exp(1j * (own - factor * of)).mean().real >= _SAME_HEADINGS:
                return said
    return ""


def _rotated_and_shifted(a: complex, b: complex) -> str:
    return f"rotated by {_degrees(a)} about the log's origin and shifted by {_place(b)} m"


def _place(b: complex) -> str:
    return f"({b.real:.3f}, {b.imag:.3f})"


def _degrees(a: complex) -> str:
    return f"{np.degrees(np.angle(a)):.2f} degrees"
