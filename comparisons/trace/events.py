"""What a Kalman filter does, event by event, on an error state of named blocks.

The error is truth minus estimate, in whatever coordinates the filter keeps its covariance. All
matrices are those that the filter used; `blocks` says which blocks their columns stand for, in
their order.
"""

from __future__ import annotations

from typing import NamedTuple

from comparisons.arrays import Array

Blocks = tuple[str, ...]


class Prior(NamedTuple):
    """The error state begins: e ~ N(0, covariance). dims: entries of each block."""

    number: int
    time_s: float | None
    blocks: Blocks
    dims: tuple[int, ...]
    covariance: Array


class Predict(NamedTuple):
    """Of some blocks: e' = jacobian e + w, w ~ N(0, noise); other blocks stay."""

    number: int
    time_s: float | None
    blocks: Blocks
    jacobian: Array
    noise: Array


class Update(NamedTuple):
    """A measurement: residual = jacobian e + v, v ~ N(0, noise).

    used: false where the filter's gate rejected it. correction: (n,) what the filter added to the
    estimate of all blocks, None where it was not recorded; gain: (n, m) likewise.
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


class Augment(NamedTuple):
    """A new block: e_new = jacobian e + noise_jacobian v, v ~ N(0, noise)."""

    number: int
    time_s: float | None
    name: str
    blocks: Blocks
    jacobian: Array
    noise_jacobian: Array
    noise: Array


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


Event = Prior | Predict | Update | Augment | Clone | Remove | Reset | Snapshot | Directions


class Sensor(NamedTuple):
    """gate: probability with which the filter's gate lets a sound measurement pass, if it has one.

    components: names of the residual's entries; empty where none were given.
    """

    gate: float | None
    components: tuple[str, ...]
