"""What every observation has in common: how it is fused, how landmarks begin, and what is noted."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ekf_reference.core.filter_state import FilterState
from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.measurement_update import Fused, Linearised, Steps
from ekf_reference.core.state import block_diagonal, diagonal_blocks, unstack
from ekf_reference.core.trace import SightingUse
from ekf_reference.models.range_bearing import NewLandmarks


def fuse(
    state: FilterState, steps: Steps, linearise: Callable[[], Linearised], noise: Array
) -> Iterator[Fused]:
    """Fuse an observation in as many parts as the steps ask for; yields each once it is.

    noise: (m, m), R.
    """
    for weight, at in steps.split(linearise, noise):
        done = state.update(at.local.columns, at.jacobian, at.innovation, noise / weight)
        yield Fused(weight, at, done)


def fuse_sightings(
    state: FilterState,
    steps: Steps,
    linearise: Callable[[], Linearised],
    noise: Array,
    sighting: Index,
    slot: Index,
) -> Iterator[SightingUse]:
    """Fuse sightings of one kind of landmarks together; yields how, part by part.

    noise: (m, w, w), R of each. sighting, slot: (m,) their numbers and landmarks.
    """
    width = noise.shape[-1]
    for weight, at, done in fuse(state, steps, linearise, block_diagonal(noise)):
        yield SightingUse(
            sighting,
            slot,
            at.local.pose,
            at.local.landmark,
            at.innovation.reshape(-1, width),
            *unstack(at.jacobian, width),
            noise / weight,
            diagonal_blocks(done.spread, width),
            done.whitened.reshape(-1, width),
            weight,
        )


def begin(
    state: FilterState,
    sighting: Index,
    slot: Index,
    new: NewLandmarks,
    noise: Array,
    weight: float = 1.0,
) -> SightingUse:
    """Append landmarks to the state; returns how. noise: (m, w, w), R of each sighting."""
    point = new.point
    pose, nothing = state.pose, np.zeros(point.shape)
    surprise = np.zeros((*point.shape, point.shape[1])), nothing
    state.augment(*new, noise)
    return SightingUse(
        sighting,
        slot,
        pose,
        point,
        nothing,
        new.jacobian_pose,
        new.jacobian_sighting,
        noise,
        *surprise,
        weight,
    )
