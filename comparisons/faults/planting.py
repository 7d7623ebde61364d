"""A fault of the grammar in a filter that runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from comparisons.adapters.ekf_factory import motion_model
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.faults.fault import Family, Fault, Plant, moving, observing, remembering
from comparisons.faults.grammar import (
    B_OF_DISPLACEMENT,
    EXPECTED,
    G_X,
    G_Z,
    INNOVATION,
    PLACE,
    POSITION,
    B,
    Composition,
    F,
    H,
    Q,
    R,
    Slot,
    Values,
    compositions,
)
from comparisons.logs.log import Log
from ekf_reference.core.landmark_types import NewLandmarks, PredictedMeasurements
from ekf_reference.models.motion import MotionStep
from ekf_reference.models.range_bearing import RangeBearing

AFTER, BEFORE = "linearised at the pose after the step", "that of the previous step"
OLD_POSE = "linearised at the pose of the previous scan"
INTERVAL, RANGE = "the interval", "the range"
STEPS = F, B, B_OF_DISPLACEMENT
PLANTED = *STEPS, H, R, EXPECTED, INNOVATION, PLACE, G_X, G_Z
"""Slots whose faults a filter can be given; Q is made of others."""
_SAMPLES = 20
"""Steps and measurements by which faults without an effect, and equal ones, are told."""
Changed = Callable[[Values], Array]


def has(slot: Slot) -> Values:
    """Return values of one record with all that faults of a slot may read."""
    one = np.ones((1, *slot.shape))
    factor = {
        **dict.fromkeys((*STEPS, Q), INTERVAL),
        **dict.fromkeys((H, R, EXPECTED, PLACE, G_X, G_Z), RANGE),
    }
    elsewhere = {
        F: (AFTER, BEFORE),
        Q: (BEFORE,),
        H: (OLD_POSE,),
        G_X: (OLD_POSE,),
        G_Z: (OLD_POSE,),
    }
    turning = slot in (B, B_OF_DISPLACEMENT, Q, PLACE, POSITION)
    return Values(
        sound=one,
        factors={factor[slot]: one[:, 0, 0]} if slot in factor else {},
        heading=one[:, 0, 0] if turning else None,
        elsewhere=dict.fromkeys(elsewhere.get(slot, ()), one),
    )


def composed_faults(log: Log) -> tuple[list[Fault], list[Family]]:
    """Return the faults that a filter of a log can be given, without a number and with one.

    Of several that make the same values, one: that of the largest part. None without an effect.
    """
    bare, numbered = list[Fault](), list[Family]()
    for slot, values in sound_values(log).items():
        made = {values.sound.tobytes()}
        for fault in compositions(slot, values):
            with np.errstate(all="ignore"):
                changed = fault.values(values, *(number + 0.7 for number in fault.start))
            key = np.round(changed, 9).tobytes()
            if key in made or np.array_equal(changed, values.sound):
                continue
            made.add(key)
            if fault.start:
                numbered.append(_family(fault))
            else:
                bare.append(Fault(fault.said(), planted(fault)))
    return bare, numbered


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
    own, there = (np.array([one.jacobian_pose for one in each]) for each in (steps, after))
    by_control = np.array([one.jacobian_control for one in steps])
    factors = {INTERVAL: duration_s}
    elsewhere = {AFTER: there, BEFORE: np.roll(own, 1, axis=0)}
    return {
        F: Values(sound=own, factors=factors, elsewhere=elsewhere),
        (B if by_control.shape[2] == 2 else B_OF_DISPLACEMENT): Values(
            sound=by_control, factors=factors, heading=pose[:, 2]
        ),
    }


def _sound_measurements() -> dict[Slot, Values]:
    """Of points around two poses; R differs from measurement to measurement."""
    rng, model = np.random.default_rng(1), RangeBearing()
    pose, old = rng.uniform(0.3, 1.2, (2, 3))
    z = np.column_stack((rng.uniform(2.0, 20.0, _SAMPLES), rng.uniform(-1.0, 1.0, _SAMPLES)))
    new, new_of_old = model.invert(pose, z), model.invert(old, z)
    seen, seen_of_old = (model.predict(at, new.landmark) for at in (pose, old))
    noise = np.array((0.04, 0.01)) * np.eye(2) * rng.uniform(1.0, 2.0, (_SAMPLES, 1, 1))
    innovation = rng.standard_normal((_SAMPLES, 2, 1))
    way = (new.landmark - pose[:2])[:, :, None]
    factors = {RANGE: z[:, 0]}

    def of(sound: Array, old_one: Array | None = None) -> Values:
        elsewhere = {} if old_one is None else {OLD_POSE: old_one}
        return Values(sound=sound, factors=factors, elsewhere=elsewhere)

    return {
        H: of(_joint(seen), _joint(seen_of_old)),
        R: of(noise),
        EXPECTED: of(seen.z[:, :, None]),
        INNOVATION: Values(sound=innovation),
        PLACE: Values(sound=way, factors=factors, heading=np.full(_SAMPLES, pose[2])),
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

    if fault.slot is INNOVATION:
        return observing(
            innovation=lambda sound, z, z_hat: changed(
                Values(sound=sound(z, z_hat)[:, :, None])
            )[:, :, 0]
        )  # fmt: skip
    made = {
        **dict.fromkeys(STEPS, _in_control),
        F: _in_step,
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
        factors = {INTERVAL: np.array([duration_s])}
        values = Values(sound=jacobian, factors=factors, elsewhere=elsewhere)
        return moved._replace(jacobian_pose=changed(values)[0])

    return moving(step)


def _in_expected(fault: Composition, changed: Changed) -> Plant:
    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        predicted: PredictedMeasurements = sound(pose, landmarks)
        values = Values(sound=predicted.z[:, :, None], factors={RANGE: predicted.z[:, 0]})
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
    def invert(sound: Any, pose: Array, z: Array) -> NewLandmarks:
        new: NewLandmarks = sound(pose, z)
        way = (new.landmark - pose[:2])[:, :, None]
        heading = np.full(len(z), pose[2])
        values = Values(sound=way, factors={RANGE: z[:, 0]}, heading=heading)
        return new._replace(landmark=pose[:2] + changed(values)[:, :, 0])

    return observing(invert=invert)


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
