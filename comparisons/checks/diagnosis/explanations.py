"""Known mistakes that reproduce a filter's recorded figures where its model differs.

Each is tried on the records: it is named only when it explains all that deviates, to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.logs.log import Log
from comparisons.logs.odometry import RelativePoses
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import MeasurementRecords
from ekf_reference.models.motion import AckermannModel, MotionModel, MotionStep

Scale = float | tuple[float, float]
"""What a control is multiplied by: all of it, or speed and turn."""

_EQUAL = 1e-7
_STEPS = 300
"""So many steps are looked at, spread over the log."""


def explain(log: Log, run: EkfRun) -> tuple[str, ...]:
    """What the filter seems to have done; nothing for filters of another state or observation."""
    if run.trace.prior_pose.shape != (3,) or run.own_axes:
        return ()
    return (
        *_steps(log, run),
        *_updates(log, run),
        *_beginnings(log, run),
        *_positions(run),
    )


def _equal(a: Array, b: Array) -> bool:
    """To rounding, relative to the largest entry of the second."""
    return bool(a.size and np.max(np.abs(a - b)) <= _EQUAL * max(1e-6, float(np.abs(b).max())))


def _steps(log: Log, run: EkfRun) -> Iterator[str]:
    trace, timeline = run.trace, run.timeline
    if len(trace.departed) != len(timeline.control):
        yield f"{len(trace.departed)} predictions for {len(timeline.control)} intervals"
        return
    model = motion_model(log)
    rows = np.unique(np.linspace(0, len(trace.departed) - 1, _STEPS).astype(np.intp))
    rows = rows[1:] if len(rows) > 1 else rows  # the first has none before it
    taken = _Predictions(
        trace.departed[rows],
        timeline.control,
        timeline.step_duration_s,
        rows,
        trace.arrived[rows] - trace.departed[rows],
    )
    arrived, f, b = taken.by(model)
    moved = arrived - taken.departed
    if not _equal(taken.move, moved):
        found = _displaced(taken, model, moved, isinstance(log.odometry, RelativePoses))
        yield from () if found is None else (found,)
        return
    if not _equal(trace.f[rows], f):
        opposite = f.copy()
        opposite[:, :2, 2] *= -1.0
        if _equal(trace.f[rows], opposite):
            yield "F's position terms by heading have the opposite sign"
        elif _equal(trace.f[rows], f.transpose(0, 2, 1)):
            yield "F is transposed"
        elif _equal(trace.f[rows], np.broadcast_to(np.eye(3), f.shape)):
            yield "F is the identity"
    yield from _step_noise(log, run, rows, b)


@dataclass(frozen=True)
class _Predictions:
    """R of a filter's N predictions, to be compared with those of a model.

    departed: (R, 3) poses. control: (N, ...) and duration_s: (N,) of all. rows: (R,) which of
    them. move: (R, 3) how far the filter went, arrived - departed.
    """

    departed: Array
    control: Array
    duration_s: Array
    rows: Index
    move: Array

    def by(
        self, model: MotionModel, factor: Scale = 1.0, duration_s: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """A model's poses (R, 3), F and B; control times a factor, for durations (N,)."""
        last = self.duration_s if duration_s is None else duration_s
        each: list[MotionStep] = [
            model.step(departed, self.control[i] * factor, float(s))
            for departed, i, s in zip(
                self.departed, self.rows.tolist(), last[self.rows], strict=True
            )
        ]
        return (
            np.array([one.pose for one in each]),
            np.array([one.jacobian_pose for one in each]),
            np.array([one.jacobian_control for one in each]),
        )

    def lead(
        self, model: MotionModel, factor: Scale = 1.0, duration_s: Array | None = None
    ) -> bool:
        """Whether the filter went where that leads."""
        return _equal(self.move, self.by(model, factor, duration_s)[0] - self.departed)


def _displaced(
    taken: _Predictions, model: MotionModel, moved: Array, displacements: bool
) -> str | None:
    """Why steps lead elsewhere, where that is known.

    moved: (R, 3) as the log's own model has it. displacements: the control is measured poses.
    """
    found = None if displacements else _mistaken_control(taken, model, moved)
    if found is None and taken.lead(_Twice(model)):
        found = "the control is applied twice"
    if found is None:
        found = _turn_bias(taken, moved)
    if found is None and isinstance(model, AckermannModel):
        found = _mistaken_vehicle(taken, model)
    return found


def _mistaken_control(taken: _Predictions, model: MotionModel, moved: Array) -> str | None:
    """Signs, intervals and speeds of a wheeled vehicle."""
    duration = taken.duration_s
    if taken.lead(model, (1.0, -1.0)):
        turn = "steering" if isinstance(model, AckermannModel) else "turn"
        return f"the {turn} has the opposite sign"
    if taken.lead(model, duration_s=np.concatenate((duration[:1], duration[:-1]))):
        return "a step lasts the previous step's interval"
    far, meant = (np.linalg.norm(m[:, :2], axis=1) for m in (taken.move, moved))
    driven = meant > 1e-6
    if not driven.any():
        return None
    ratio = far[driven] / meant[driven]
    factor, seconds = float(np.median(ratio)), ratio * duration[taken.rows][driven]
    always = float(np.median(seconds))
    if taken.lead(model, duration_s=factor * duration):
        return f"every control acts for {factor:.4g} times its interval"
    if taken.lead(model, duration_s=np.full(len(duration), always)):
        return f"the interval is always {always:.4g} s"
    if taken.lead(model, (factor, 1.0)):
        return f"the speed is {factor:.4g} times the recorded"
    return None


def _turn_bias(taken: _Predictions, moved: Array) -> str | None:
    """A constant rate that is added to every turn."""
    rate = (taken.move - moved)[:, 2] / taken.duration_s[taken.rows]
    if _equal(taken.move[:, :2], moved[:, :2]) and np.ptp(rate) <= 1e-6:
        return f"the turn has a bias of {np.median(rate):.3g} rad/s"
    return None


def _mistaken_vehicle(taken: _Predictions, model: AckermannModel) -> str | None:
    """Measures of a car that are left out, of opposite sign, or others."""
    for part in ("encoder_offset_m", "sensor_forward_m", "sensor_left_m"):
        own = getattr(model, part)
        for factor, how in ((0.0, "is left out"), (-1.0, "has the opposite sign")):
            if own and taken.lead(replace(model, **{part: factor * own})):
                return f"{part} of the vehicle {how}"
    if model.sensor_forward_m or model.sensor_left_m:
        bare = replace(model, sensor_forward_m=0.0, sensor_left_m=0.0)
        if taken.lead(bare):
            return "the sensor's place on the vehicle is left out"

    def miss(wheelbase_m: float) -> float:
        other = replace(model, wheelbase_m=wheelbase_m)
        return float(np.sum((taken.by(other)[0] - taken.departed - taken.move) ** 2))

    own = model.wheelbase_m
    best = minimize_scalar(miss, bounds=(0.3 * own, 3.0 * own), options={"xatol": 1e-9 * own})
    if best.fun < 1e-6 * miss(own):
        return f"the wheelbase is {best.x:.3f} m, where the log says {own:.3f} m"
    return None


class _Twice:
    """Two steps in one."""

    def __init__(self, model: MotionModel) -> None:
        self._model = model

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        one = self._model.step(pose, control, duration_s)
        return self._model.step(one.pose, control, duration_s)


def _step_noise(log: Log, run: EkfRun, rows: Index, b: Array) -> Iterator[str]:
    """Q is B S B^T and what every step adds."""
    if isinstance(log.odometry, RelativePoses):
        return
    noise, duration = log.odometry.noise, run.timeline.step_duration_s[rows]
    added = np.zeros((len(rows), 3, 3))
    added[:, 0, 0] = added[:, 1, 1] = noise.variance_rate_position * duration
    added[:, 2, 2] = noise.variance_rate_heading * duration
    stated = run.timeline.control_covariance[rows]

    def spread(covariance: Array) -> Array:
        total: Array = b @ covariance @ b.transpose(0, 2, 1)
        return total

    have, meant = run.trace.q[rows], spread(stated)
    if _equal(have, meant + added):
        return
    size = float(np.sum((have - added) * meant) / np.sum(meant * meant))
    if _equal(have - added, meant / duration[:, None, None] ** 2):
        yield "the Jacobian by the control is not multiplied by the interval"
        return
    for text, covariance in (
        ("Q holds sigma where its square belongs", np.sqrt(stated)),
        ("Q holds variances that were squared twice", stated**2),
        (f"Q is {size:.4g} times what it should be", size * stated),
    ):
        if _equal(have, spread(covariance) + added):
            yield text
            return


def _rays(r: MeasurementRecords) -> tuple[Array, Array, Array]:
    """Expected sightings (N, 2), H_v (N, 2, 3) and H_l (N, 2, 2) of poses and landmarks."""
    dx, dy = (r.landmark - r.pose[:, :2]).T
    q = dx * dx + dy * dy
    root = np.sqrt(q)
    z = np.column_stack((root, np.arctan2(dy, dx) - r.pose[:, 2]))
    by_landmark = np.stack(
        (np.column_stack((dx / root, dy / root)), np.column_stack((-dy / q, dx / q))), axis=1
    )
    by_pose = np.concatenate((-by_landmark, np.zeros((len(q), 2, 1))), axis=2)
    by_pose[:, 1, 2] = -1.0
    return z, by_pose, by_landmark


def _measured(log: Log, r: MeasurementRecords) -> tuple[Array, Array]:
    seen = log.sightings
    z = np.column_stack((seen.range_m, seen.bearing_rad))
    sigma = np.column_stack((seen.sigma_range_m, seen.sigma_bearing_rad))
    return z[r.number], sigma[r.number]


def _updates(log: Log, run: EkfRun) -> Iterator[str]:
    r = run.trace.measurements[POINT]
    if not len(r.step):
        return
    z, sigma = _measured(log, r)
    expected, by_pose, by_landmark = _rays(r)
    nu = z - expected
    nu[:, 1] = wrap_angle(nu[:, 1])
    turns = (r.innovation[:, 1] - nu[:, 1]) / np.pi
    off = np.abs(turns) > _EQUAL
    mirrored = -z[:, 1] - expected[:, 1]
    by_range = r.innovation[:, 0] - nu[:, 0]
    if _equal(r.innovation, -nu):
        yield "the innovation is expected minus measured"
    elif off.any() and np.abs(wrap_angle(r.innovation[:, 1] - mirrored)).max() < _EQUAL:
        yield "bearings are counted clockwise"
    elif not off.any() and np.abs(by_range).max() > _EQUAL and np.ptp(by_range) < _EQUAL:
        yield f"ranges are taken {np.median(by_range):+.3g} m"
    elif off.any() and np.abs(turns - np.round(turns)).max() < 1e-6:
        if np.all(np.round(turns) % 2 == 0):
            yield f"{np.count_nonzero(off)} bearing innovations are not wrapped"
        else:
            yield f"{np.count_nonzero(off)} bearing innovations are half a turn off: a quadrant"
    yield from _sighting_noise("R", r.noise * r.weight[:, None, None], sigma)
    yield from _jacobians(r, run, by_pose, by_landmark)


def _jacobians(
    r: MeasurementRecords, run: EkfRun, by_pose: Array, by_landmark: Array
) -> Iterator[str]:
    have = np.concatenate((r.jacobian_pose, r.jacobian_other), axis=2)
    want = np.concatenate((by_pose, by_landmark), axis=2)
    if _equal(have, want):
        return
    if not have[:, 1].any() and _equal(have[:, 0], want[:, 0]):
        yield "the bearing row is zero: only ranges inform"
        return
    if not have[:, :, 2].any():
        yield "H's column by heading is zero"
        return
    exchanged = want.copy()
    exchanged[:, 1, (0, 1, 3, 4)] *= -1.0
    if _equal(have, exchanged):
        yield "the bearing row's position terms have their signs exchanged"
        return
    scans, which = np.unique(r.step, return_inverse=True)
    first = np.searchsorted(r.step, scans)
    rows = np.flatnonzero(which > 0)
    last = r.pose[first[which[rows] - 1]]
    for text, pose in (
        ("H is linearised at the pose of the scan before", last),
        ("H is linearised before the last prediction", run.trace.departed[r.step[rows] - 1]),
    ):
        old = r.rows(rows)
        _, a, c = _rays(replace(old, pose=pose))
        if _equal(have[rows], np.concatenate((a, c), axis=2)):
            yield text
            return
    rows_off = [name for k, name in enumerate(("range", "bearing"))
                if not _equal(have[:, k], want[:, k])]  # fmt: skip
    if len(rows_off) == 1:
        yield f"the {rows_off[0]} row of H is wrong, the other is right"


def _sighting_noise(name: str, have: Array, sigma: Array) -> Iterator[str]:
    """R from sigmas (N, 2)."""
    meant = _diagonal(sigma**2)
    if _equal(have, meant):
        return
    size = float(np.median(have[:, 0, 0] / meant[:, 0, 0]))
    degrees = np.degrees(1.0)
    for text, covariance in (
        (f"{name} holds sigma where its square belongs", _diagonal(sigma)),
        (f"{name} holds variances that were squared twice", _diagonal(sigma**4)),
        (f"{name} is {size:.4g} times what it should be", size * meant),
        (f"{name} takes degrees for radians", _diagonal((sigma * (1.0, degrees)) ** 2)),
        (f"{name} takes radians for degrees", _diagonal((sigma * (1.0, 1.0 / degrees)) ** 2)),
        (f"{name} exchanges range and bearing", _diagonal(sigma[:, ::-1] ** 2)),
    ):
        if _equal(have, covariance):
            yield text
            return


def _diagonal(variance: Array) -> Array:
    full: Array = variance[:, :, None] * np.eye(2)
    return full


def _beginnings(log: Log, run: EkfRun) -> Iterator[str]:
    r = run.trace.initialisations[POINT]
    r = r.rows(np.flatnonzero((r.number >= 0) & (r.weight > 0.0)))
    if not len(r.step):
        return
    z, sigma = _measured(log, r)
    towards = r.pose[:, 2] + z[:, 1]
    ray = z[:, :1] * np.column_stack((np.cos(towards), np.sin(towards)))
    point = r.pose[:, :2] + ray
    off = np.abs(r.landmark - point).max(axis=1) > _EQUAL
    if off.any():
        updates = run.trace.measurements[POINT]
        before = {int(step): pose for step, pose in zip(updates.step[::-1], updates.pose[::-1],
                                                        strict=True)}  # fmt: skip
        pose = np.array([before.get(int(step), own) for step, own in zip(r.step, r.pose,
                                                                       strict=True)])  # fmt: skip
        towards = pose[:, 2] + z[:, 1]
        older = pose[:, :2] + z[:, :1] * np.column_stack((np.cos(towards), np.sin(towards)))
        if _equal(r.landmark[off], older[off]):
            yield "landmarks begin from the pose before the update"
        elif _equal(r.landmark[off], (r.pose[:, :2] - ray)[off]):
            yield "landmarks begin behind the vehicle: their direction lost its quadrant"
        else:
            towards = r.pose[:, 2] - z[:, 1]
            mirrored = np.column_stack((np.cos(towards), np.sin(towards)))
            if _equal(r.landmark, r.pose[:, :2] + z[:, :1] * mirrored):
                yield "landmarks begin as if bearings were counted clockwise"
    own = np.broadcast_to(np.eye(2), r.jacobian_other.shape)
    if _equal(r.jacobian_other, own):
        yield "G_z is the identity: R is not rotated when a landmark begins"
    if not len(run.trace.measurements[POINT].step):
        yield from _sighting_noise("R", r.noise, sigma)


def _positions(run: EkfRun) -> Iterator[str]:
    r = run.trace.positions
    if run.positions is None or not len(r.step):
        return
    apart = run.positions.position_m[r.number] - r.pose[:, :2]
    stated = run.positions.antenna_m
    arm = apart - r.innovation
    cos, sin = np.cos(r.pose[:, 2]), np.sin(r.pose[:, 2])
    lever = np.column_stack((cos * arm[:, 0] + sin * arm[:, 1], cos * arm[:, 1] - sin * arm[:, 0]))
    mean = lever.mean(axis=0)
    if np.abs(lever - mean).max() > _EQUAL or np.allclose(mean, stated, atol=_EQUAL):
        return
    if np.abs(mean).max() <= _EQUAL:
        yield "the lever arm of the antenna is left out"
    else:
        yield (
            f"the lever arm of the antenna is ({mean[0]:.3f}, {mean[1]:.3f}) m, where the log says "
            f"({stated[0]:.3f}, {stated[1]:.3f}) m"
        )
