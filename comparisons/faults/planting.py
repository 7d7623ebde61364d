"""A fault of the grammar in a filter that runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.faults.fault import (
    Family,
    Fault,
    Plant,
    keeping,
    moving,
    observing,
    remembering,
    stepping,
)
from comparisons.faults.grammar import (
    B_OF_DISPLACEMENT,
    EXPECTED,
    G_X,
    G_Z,
    INNOVATION,
    PLACE,
    POSITION,
    VELOCITY,
    B,
    Composition,
    F,
    H,
    Q,
    R,
    Slot,
    Values,
    joined_changes,
    numbered_changes,
    single_changes,
)
from comparisons.faults.models import wrong_quadrant
from comparisons.logs.log import Log
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import NewLandmarks, PredictedMeasurements
from ekf_reference.models.motion import MotionStep
from ekf_reference.models.range_bearing import RangeBearing

AFTER, BEFORE = "linearised at the pose after the step", "that of the previous step"
OLD_POSE = "linearised at the pose of the previous scan"
INTERVAL, RANGE = "the interval", "the range"
STEPS = F, B, B_OF_DISPLACEMENT
ON_ARRIVAL, DEAD_RECKONED = (
    "along the heading after the step",
    "along the heading of plain dead reckoning, not the filter's",
)
NOT_WRAPPED, HALF_WRAPPED = (
    "z - h, not wrapped",
    "z - h, where h alone is wrapped",
)
FROM_OLD, QUADRANT = (
    "that from the pose before the update",
    "that by atan where atan2 belongs",
)
AT_OLD = "that at the pose of the previous scan"
TURN_PER_METRE = "the turn over the distance"
PLANTED = *STEPS, VELOCITY, Q, H, R, EXPECTED, INNOVATION, PLACE, G_X, G_Z
"""Slots whose faults a filter can be given."""
_SAMPLES = 20
"""Steps and measurements by which faults without an effect, and equal ones, are told."""
_OF_STREAMS = ("root", "square", "exchanged", "times")
"""Changes of R that are those of the log's sigmas."""
_TWICE = ("factor +2", "factor -2")
"""Changes that are one change twice."""
Changed = Callable[[Values], Array]


def has(slot: Slot) -> Values:
    """Return values of one record with all that faults of a slot may read."""
    factor = np.ones((1, *slot.shape))
    factors = {
        **dict.fromkeys((*STEPS, Q, VELOCITY), (INTERVAL,)),
        F: (INTERVAL, TURN_PER_METRE),
        **dict.fromkeys((H, R, EXPECTED, PLACE, G_X, G_Z), (RANGE,)),
    }
    elsewhere = {
        F: (AFTER, BEFORE),
        Q: (BEFORE,),
        VELOCITY: (ON_ARRIVAL, BEFORE, DEAD_RECKONED),
        EXPECTED: (AT_OLD, QUADRANT),
        INNOVATION: (NOT_WRAPPED, HALF_WRAPPED),
        PLACE: (FROM_OLD, QUADRANT),
        H: (OLD_POSE,),
        G_X: (OLD_POSE,),
        G_Z: (OLD_POSE,),
    }
    turning = slot in (B, B_OF_DISPLACEMENT, Q, VELOCITY, PLACE, POSITION)
    return Values(
        sound=factor,
        factors=dict.fromkeys(factors.get(slot, ()), factor[:, 0, 0]),
        heading=factor[:, 0, 0] if turning else None,
        elsewhere=dict.fromkeys(elsewhere.get(slot, ()), factor),
    )


class ComposedFaults(NamedTuple):
    """Faults of the models by slot and change.

    single: of one change without a number. joined: of two. numbered: of one with a number.
    """

    single: list[Fault]
    joined: list[Fault]
    numbered: list[Family]


def composed_faults(log: Log) -> ComposedFaults:
    """Return the faults that a filter of a log can be given.

    Of several that make the same values, one: that of the largest part. None without an effect.
    """
    composed = ComposedFaults([], [], [])
    for slot, values in sound_values(log).items():
        made = {(np.round(values.sound, 9) + 0.0).tobytes()}
        for fault in single_changes(slot, values):
            if _is_new(fault, values, made):
                twice = fault.change in _TWICE
                level = composed.joined if twice else composed.single
                level.append(Fault(fault.said(), planted(fault)))
        for fault in joined_changes(slot, values):
            if _is_new(fault, values, made):
                composed.joined.append(Fault(fault.said(), planted(fault)))
        for fault in numbered_changes(slot):
            if _is_new(fault, values, made):
                composed.numbered.append(_family(fault))
    return composed


def _is_new(fault: Composition, values: Values, made: set[bytes]) -> bool:
    """Whether a fault makes values that none made before; they are then among these."""
    with np.errstate(all="ignore"):
        changed = fault.values(values, *(number + 0.7 for number in fault.start))
    key = (np.round(changed, 9) + 0.0).tobytes()  # no negative zeros
    if key in made or np.array_equal(changed, values.sound):
        return False
    made.add(key)
    return not (fault.slot is R and fault.change in _OF_STREAMS)


def sound_values(log: Log) -> dict[Slot, Values]:
    """What a sound filter of a log has in some steps and measurements, by what can be planted."""
    return {**_sound_steps(log), **_sound_measurements()}


def _sound_steps(log: Log) -> dict[Slot, Values]:
    """Of the log's own motion, from poses drawn at random."""
    timeline, model = build_timeline(log), motion_model(log)
    some = np.unique(np.linspace(0, len(timeline.control) - 1, _SAMPLES).astype(int))
    pose = np.random.default_rng(0).uniform(0.3, 1.2, (len(some), 3))
    duration_s = timeline.step_duration_s[some]

    def steps_from(poses: Array) -> list[MotionStep]:
        return [
            model.step(at, timeline.control[k], float(s))
            for at, k, s in zip(poses, some, duration_s, strict=True)
        ]

    steps, after = steps_from(pose), steps_from(pose + (0.0, 0.0, 0.4))
    here, there = (np.array([step.jacobian_pose for step in each]) for each in (steps, after))
    by_control = np.array([step.jacobian_control for step in steps])
    control_noise = timeline.control_covariance[some]
    noise = by_control @ control_noise @ by_control.mT + 1e-6 * np.eye(3)
    factors, before = {INTERVAL: duration_s}, np.roll(here, 1, axis=0)
    velocity, on_arrival = (
        (np.array([step.pose for step in each]) - at)[:, :, None] / duration_s[:, None, None]
        for each, at in ((steps, pose), (after, pose + (0.0, 0.0, 0.4)))
    )
    moved = [step.pose - at for step, at in zip(steps, pose, strict=True)]
    turning = {TURN_PER_METRE: np.array([_turn_per_metre(step) for step in moved])}
    return {
        VELOCITY: Values(
            sound=velocity,
            factors=factors,
            heading=pose[:, 2],
            elsewhere={
                ON_ARRIVAL: on_arrival,
                BEFORE: np.roll(velocity, 1, axis=0),
                DEAD_RECKONED: 0.5 * (velocity + on_arrival),
            },
        ),
        F: Values(sound=here, factors=factors | turning, elsewhere={AFTER: there, BEFORE: before}),
        (B if by_control.shape[2] == 2 else B_OF_DISPLACEMENT): Values(
            sound=by_control, factors=factors, heading=pose[:, 2]
        ),
        Q: Values(
            sound=noise,
            factors=factors,
            heading=pose[:, 2],
            elsewhere={BEFORE: np.roll(noise, 1, axis=0)},
        ),
    }


def _turn_per_metre(moved: Array) -> float:
    """Of a step (3,); zero where it leads nowhere."""
    way = float(np.hypot(*moved[:2]))
    return float(moved[2]) / way if way else 0.0


def _sound_measurements() -> dict[Slot, Values]:
    """Of points around two poses; R differs from measurement to measurement."""
    rng, model = np.random.default_rng(1), RangeBearing()
    pose, old = rng.uniform(0.3, 1.2, (2, 3))
    z = np.column_stack((rng.uniform(2.0, 20.0, _SAMPLES), rng.uniform(-1.0, 1.0, _SAMPLES)))
    new, new_of_old = model.invert(pose, z), model.invert(old, z)
    measurements, seen_of_old = (model.predict(at, new.landmark) for at in (pose, old))
    noise = np.array((0.04, 0.01)) * np.eye(2) * rng.uniform(1.0, 2.0, (_SAMPLES, 1, 1))
    innovation = rng.standard_normal((_SAMPLES, 2, 1))
    turns = 2.0 * np.pi * rng.integers(-1, 2, (2, _SAMPLES))
    way = (new.landmark - pose[:2])[:, :, None]
    factors = {RANGE: z[:, 0]}

    def of(sound: Array, old_one: Array | None = None) -> Values:
        elsewhere = {} if old_one is None else {OLD_POSE: old_one}
        return Values(sound=sound, factors=factors, elsewhere=elsewhere)

    def turned(sound: Array, turn: Array) -> Array:
        other = sound.copy()
        other[:, 1, 0] += turn
        return other

    return {
        H: of(_joint(measurements), _joint(seen_of_old)),
        R: of(noise),
        EXPECTED: Values(
            sound=measurements.z[:, :, None],
            factors=factors,
            elsewhere={
                AT_OLD: seen_of_old.z[:, :, None],
                QUADRANT: turned(measurements.z[:, :, None], 0.5 * turns[0]),
            },
        ),
        INNOVATION: Values(
            sound=innovation,
            elsewhere={
                NOT_WRAPPED: turned(innovation, turns[0]),
                HALF_WRAPPED: turned(innovation, turns[1]),
            },
        ),
        PLACE: Values(
            sound=way,
            factors=factors,
            heading=np.full(_SAMPLES, pose[2]),
            elsewhere={
                FROM_OLD: (new_of_old.landmark - pose[:2])[:, :, None],
                QUADRANT: np.where(turns[0, :, None, None] > 0.0, -way, way),
            },
        ),
        G_X: of(new.jacobian_pose, new_of_old.jacobian_pose),
        G_Z: of(new.jacobian_z, new_of_old.jacobian_z),
    }


def _family(fault: Composition) -> Family:
    """The faults that differ by the number of one."""
    (neutral,) = fault.start
    return Family(
        f"{fault.slot.name}, {fault.change}",
        neutral=neutral,
        factor=neutral != 0.0,
        plant=partial(planted, fault),
        said=fault.said,
    )


def planted(fault: Composition, *numbers: float) -> Plant:
    """Return what puts a fault into a filter that has not started.

    Args:
        fault: Of a slot that is PLANTED.
        numbers: As many as it has.
    """

    def changed(values: Values) -> Array:
        return fault.values(values, *numbers)

    made = {
        **dict.fromkeys(STEPS, _in_control),
        F: _in_step,
        VELOCITY: _in_velocity,
        Q: _in_step_noise,
        INNOVATION: _in_innovation,
        H: _in_prediction,
        EXPECTED: _in_expected,
        R: _in_noise,
        PLACE: _in_place,
        **dict.fromkeys((G_X, G_Z), _in_inverse),
    }
    return remembering(lambda: made[fault.slot](fault, changed))


def _in_noise(fault: Composition, changed: Changed) -> Plant:
    def measured(sound: Any, z: Array, sigma: Array) -> tuple[Array, Array]:
        z, noise = sound(z, sigma)
        return z, changed(Values(sound=noise, factors={RANGE: z[:, 0]}))

    return observing(measured=measured)


def _in_control(fault: Composition, changed: Changed) -> Plant:
    def step(sound: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = sound(pose, control, duration_s)
        values = Values(
            sound=moved.jacobian_control[None],
            factors={INTERVAL: np.array([duration_s])},
            heading=np.array([pose[2]]),
        )
        return moved._replace(jacobian_control=changed(values)[0])

    return moving(step)


def _in_innovation(fault: Composition, changed: Changed) -> Plant:
    def innovation(sound: Any, z: Array, z_hat: Array) -> Array:
        nu: Array = sound(z, z_hat)
        wrapped = z_hat.copy()
        wrapped[..., 1] = np.angle(np.exp(1j * z_hat[..., 1]))

        def column(vectors: Array) -> Array:
            return vectors.reshape(-1, 2, 1)

        values = Values(
            sound=column(nu),
            elsewhere={NOT_WRAPPED: column(z - z_hat), HALF_WRAPPED: column(z - wrapped)},
        )
        return changed(values).reshape(nu.shape)

    return observing(innovation=innovation)


def _in_velocity(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []
    heading_rad: list[float] = []

    def step(sound: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = sound(pose, control, duration_s)
        if not duration_s:
            return moved
        elsewhere = dict[str, Array]()

        def along(heading: float) -> Array:
            departed = np.append(pose[:2], heading)
            way: Array = sound(departed, control, duration_s).pose - departed
            return way[None, :, None] / duration_s

        velocity = along(pose[2])
        if fault.reads == ON_ARRIVAL:
            elsewhere[ON_ARRIVAL] = along(moved.pose[2])
        elif fault.reads == DEAD_RECKONED:
            reckoned = heading_rad[0] if heading_rad else float(pose[2])
            elsewhere[DEAD_RECKONED] = along(reckoned)
            heading_rad[:] = [reckoned + float(moved.pose[2] - pose[2])]
        elif fault.reads == BEFORE:
            elsewhere[BEFORE] = last[0] if last else velocity
            last[:] = [velocity]
        values = Values(
            sound=velocity,
            factors={INTERVAL: np.array([duration_s])},
            heading=np.array([pose[2]]),
            elsewhere=elsewhere,
        )
        return moved._replace(pose=pose + duration_s * changed(values)[0, :, 0])

    return moving(step)


def _in_step_noise(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []
    interval_s = [0.0]

    def timed(sound: Any, control: Array, covariance: Array, duration_s: float) -> None:
        interval_s[0] = duration_s
        sound(control, covariance, duration_s)

    def predict(sound: Any, pose: Array, jacobian_pose: Array, noise: Array) -> None:
        elsewhere = {BEFORE: last[0] if last else noise[None]}
        last[:] = [noise[None].copy()]
        values = Values(
            sound=noise[None],
            factors={INTERVAL: np.array(interval_s)},
            heading=sound.__self__.pose[2:],
            elsewhere=elsewhere,
        )
        sound(pose, jacobian_pose, changed(values)[0])

    def plant(ekf: Ekf) -> None:
        stepping(predict=timed)(ekf)
        keeping(predict=predict)(ekf)

    return plant


def _in_step(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []

    def step(sound: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = sound(pose, control, duration_s)
        jacobian, elsewhere = moved.jacobian_pose[None], dict[str, Array]()
        if fault.reads == AFTER:
            there = sound(np.append(pose[:2], moved.pose[2]), control, duration_s)
            elsewhere[AFTER] = there.jacobian_pose[None]
        elif fault.reads == BEFORE:
            elsewhere[BEFORE] = last[0] if last else jacobian
            last[:] = [jacobian.copy()]
        turn = _turn_per_metre(moved.pose - pose)
        factors = {INTERVAL: np.array([duration_s]), TURN_PER_METRE: np.array([turn])}
        values = Values(sound=jacobian, factors=factors, elsewhere=elsewhere)
        return moved._replace(jacobian_pose=changed(values)[0])

    return moving(step)


def _in_expected(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        predicted: PredictedMeasurements = sound(pose, landmarks)
        elsewhere = dict[str, Array]()
        if fault.reads == AT_OLD:
            elsewhere[AT_OLD] = sound(last[0] if last else pose, landmarks).z[:, :, None]
            last[:] = [np.array(pose)]
        elif fault.reads == QUADRANT:
            by_atan = predicted.z.copy()
            way = landmarks - pose[:2]
            by_atan[:, 1] = np.arctan(way[:, 1] / way[:, 0]) - pose[2]
            elsewhere[QUADRANT] = by_atan[:, :, None]
        values = Values(
            sound=predicted.z[:, :, None],
            factors={RANGE: predicted.z[:, 0]},
            elsewhere=elsewhere,
        )
        return predicted._replace(z=changed(values)[:, :, 0])

    return observing(predict=predict)


def _in_prediction(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        predicted: PredictedMeasurements = sound(pose, landmarks)
        elsewhere = dict[str, Array]()
        if fault.reads == OLD_POSE:
            elsewhere[OLD_POSE] = _joint(sound(last[0] if last else pose, landmarks))
            last[:] = [np.array(pose)]
        factors = {RANGE: predicted.z[:, 0]}
        values = Values(sound=_joint(predicted), factors=factors, elsewhere=elsewhere)
        of_pose, of_landmark = np.split(changed(values), [3], axis=2)
        return predicted._replace(jacobian_pose=of_pose, jacobian_landmark=of_landmark)

    return observing(predict=predict)


def _joint(predicted: PredictedMeasurements) -> Array:
    """H (m, 2, 5) by the pose and the landmark."""
    return np.concatenate((predicted.jacobian_pose, predicted.jacobian_landmark), axis=2)


def _in_place(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        predicted: PredictedMeasurements = sound(pose, landmarks)
        last[:] = [np.array(pose)]
        return predicted

    def invert(sound: Any, pose: Array, z: Array) -> NewLandmarks:
        new: NewLandmarks = sound(pose, z)
        way = (new.landmark - pose[:2])[:, :, None]
        elsewhere = dict[str, Array]()
        if fault.reads == FROM_OLD:
            old: NewLandmarks = sound(last[0] if last else pose, z)
            elsewhere[FROM_OLD] = (old.landmark - pose[:2])[:, :, None]
        elif fault.reads == QUADRANT:
            other = wrong_quadrant(sound, pose, z)
            elsewhere[QUADRANT] = (other.landmark - pose[:2])[:, :, None]
        values = Values(
            sound=way,
            factors={RANGE: z[:, 0]},
            heading=np.full(len(z), pose[2]),
            elsewhere=elsewhere,
        )
        return new._replace(landmark=pose[:2] + changed(values)[:, :, 0])

    return observing(predict=predict, invert=invert)


def _in_inverse(fault: Composition, changed: Changed) -> Plant:
    last: list[Array] = []
    name = "jacobian_pose" if fault.slot is G_X else "jacobian_z"

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        predicted: PredictedMeasurements = sound(pose, landmarks)
        last[:] = [np.array(pose)]
        return predicted

    def invert(sound: Any, pose: Array, z: Array) -> NewLandmarks:
        new: NewLandmarks = sound(pose, z)
        elsewhere = dict[str, Array]()
        if fault.reads == OLD_POSE:
            elsewhere[OLD_POSE] = getattr(sound(last[0] if last else pose, z), name)
        values = Values(sound=getattr(new, name), factors={RANGE: z[:, 0]}, elsewhere=elsewhere)
        return new._replace(**{name: changed(values)})

    return observing(predict=predict, invert=invert)
