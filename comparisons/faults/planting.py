"""A fault of the grammar in a filter that runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.faults.fault import Family, Fault, Plant, moving, observing, remembering
from comparisons.faults.grammar import (
    EXPECTED,
    G_X,
    G_Z,
    INNOVATION,
    PLACE,
    B,
    Composition,
    F,
    H,
    R,
    Slot,
    Values,
    compositions,
)
from ekf_reference.core.landmark_types import NewLandmarks, PredictedMeasurements
from ekf_reference.models.motion import MotionStep

AFTER, BEFORE = "linearised at the pose after the step", "that of the previous step"
OLD_POSE = "linearised at the pose of the previous scan"
INTERVAL, RANGE = "the interval", "the range"
PLANTED = F, B, H, R, EXPECTED, INNOVATION, PLACE, G_X, G_Z
"""Slots whose faults a filter can be given; Q is made of others."""
Changed = Callable[[Values], Array]


def has(slot: Slot) -> Values:
    """Return values of one record with all that faults of a planted slot may read."""
    one = np.ones((1, *slot.shape))
    elsewhere = {F: (AFTER, BEFORE), H: (OLD_POSE,), G_X: (OLD_POSE,), G_Z: (OLD_POSE,)}
    turning = slot in (B, PLACE)
    return Values(
        sound=one,
        factors={} if slot is INNOVATION else {INTERVAL if slot in (F, B) else RANGE: one[:, 0, 0]},
        heading=one[:, 0, 0] if turning else None,
        elsewhere=dict.fromkeys(elsewhere.get(slot, ()), one),
    )


def composed_faults() -> tuple[list[Fault], list[Family]]:
    """Return the faults that a filter can be given, without a number and with one."""
    every = [fault for slot in PLANTED for fault in compositions(slot, has(slot))]
    bare = [Fault(fault.said(), planted(fault)) for fault in every if not fault.start]
    return bare, [_family(fault) for fault in every if fault.start]


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
        F: _in_step, B: _in_step, H: _in_prediction, EXPECTED: _in_prediction,
        G_X: _in_inverse, G_Z: _in_inverse, PLACE: _in_inverse,
    }  # fmt: skip
    if fault.slot is INNOVATION:
        return observing(
            innovation=lambda sound, z, z_hat: changed(
                Values(sound=sound(z, z_hat)[:, :, None])
            )[:, :, 0]
        )  # fmt: skip
    if fault.slot is R:
        return _in_noise(changed)
    return remembering(lambda: made[fault.slot](fault.slot, changed))


def _in_noise(changed: Changed) -> Plant:
    def measured(sound: Any, z: Array, sigma: Array) -> tuple[Array, Array]:
        z, noise = sound(z, sigma)
        return z, changed(Values(sound=noise, factors={RANGE: z[:, 0]}))

    return observing(measured=measured)


def _in_step(slot: Slot, changed: Changed) -> Plant:
    last: list[Array] = []

    def step(sound: Any, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = sound(pose, control, duration_s)
        factors, heading = {INTERVAL: np.array([duration_s])}, np.array([pose[2]])
        if slot is B:
            values = Values(sound=moved.jacobian_control[None], factors=factors, heading=heading)
            return moved._replace(jacobian_control=changed(values)[0])
        there = sound(np.append(pose[:2], moved.pose[2]), control, duration_s)
        own = moved.jacobian_pose[None]
        elsewhere = {AFTER: there.jacobian_pose[None], BEFORE: last[0] if last else own}
        last[:] = [own.copy()]
        values = Values(sound=own, factors=factors, elsewhere=elsewhere)
        return moved._replace(jacobian_pose=changed(values)[0])

    return moving(step)


def _in_prediction(slot: Slot, changed: Changed) -> Plant:
    last: list[Array] = []

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        own: PredictedMeasurements = sound(pose, landmarks)
        factors = {RANGE: own.z[:, 0]}
        if slot is EXPECTED:
            values = Values(sound=own.z[:, :, None], factors=factors)
            return own._replace(z=changed(values)[:, :, 0])
        old = sound(last[0] if last else pose, landmarks)
        last[:] = [np.array(pose)]
        joint, there = (
            np.concatenate((one.jacobian_pose, one.jacobian_landmark), axis=2) for one in (own, old)
        )
        values = Values(sound=joint, factors=factors, elsewhere={OLD_POSE: there})
        of_pose, of_landmark = np.split(changed(values), [3], axis=2)
        return own._replace(jacobian_pose=of_pose, jacobian_landmark=of_landmark)

    return observing(predict=predict)


def _in_inverse(slot: Slot, changed: Changed) -> Plant:
    last: list[Array] = []

    def predict(sound: Any, pose: Array, landmarks: Array) -> PredictedMeasurements:
        found: PredictedMeasurements = sound(pose, landmarks)
        last[:] = [np.array(pose)]
        return found

    def invert(sound: Any, pose: Array, z: Array) -> NewLandmarks:
        own: NewLandmarks = sound(pose, z)
        factors = {RANGE: z[:, 0]}
        if slot is PLACE:
            way = (own.landmark - pose[:2])[:, :, None]
            values = Values(sound=way, factors=factors, heading=np.full(len(z), pose[2]))
            return own._replace(landmark=pose[:2] + changed(values)[:, :, 0])
        old: NewLandmarks = sound(last[0] if last else pose, z)
        name = "jacobian_pose" if slot is G_X else "jacobian_z"
        elsewhere = {OLD_POSE: getattr(old, name)}
        values = Values(sound=getattr(own, name), factors=factors, elsewhere=elsewhere)
        return own._replace(**{name: changed(values)})

    return observing(predict=predict, invert=invert)
