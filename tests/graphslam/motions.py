"""Samples of the two motion models."""

import numpy as np

from graphslam.increments import (
    AckermannGeometry,
    Integration,
    MotionSamples,
    Stabilisation,
    ackermann_samples,
    unicycle_samples,
)
from tests.graphslam.numerics import Array

GEOMETRY = (2.83, 0.76, 3.78, 0.5)
STABILISATION = Stabilisation(1e-5, 1e-7)


def controls(n: int, seed: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 3, n), rng.uniform(-0.5, 0.5, n), rng.uniform(0.01, 0.1, n)


def samples(kind: str, u: Array, w: Array, dt: Array, *integration: Integration) -> MotionSamples:
    if kind == "ackermann":
        geometry = AckermannGeometry(*GEOMETRY)
        return ackermann_samples(u, w, dt, (0.2, 0.05), STABILISATION, geometry, *integration)
    return unicycle_samples(u, w, dt, (0.2, 0.05), STABILISATION, *integration)
