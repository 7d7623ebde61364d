"""The measurement update, split into a sequence of weaker ones (Guivant 2002, section 4.2).

One measurement of covariance R counts as L measurements of K_i R with sum 1 / K_i = 1. For a
linear measurement that is the same update; for a nonlinear one, as of an absolute position or at a
loop closure, every part is linearised where the last one led, not far from where it corrects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.core.state import LocalMap

_WEAKEST = 2.0**-40
_UNBOUNDED = (float("inf"), float("inf"), 1.0)


class Linearised(NamedTuple):
    """A measurement at the present state.

    local: the pose and landmarks it depends on. jacobian: (m, p + w l) with respect to them.
    innovation: (m,), wrapped.
    """

    local: LocalMap
    jacobian: Array
    innovation: Array

    def normalised_squared(self, noise: Array) -> float:
        """Return the normalised innovation squared, nu^T S^-1 nu.

        Args:
            noise: (m, m), R.

        Returns:
            The NIS, chi-square with m degrees of freedom for a consistent filter.

        Source: Nieto 2005, eq. 2.58.
        """
        s = self.jacobian @ self.local.covariance @ self.jacobian.T + noise
        return float(self.innovation @ np.linalg.solve(s, self.innovation))


@dataclass(frozen=True)
class UpdateSplitter:
    """What one update may do before it is split into `most` parts or fewer.

    largest_turn_rad, largest_move_m: of the vehicle. largest_shrink: share of its variance that the
    direction loses that learns most, in the space of the pose and what is measured; 1 for any.
    """

    largest_turn_rad: float = float("inf")
    largest_move_m: float = float("inf")
    largest_shrink: float = 1.0
    most: int = 64

    def split(
        self, linearise: Callable[[], Linearised], noise: Array
    ) -> Iterator[tuple[float, Linearised]]:
        """Yield the parts of an update: a share of the information, and the linearisation for it.

        The caller must fuse each part with noise / weight before it takes the next. A weight is
        halved until the predicted correction is within the bounds, so that a strong correction
        starts with very weak parts. The last part takes what is left.

        Args:
            linearise: Linearises the measurement at the state as it then is.
            noise: (m, m), R of the whole measurement.

        Yields:
            Weights 1 / K_i, of sum one, and the measurement linearised anew for each.

        Source: Guivant 2002, section 4.2.
        """
        left = 1.0
        for remaining in range(self.most, 0, -1):
            at, weight = linearise(), left
            while remaining > 1 and weight > _WEAKEST and not self._within(at, noise / weight):
                weight *= 0.5
            left -= weight
            yield weight, at
            if left == 0.0:
                return

    def _within(self, at: Linearised, noise: Array) -> bool:
        if (self.largest_turn_rad, self.largest_move_m, self.largest_shrink) == _UNBOUNDED:
            return True
        gain_left = at.local.covariance @ at.jacobian.T
        s = at.jacobian @ gain_left + noise
        step = gain_left[: len(at.local.pose)] @ np.linalg.solve(s, at.innovation)
        turn, move = np.linalg.norm(step[2:]), np.hypot(step[0], step[1])
        if turn > self.largest_turn_rad or move > self.largest_move_m:
            return False
        kept = np.linalg.eigvals(np.linalg.solve(s, noise)).real.min()  # of S^-1 R = I - S^-1 HPH^T
        return bool(1.0 - kept <= self.largest_shrink)
