"""How a filter corrects its pose, and what that does to the error it keeps.

A filter's gain gives a step in the pose's entries, and its covariance is that of the error in them.
Where the entries are more than the pose is free to do, such as a cosine and a sine, a chart says
where the step leads and how the error reads there.
"""

from __future__ import annotations

from ekf_reference.core.geometry import Array


class Chart:
    """Contract of all charts, and the additive one: every entry is free."""

    def plus(self, pose: Array, step: Array) -> Array:
        """Return a pose (p,) corrected by a step (p,), as the gain gives it."""
        return pose + step

    def minus(self, pose: Array, other: Array) -> Array:
        """Return the step (p,) to a pose (p,) from another near it: plus(other, step) = pose."""
        return pose - other

    def reset(self, pose: Array, step: Array) -> Array | None:
        """Return how the error reads at a pose (p,) that a step (p,) has corrected.

        (p, p) derivative of minus(plus(pose, step + e), plus(pose, step)) by e, or None where it is
        one.
        """
        return None


ADDITIVE = Chart()
