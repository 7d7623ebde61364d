"""Other sound filters: other orders, iterated, first-estimates, right-invariant, unscented.

They differ from the EKF by where they linearise, so by little where a log is nearly linear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from comparisons.arrays import Array, Index
from ekf_reference.core.blocks import block_diagonal, stack
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import NewLandmarks
from ekf_reference.core.linearisation import (
    FirstEstimates,
    Linearisation,
    RightInvariant,
    Robocentric,
)
from ekf_reference.core.measurement_update import Linearised
from ekf_reference.core.measurements import (
    NOT_MEASURED,
    Association,
    MeasuredAttributes,
    Measurements,
)
from ekf_reference.core.trace import Trace
from ekf_reference.models.motion import MotionModel

_CONVERGED_SIGMA = 1e-9


Order = Callable[[Array, NDArray[np.int64]], Index]
"""The rows (m,) of measurements in the order of use, by z (m, 2) and labels (m,)."""


class SequentialEkf(Ekf):
    """The EKF that updates by, or initialises from, one measurement after the other."""

    order: ClassVar[staticmethod[[Array, NDArray[np.int64]], Index]] = staticmethod(
        lambda z, label: np.arange(len(z))
    )

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
        for i in self.order(z, identity):
            row = np.array([i])
            measured_attributes = attributes.take(row)
            landmark_indices[row] = super().observe(
                z[row], sigma[row], identity[row], time_s, measured_attributes
            )
        return landmark_indices


def in_order(order: Order) -> type[SequentialEkf]:
    """Return the same that takes the measurements of an instant in another order."""
    return type("InOrderEkf", (SequentialEkf,), {"order": staticmethod(order)})


BackwardEkf = in_order(lambda z, label: np.arange(len(z))[::-1])
ByLabelEkf = in_order(lambda z, label: np.argsort(label, kind="stable"))
ByLabelBackwardEkf = in_order(lambda z, label: np.argsort(-label, kind="stable"))
NearestFirstEkf = in_order(lambda z, label: np.argsort(z[:, 0], kind="stable"))
FarthestFirstEkf = in_order(lambda z, label: np.argsort(-z[:, 0], kind="stable"))


class ScalarEkf(SequentialEkf):
    """The EKF that updates by the entries of a measurement, one after the other."""

    def _fuse(self, measurements: Measurements, landmark_indices: Index, rows: Index) -> None:
        model = self.models[measurements.kind]
        for row in rows.tolist():
            for entry in range(measurements.kind.width):
                local = self.state.map_of(landmark_indices[[row]], measurements.kind)
                expected, *parts = model.predict(local.pose, local.landmark)
                innovation = model.innovation(measurements.z[[row]], expected).ravel()
                noise = measurements.noise[row, entry, entry] * np.eye(1)
                jacobian = stack(*parts)[[entry]]
                self.state.update(local.columns, jacobian, innovation[[entry]], noise)


class NewFirstEkf(Ekf):
    """The EKF that initialises new landmarks at the predicted pose, before it updates.

    The landmarks move with the update, being correlated with the pose.
    """

    def use(self, measurements: Measurements, landmark_indices: Index) -> None:
        """Augment, then update. Arguments as of `Ekf.use`."""
        mapped = len(self.state.layout.first[measurements.kind])
        new = np.flatnonzero(landmark_indices >= mapped)
        first = np.sort(new[np.unique(landmark_indices[new], return_index=True)[1]])
        used = np.flatnonzero(landmark_indices >= 0)
        if len(first):
            used = self.placed(measurements, landmark_indices, first, used)
        for rows in self.parts(used):
            self._fuse(measurements, landmark_indices, rows)
        self.take_numbers(measurements.kind.name, len(landmark_indices))

    def placed(
        self, measurements: Measurements, landmark_indices: Index, new: Index, used: Index
    ) -> Index:
        """Augment by some of the rows in use; return those that are left for the update."""
        self._initialise(measurements, landmark_indices, new)
        return np.setdiff1d(used, new)

    def parts(self, rows: Index) -> Iterable[Index]:
        """Return the rows (m,) of an instant in parts, each of which is one update."""
        return (rows,)


class NewFirstSequentialEkf(NewFirstEkf):
    """The same, with sequential (one landmark at a time) updates."""

    def parts(self, rows: Index) -> Iterable[Index]:
        """Return each row alone."""
        return rows[:, None]


class UnknownFirstSequentialEkf(NewFirstSequentialEkf):
    """The same, with new landmarks of a vast covariance, which the first update reduces.

    The prior of Thrun 2005, table 10.1; where all are updated as one this is `NewFirstEkf`.
    """

    vast_variance: ClassVar[float] = 1e6
    """[m^2]"""

    def placed(
        self, measurements: Measurements, landmark_indices: Index, new: Index, used: Index
    ) -> Index:
        """Augment by landmarks that are correlated with nothing; all rows are left."""
        point = self.models[measurements.kind].invert(self.state.pose, measurements.z[new]).landmark
        landmarks = NewLandmarks.independent(point, len(self.state.pose))
        vast = np.tile(self.vast_variance * np.eye(measurements.kind.width), (len(new), 1, 1))
        number = self._count[measurements.kind.name] + new
        self._append(measurements.kind, number, landmark_indices[new], landmarks, vast, weight=0.0)
        return used


class IteratedEkf(Ekf):
    """The EKF that repeats an update at its own result until that stays (Bell and Cathey 1993)."""

    most_iterations: ClassVar[int] = 20

    def _fuse(self, measurements: Measurements, landmark_indices: Index, rows: Index) -> None:
        if not len(rows):
            return
        landmark_index, z, noise, model = (
            landmark_indices[rows],
            measurements.z[rows],
            measurements.noise[rows],
            self.models[measurements.kind],
        )
        r = block_diagonal(noise)

        def linearise() -> Linearised:
            local = self.state.map_of(landmark_index, measurements.kind)
            p, prior = local.covariance, np.concatenate((local.pose, local.landmark.ravel()))
            sigma, at, v = np.sqrt(np.diag(p)), prior, len(local.pose)
            for _ in range(self.most_iterations):
                expected, *parts = model.predict(
                    at[:v], at[v:].reshape(-1, measurements.kind.width)
                )
                jacobian = stack(*parts)
                innovation = model.innovation(z, expected).ravel() - jacobian @ (prior - at)
                s = jacobian @ p @ jacobian.T + r
                last, at = at, prior + p @ jacobian.T @ np.linalg.solve(s, innovation)
                if np.max(np.abs(at - last) / sigma) <= _CONVERGED_SIGMA:
                    break
            return Linearised(local, jacobian, innovation)

        self.fuse(linearise, noise, self._count[measurements.kind.name] + rows, landmark_index)


class LinearisedEkf(Ekf):
    """The EKF that takes its Jacobians elsewhere, or corrects another error."""

    kind: ClassVar[type[Linearisation]] = Linearisation

    def __init__(
        self,
        motion: MotionModel,
        association: Association,
        prior_pose: Array,
        prior_covariance: Array,
        trace: Trace | None = None,
    ) -> None:
        """Start at a prior. Arguments as of `Ekf`."""
        linearisation = self.kind()
        super().__init__(
            motion,
            association,
            prior_pose,
            prior_covariance,
            trace=trace,
            linearisation=linearisation,
        )


class FirstEstimatesEkf(LinearisedEkf):
    """The EKF whose Jacobians are those of the first estimates."""

    kind = FirstEstimates


class InvariantEkf(LinearisedEkf):
    """The EKF with right-invariant errors."""

    kind = RightInvariant


class RobocentricEkf(LinearisedEkf):
    """The EKF whose errors are those of origin and landmarks in the vehicle's frame."""

    kind = Robocentric


class SigmaPoints(NamedTuple):
    """Where the sigma points of n entries lie, and what the middle one weighs more in covariances.

    spread: they lie sqrt(spread (n + kappa)) sigma from the mean, alpha^2 in the literature. kappa:
    None for 3 - n. central: beta - alpha^2, by which the covariance has the mean's shift squared.
    symmetric: along the columns of the covariance's symmetric root, not Cholesky's.
    """

    spread: float = 1e-6
    kappa: float | None = 0.0
    central: float = 2.0 - 1e-6
    symmetric: bool = False

    def squared(self, n: int) -> float:
        """Return the squared distance from the mean, in sigma."""
        return self.spread * (3.0 if self.kappa is None else n + self.kappa)

    def root(self, covariance: Array) -> Array:
        """Return (n, n) whose columns are the points' offsets, one way."""
        squared = self.squared(len(covariance))
        if not self.symmetric:
            return np.asarray(np.sqrt(squared) * np.linalg.cholesky(covariance))
        values, axes = np.linalg.eigh(covariance)
        return np.asarray(np.sqrt(squared) * (axes * np.sqrt(values)) @ axes.T)


class UnscentedEkf(Ekf):
    """The unscented Kalman filter: statistical linearisation by sigma points.

    Each of predict, update and augment is replaced by mean, A and Omega of y = A (x - mean) + e,
    e ~ N(0, Omega), which is the unscented transform of the entries that are involved
    (van der Merwe 2004, eqs. 3.168 to 3.187; the others follow by their correlation).
    """

    points: ClassVar[SigmaPoints] = SigmaPoints()
    controls: ClassVar[bool] = False
    """The control has sigma points, too; if not, its covariance is added by the Jacobian."""
    starts: ClassVar[bool] = True
    """New landmarks are placed by sigma points; if not, by Jacobians."""

    def predict(self, control: Array, covariance: Array, duration_s: float) -> None:
        """Move under a control (m,) with covariance (m, m) for a time."""
        pose, p, v = self.state.pose, self.state.pose_covariance, len(self.state.pose)

        def moved(points: Array) -> Array:
            both = ((x[:v], x[v:] if self.controls else control) for x in points)
            return np.array([self.motion.step(x, u, duration_s).pose for x, u in both])

        x = np.concatenate((pose, control)) if self.controls else pose
        spread = block_diag(p, covariance) if self.controls else p
        y = unscented(x, spread, moved, points=self.points)
        b = self.motion.step(pose, control, duration_s).jacobian_control
        b = y.slope[:, v:] if self.controls else b
        noise = b @ covariance @ b.T + y.rest + self.stabilisation.covariance(duration_s, y.mean)
        self.state.predict(y.mean, y.slope[:, :v], noise)

    def _fuse(self, measurements: Measurements, landmark_indices: Index, rows: Index) -> None:
        if len(np.unique(landmark_indices[rows])) < len(
            rows
        ):  # two of one landmark have one set of entries
            for row in rows:
                self._fuse(measurements, landmark_indices, np.array([row]))
            return
        if not len(rows):
            return
        landmark_index, z, model = (
            landmark_indices[rows],
            measurements.z[rows],
            self.models[measurements.kind],
        )
        local = self.state.map_of(landmark_index, measurements.kind)
        v = len(local.pose)

        def measured(points: Array) -> Array:
            seen_at = (
                model.predict(x[:v], x[v:].reshape(-1, measurements.kind.width)).z for x in points
            )
            return np.array([one.ravel() for one in seen_at])

        def apart(y: Array, middle: Array) -> Array:
            pairs = (
                y.reshape(-1, measurements.kind.width),
                middle.reshape(-1, measurements.kind.width),
            )
            return model.innovation(pairs[0], np.tile(pairs[1], (len(y), 1))).reshape(y.shape)

        prior = np.concatenate((local.pose, local.landmark.ravel()))
        y = unscented(prior, local.covariance, measured, apart, points=self.points)
        innovation = model.innovation(z, y.mean.reshape(z.shape)).ravel()
        noise = block_diagonal(measurements.noise[rows]) + y.rest
        self.state.update(local.columns, y.slope, innovation, noise)

    def _initialise(self, measurements: Measurements, landmark_indices: Index, rows: Index) -> None:
        if not self.starts:
            super()._initialise(measurements, landmark_indices, rows)
            return
        pose, model, p = self.state.pose, self.models[measurements.kind], self.state.pose_covariance
        found = []
        for row in rows:

            def placed(points: Array) -> Array:
                return np.array(
                    [model.invert(x[: len(p)], x[None, len(p) :]).landmark[0] for x in points]
                )

            both = block_diag(p, measurements.noise[row])
            x = np.concatenate((pose, measurements.z[row]))
            found.append(unscented(x, both, placed, points=self.points))
        slope = np.array([y.slope for y in found])
        by_z, rest = slope[:, :, len(p) :], np.array([y.rest for y in found])
        noise = by_z @ measurements.noise[rows] @ by_z.transpose(0, 2, 1) + rest
        own = np.broadcast_to(np.eye(measurements.kind.width), rest.shape)
        new = NewLandmarks(np.array([y.mean for y in found]), slope[:, :, : len(p)], own)
        number = self._count[measurements.kind.name] + rows
        self._append(measurements.kind, number, landmark_indices[rows], new, noise)


class WideUnscentedEkf(UnscentedEkf):
    """Its sigma points are sqrt(n) sigma apart from the mean."""

    points: ClassVar[SigmaPoints] = SigmaPoints(1.0, 0.0, 1.0)


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
    points: SigmaPoints,
) -> Transformed:
    """Return the unscented transform of x ~ N(mean (n,), covariance (n, n)).

    Args:
        mean: (n,).
        covariance: (n, n), positive definite.
        function: takes points (k, n) to values (k, m).
        subtract: of values (k, m) and the middle one (m,), angles wrapped.
        points: where they lie.

    Source: van der Merwe 2004, eqs. 3.11 to 3.21, written with the odd and the even part of f about
    the mean, which keeps the digits that a small alpha costs.
    """
    n, squared = len(mean), points.squared(len(mean))
    root = points.root(covariance)
    y = function(np.vstack((mean, mean + root.T, mean - root.T)))
    off = subtract(y[1:], y[0])
    odd, even = 0.5 * (off[:n] - off[n:]), 0.5 * (off[:n] + off[n:])
    shift: Array = even.sum(axis=0) / squared
    rest = even.T @ even / squared + points.central * np.outer(shift, shift)
    cross = np.asarray(np.linalg.solve(root.T, odd).T, dtype=np.float64)
    return Transformed(y[0] + shift, cross, rest)
