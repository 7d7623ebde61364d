"""How likely a place is occupied, given one return of a sensor (Nieto 2005, section 4.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_reference.core.geometry import Array


@dataclass(frozen=True)
class InverseSensorModel:
    """Nieto 2005, eqs. 4.3, 4.4, in its one-dimensional and in its range and bearing form.

    p_occupied, p_free: p_max and p_min of the thesis. with_bearing: weigh how far a place is off
    the beam (eq. 4.2), else range alone. Errata: 4.2 is printed with sigmas in the place of their
    squares; its normaliser does not matter here, the model's peak is 1.
    """

    p_occupied: float = 0.9
    p_free: float = 0.3
    with_bearing: bool = False

    def __post_init__(self) -> None:
        """Check the probabilities."""
        if not 0.0 < self.p_free < 0.5 < self.p_occupied < 1.0:
            raise ValueError(
                f"p_free {self.p_free} and p_occupied {self.p_occupied} must lie on either side "
                "of one half, between 0 and 1"
            )

    def probability(
        self, ahead_m: Array, off_rad: Array, sigma_range_m: float | Array, sigma_bearing_rad: float
    ) -> Array:
        """P(occupied | return) (N,) of places that lie ahead of the return and off its beam.

        ahead_m: (N,) negative behind the return. off_rad: (N,). lambda = 1 - 2 lambda_r, with
        lambda_r the sensor's density over its peak; places behind the return that it does not
        reach are unknown, 0.5 (r > r_u, eq. 4.5).
        """
        exponent = np.square(ahead_m / sigma_range_m)
        if self.with_bearing:
            exponent = exponent + np.square(off_rad / sigma_bearing_rad)
        level = 1.0 - 2.0 * np.exp(-0.5 * exponent)
        occupied = (1.0 - self.p_occupied) + (self.p_occupied - 0.5) * (1.0 - level)
        free = np.where(ahead_m > 0.0, 0.5 + (self.p_free - 0.5) * level, 0.5)
        return np.where(level <= 0.0, occupied, free)


def log_odds(probability: Array | float) -> Array:
    """Log-odds, log p / (1 - p), of probabilities of any shape (Nieto 2005, eq. 4.7); of 1 inf."""
    p = np.asarray(probability, dtype=float)
    with np.errstate(divide="ignore"):
        odds: Array = np.log(p) - np.log1p(-p)
    return odds


def probability(odds: Array) -> Array:
    """The inverse of log_odds."""
    with np.errstate(over="ignore"):
        p: Array = 1.0 / (1.0 + np.exp(-odds))
    return p
