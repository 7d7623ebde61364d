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
        """Correct a pose.

        Args:
            pose: (p,), to be corrected.
            step: (p,), as the gain gives it.

        Returns:
            (p,), the corrected pose.
        """
        return pose + step

    def minus(self, pose: Array, other: Array) -> Array:
        """Return the step that leads from another pose to this one.

        Args:
            pose: (p,), where the step ends.
            other: (p,), where it starts, near enough that the way is short.

        Returns:
            (p,) with plus(other, step) = pose.
        """
        return pose - other

    def reset(self, pose: Array, step: Array) -> Array | None:
        """Return how the error reads at the corrected pose.

        Args:
            pose: (p,) before the correction.
            step: (p,) of it.

        Returns:
            (p, p) derivative of minus(plus(pose, step + e), plus(pose, step)) by e, or None where
            it is one.
        """
        return None


ADDITIVE = Chart()
