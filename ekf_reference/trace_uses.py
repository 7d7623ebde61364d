"""What a filter tells its trace: one linearisation or change of the state at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


class Beginning(NamedTuple):
    """The prior. pose: (p,). covariance: (p, p)."""

    pose: Array
    covariance: Array


class Prediction(NamedTuple):
    """One step: x' = arrived + f (x - departed) + w, w ~ N(0, q).

    departed, arrived: (p,). f, q: (p, p).
    """

    departed: Array
    arrived: Array
    f: Array
    q: Array


class SightingUse(NamedTuple):
    """m sightings fused together, or m landmarks begun together, at one pose (p,).

    An update says innovation = H_v (x - pose) + H_l (l - landmark) + v, an augmentation
    l = landmark + G_x (x - pose) + G_z v, v ~ N(0, noise). jacobian_pose is H_v or G_x,
    jacobian_other H_l or G_z. The other shapes and `weight` are as in SightingRecords.
    """

    sighting: Index
    slot: Index
    pose: Array
    landmark: Array
    innovation: Array
    jacobian_pose: Array
    jacobian_other: Array
    noise: Array
    spread: Array
    whitened: Array
    weight: float = 1.0


class PositionUse(NamedTuple):
    """A position fix or a part of it: innovation = H (x - pose) + v, v ~ N(0, noise).

    Shapes are as in PositionRecords, of one.
    """

    number: int
    pose: Array
    innovation: Array
    jacobian_pose: Array
    noise: Array
    spread: Array
    weight: float


class FusionUse(NamedTuple):
    """Two landmarks with a direction that are one, or a part of that relation.

    innovation = H_1 (l_1 - first_place) + H_2 (l_2 - second_place) + v, v ~ N(0, noise), says
    where the second is in the frame of the first. Shapes are as in FusionRecords, of one.
    """

    number: int
    first: int
    second: int
    first_place: Array
    second_place: Array
    innovation: Array
    jacobian_first: Array
    jacobian_second: Array
    noise: Array
    weight: float


class Removal(NamedTuple):
    """Landmarks of a kind that were marginalised out.

    slot: (m,) and width: which, 2 for points and 3 for those with a direction. entries: (w m,) of
    the state as it was before.
    """

    slot: Index
    width: int
    entries: Index
