"""Other sound filters for the same equations: sequential, iterated and unscented.

They differ from the EKF by where they linearise, so by little where a log is nearly linear.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array, Index
from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import NewLandmarks
from ekf_reference.core.measurement_update import Linearised
from ekf_reference.core.measurements import NOT_MEASURED, MeasuredAttributes, Measurements

_CONVERGED_SIGMA = 1e-9
_BETA = 2.0
"""What the middle sigma point weighs more in covariances, for Gaussians."""


class SequentialEkf(Ekf):
    """The EKF that updates by, or initialises from, one measurement after the other."""

    order: ClassVar[int] = 1
    """-1 takes those of an instant from the last to the first."""

    def observe(
        self,
        z: Array,
        sigma: Array,
        identity: NDArray[np.int64],
        time_s: float = 0.0,
        attributes: MeasuredAttributes = NOT_MEASURED,
    ) -> Index:
        """Do a cycle for each measurement. Arguments and result as of `Ekf.observe`."""
        landmark_indices = np.empty(len(z), dtype=np.intp)
        for i in range(len(z))[:: self.order]:
            row = np.array([i])
            own = attributes.take(row)
            landmark_indices[row] = super().observe(z[row], sigma[row], identity[row], time_s, own)
        return landmark_indices


class BackwardEkf(SequentialEkf):
    """The same from the last measurement of an instant to the first."""

    order = -1


class IteratedEkf(Ekf):
    """The EKF that repeats an update at its own result until that stays (Bell and Cathey 1993)."""

    most_iterations: ClassVar[int] = 20

    def _fuse(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        if not len(rows):
            return
        landmark_index, z, noise, model = (
            landmark_indices[rows],
            seen.z[rows],
            seen.noise[rows],
            self.models[seen.width],
        )
        r = block_diagonal(noise)

        def linearise() -> Linearised:
            local = self.state.map_of(landmark_index, seen.width)
            p, prior = local.covariance, np.concatenate((local.pose, local.landmark.ravel()))
            sigma, at, v = np.sqrt(np.diag(p)), prior, len(local.pose)
            for _ in range(self.most_iterations):
                expected, *parts = model.predict(at[:v], at[v:].reshape(-1, seen.width))
                jacobian = stack(*parts)
                innovation = model.innovation(z, expected).ravel() - jacobian @ (prior - at)
                s = jacobian @ p @ jacobian.T + r
                last, at = at, prior + p @ jacobian.T @ np.linalg.solve(s, innovation)
                if np.max(np.abs(at - last) / sigma) <= _CONVERGED_SIGMA:
                    break
            return Linearised(local, jacobian, innovation)

        self.fuse(linearise, noise, self._count[seen.width] + rows, landmark_index)


class UnscentedEkf(Ekf):
    """The unscented Kalman filter: statistical linearisation by sigma points.

    Each of predict, update and augment is replaced by mean, A and Omega of y = A (x - mean) + e,
    e ~ N(0, Omega), which is the unscented transform of the entries that are involved
    (van der Merwe 2004, eqs. 3.168 to 3.187; the others follow by their correlation).
    """

    alpha: ClassVar[float] = 1e-3
    """Spread of the sigma points, in units of sqrt(n) sigma."""

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move under a control (m,) with covariance (m, m), added by its Jacobian, for a time."""
        pose, p = self.state.pose, self.state.pose_covariance

        def moved(points: Array) -> Array:
            return np.array([self.motion.step(x, control, duration_s).pose for x in points])

        y = unscented(pose, p, moved, alpha=self.alpha)
        b = self.motion.step(pose, control, duration_s).jacobian_control
        noise = b @ covariance @ b.T + y.rest + self.stabilisation.covariance(duration_s, y.mean)
        self.state.predict(y.mean, y.slope, noise)

    def _fuse(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        if len(np.unique(landmark_indices[rows])) < len(
            rows
        ):  # two of one landmark have one set of entries
            for row in rows:
                self._fuse(seen, landmark_indices, np.array([row]))
            return
        if not len(rows):
            return
        landmark_index, z, model = landmark_indices[rows], seen.z[rows], self.models[seen.width]
        local = self.state.map_of(landmark_index, seen.width)
        v = len(local.pose)

        def measured(points: Array) -> Array:
            seen_at = (model.predict(x[:v], x[v:].reshape(-1, seen.width)).z for x in points)
            return np.array([one.ravel() for one in seen_at])

        def apart(y: Array, middle: Array) -> Array:
            pairs = y.reshape(-1, seen.width), middle.reshape(-1, seen.width)
            return model.innovation(pairs[0], np.tile(pairs[1], (len(y), 1))).reshape(y.shape)

        prior = np.concatenate((local.pose, local.landmark.ravel()))
        y = unscented(prior, local.covariance, measured, apart, alpha=self.alpha)
        innovation = model.innovation(z, y.mean.reshape(z.shape)).ravel()
        noise = block_diagonal(seen.noise[rows]) + y.rest
        self.state.update(local.columns, y.slope, innovation, noise)

    def _initialise(self, seen: Measurements, landmark_indices: Index, rows: Index) -> None:
        pose, model, p = self.state.pose, self.models[seen.width], self.state.pose_covariance
        found = []
        for row in rows:

            def placed(points: Array) -> Array:
                return np.array(
                    [model.invert(x[: len(p)], x[None, len(p) :]).landmark[0] for x in points]
                )

            both = block_diagonal_of(p, seen.noise[row])
            x = np.concatenate((pose, seen.z[row]))
            found.append(unscented(x, both, placed, alpha=self.alpha))
        slope = np.array([y.slope for y in found])
        by_z, rest = slope[:, :, len(p) :], np.array([y.rest for y in found])
        noise = by_z @ seen.noise[rows] @ by_z.transpose(0, 2, 1) + rest
        own = np.broadcast_to(np.eye(seen.width), rest.shape)
        new = NewLandmarks(np.array([y.mean for y in found]), slope[:, :, : len(p)], own)
        self._append(self._count[seen.width] + rows, landmark_indices[rows], new, noise, 1.0)


class Transformed(NamedTuple):
    """y = f(x): mean (m,), slope (m, n) by x, and covariance (m, m) that the slope leaves over."""

    mean: Array
    slope: Array
    rest: Array


def unscented(
    mean: Array,
    covariance: Array,
    function: Callable[[Array], Array],
    subtract: Callable[[Array, Array], Array] = np.subtract,
    *,
    alpha: float,
) -> Transformed:
    """Return the unscented transform of x ~ N(mean (n,), covariance (n, n)).

    Args:
        mean: (n,).
        covariance: (n, n), positive definite.
        function: takes points (k, n) to values (k, m).
        subtract: of values (k, m) and the middle one (m,), angles wrapped.
        alpha: spread of the points.

    Source: van der Merwe 2004, eqs. 3.11 to 3.21 with kappa 0, written with the odd and the even
    part of f about the mean, which keeps the digits that a small alpha costs.
    """
    n = len(mean)
    root = alpha * np.sqrt(n) * np.linalg.cholesky(covariance)
    y = function(np.vstack((mean, mean + root.T, mean - root.T)))
    off = subtract(y[1:], y[0])
    odd, even = 0.5 * (off[:n] - off[n:]), 0.5 * (off[:n] + off[n:])
    weight = 1.0 / (alpha**2 * n)
    shift = weight * even.sum(axis=0)
    rest = weight * even.T @ even + (_BETA - alpha**2) * np.outer(shift, shift)
    return Transformed(y[0] + shift, np.linalg.solve(root.T, odd).T, rest)


def block_diagonal_of(first: Array, second: Array) -> Array:
    """Return a covariance of both, independent of each other."""
    n = len(first)
    both = np.zeros((n + len(second), n + len(second)))
    both[:n, :n], both[n:, n:] = first, second
    return both
