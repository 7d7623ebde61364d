"""What a Kalman filter does, event by event, on an error state of named blocks.

The error is truth minus estimate, in whatever coordinates the filter keeps its covariance. All
matrices are those that the filter used; `blocks` says which blocks their columns stand for, in
their order.

Where the trace is compared with a log, an event also has its point: the filter's own numbers of its
blocks, one after the other, about which it was linearised (for a prediction, those before it);
`after`, the numbers that it leads to; and the numbers in the log of what was measured. None where
not recorded.
"""

from __future__ import annotations

from typing import NamedTuple

from comparisons.arrays import Array

Blocks = tuple[str, ...]
ADDITIVE = "additive"
OWN_CHART = "own"
CHARTS = (
    *(ADDITIVE, "angle", "se2", "so3 left", "so3 right", "se23 left", "se23 right", OWN_CHART),
)
"""How a block's error stands to its numbers. additive: numbers and error are added. angle, se2: an
angle, or x, y and heading, added too, but the angle goes round. so3, se23: an attitude, or
attitude, velocity and position, with the error on the world's side (left) or the body's (right).
own: as the filter's own functions say."""


class TracePrior(NamedTuple):
    """The error state begins: e ~ N(0, covariance). dims: entries of each block's error.

    charts: one of CHARTS by block; none where all are additive.
    """

    number: int
    time_s: float | None
    blocks: Blocks
    dims: tuple[int, ...]
    covariance: Array
    point: Array | None = None
    charts: tuple[str, ...] = ()


class Predict(NamedTuple):
    """Of some blocks: e' = jacobian e + w, w ~ N(0, noise); other blocks stay."""

    number: int
    time_s: float | None
    blocks: Blocks
    jacobian: Array
    noise: Array
    point: Array | None = None
    after: Array | None = None


class Update(NamedTuple):
    """A measurement: residual = jacobian e + v, v ~ N(0, noise).

    used: false where the filter's gate rejected it. correction: (n,) what the filter added to the
    estimate of all blocks, None where it was not recorded; gain: (n, m) likewise. numbers: (k,)
    of what was measured, in the log, from 0. weight: below 1 for a part of a measurement, which has
    that share of its information and R / weight as its noise.
    """

    number: int
    time_s: float | None
    sensor: str
    blocks: Blocks
    residual: Array
    jacobian: Array
    noise: Array
    used: bool
    correction: Array | None
    gain: Array | None
    point: Array | None = None
    numbers: Array | None = None
    weight: float = 1.0


class Augment(NamedTuple):
    """A new block: e_new = jacobian e + noise_jacobian v, v ~ N(0, noise).

    after: its own numbers. numbers, weight: as of an update; a weight of 0 says that no measurement
    tells it, but a prior, as of a surveyed landmark.
    """

    number: int
    time_s: float | None
    name: str
    blocks: Blocks
    jacobian: Array
    noise_jacobian: Array
    noise: Array
    point: Array | None = None
    after: Array | None = None
    numbers: Array | None = None
    weight: float = 1.0
    chart: str = ADDITIVE


class Clone(NamedTuple):
    """A new block that is a copy of another, as of now."""

    number: int
    time_s: float | None
    name: str
    source: str


class Remove(NamedTuple):
    """Blocks that leave the state, marginalised out."""

    number: int
    time_s: float | None
    blocks: Blocks


class Reset(NamedTuple):
    """The error of some blocks is expressed anew: e' = jacobian e, without noise."""

    number: int
    time_s: float | None
    blocks: Blocks
    jacobian: Array


class Snapshot(NamedTuple):
    """What the filter holds after the event before it.

    covariance: joint, of the blocks. mean: the estimate, in the filter's own numbers. error: (n,)
    truth minus estimate of the blocks. None where not recorded.
    """

    number: int
    time_s: float | None
    blocks: Blocks
    covariance: Array
    mean: Array | None
    error: Array | None


class Directions(NamedTuple):
    """Directions of the error state that some sensors cannot tell, by where the filter is now.

    basis: (n, d), a column a direction, on the blocks. names: of the d directions. blind: sensors
    that cannot tell any of them.
    """

    number: int
    time_s: float | None
    blocks: Blocks
    basis: Array
    names: tuple[str, ...]
    blind: tuple[str, ...]


class Evaluation(NamedTuple):
    """What a function of the filter says at the point of the event before, of the same blocks.

    The function leads from the blocks' numbers to those after a prediction, to what is measured, or
    to the numbers of a new block. value: (k,) what it gives. jacobian: (m, n) derivative of the
    outcome's error by the blocks' errors, in their charts. uncertainty: (m, n) what that may be off
    by. measured: (k,) of an update what was measured, if recorded.
    """

    number: int
    time_s: float | None
    blocks: Blocks
    jacobian: Array
    value: Array
    uncertainty: Array
    measured: Array | None


Event = (
    TracePrior
    | Predict
    | Update
    | Augment
    | Clone
    | Remove
    | Reset
    | Snapshot
    | Directions
    | Evaluation
)


TELLING = (Snapshot, Directions, Evaluation)
"""Events that tell of the filter, and change nothing of it."""


class SensorDescription(NamedTuple):
    """gate: probability with which the filter's gate lets a sound measurement pass, if it has one.

    components: names of the residual's entries; empty where none were given.
    """

    gate: float | None
    components: tuple[str, ...]
