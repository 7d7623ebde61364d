"""A log's streams in the order of time: which control acts how long, which measurements come when.

Both estimators are fed from here, so that they read the same log; what they make of it is theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.arrays import Array, Index
from comparisons.errors import RecordError
from comparisons.logs.log import Log, Positions
from comparisons.logs.odometry import RelativePoses, filling
from comparisons.logs.stamps import resolved


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """Epochs are the instants at which a pose is estimated; steps fill the time between them.

    epoch_time_s: (K,), the first is the prior's. step_epoch: (N,) the epoch at which the step's
    interval ends, not decreasing. step_begin_s: (N,) the time from which the step leads on.
    step_duration_s: (N,). control: (N, m) and control_covariance: (N, m, m). measurement_epoch:
    (M,) epoch of each of the log's measurements. position_epoch: (G,) epoch of each of the log's
    positions, when they are to be fused.
    """

    epoch_time_s: Array
    step_epoch: Index
    step_begin_s: Array
    step_duration_s: Array
    control: Array
    control_covariance: Array
    measurement_epoch: Index
    position_epoch: Index

    def steps_until(self) -> Index:
        """(K,) number of steps made when each epoch is reached."""
        return np.searchsorted(self.step_epoch, np.arange(len(self.epoch_time_s)), side="right")

    @property
    def step_end_s(self) -> Array:
        """(N,) the times at which the steps end."""
        return np.append(self.step_begin_s[1:], self.epoch_time_s[-1:])

    def instants_s(self) -> Array:
        """(J,) all times at which a step begins or an epoch lies."""
        return np.union1d(self.epoch_time_s, self.step_begin_s)

    def observed_s(self) -> Array:
        """The instants at which something is measured; all epochs where nothing is."""
        rows = np.union1d(self.measurement_epoch, self.position_epoch)
        return self.epoch_time_s[rows] if len(rows) else self.epoch_time_s

    def prefix(self, epochs: int) -> Timeline:
        """The same up to the first `epochs` epochs."""
        steps = int(self.steps_until()[epochs - 1])
        return Timeline(
            epoch_time_s=self.epoch_time_s[:epochs],
            step_epoch=self.step_epoch[:steps],
            step_begin_s=self.step_begin_s[:steps],
            step_duration_s=self.step_duration_s[:steps],
            control=self.control[:steps],
            control_covariance=self.control_covariance[:steps],
            measurement_epoch=self.measurement_epoch[: int(self.measurements_until()[epochs])],
            position_epoch=self.position_epoch[: int(self.positions_until()[epochs])],
        )

    def measurements_until(self) -> Index:
        """(K + 1,) first measurement of each epoch, and the end."""
        return np.searchsorted(self.measurement_epoch, np.arange(len(self.epoch_time_s) + 1))

    def positions_until(self) -> Index:
        """(K + 1,) first position of each epoch, and the end."""
        return np.searchsorted(self.position_epoch, np.arange(len(self.epoch_time_s) + 1))


def build_timeline(
    log: Log, positions: Positions | None = None, looks: Array | None = None
) -> Timeline:
    """Cut the log into epochs and steps; `positions` are those to be fused, if any.

    looks: (N,) further times that become epochs, such as those of scans; without wheel odometry
    they must be poses' times, too.

    Wheel odometry: an epoch at every instant with measurements or positions, at the end of the log,
    and in every half second in which the vehicle drove without either; a sample's control acts
    until the next sample, and is cut where an epoch falls in between; before the first sample the
    vehicle is taken to stand still. Relative poses: an epoch per record, and measurements and
    positions belong to the pose of their time. Raises InputError for those between poses.

    Times of wheel odometry, measurements and positions are resolved to a nanosecond, so that those
    which are the same but for a float's rounding are one.
    """
    fixes = positions.time_s if positions is not None else np.zeros(0)
    looks = np.zeros(0) if looks is None else looks
    if isinstance(log.odometry, RelativePoses):
        return _from_relative_poses(log, log.odometry, fixes, looks)
    odometry, start = log.odometry, resolved(np.array([log.prior.time_s]))
    seen, fixes, sampled = (
        resolved(times) for times in (log.measurements.time_s, fixes, odometry.time_s)
    )
    end = resolved(np.array([log.end_s]))
    epochs = np.unique(np.concatenate((start, seen, fixes, resolved(looks), end)))
    epochs = np.union1d(epochs, filling(epochs, sampled[(sampled > start) & (sampled < end)]))
    cuts = np.unique(np.concatenate((epochs, sampled)))
    begin = cuts[:-1]
    sample = np.searchsorted(sampled, begin, side="right") - 1
    control = np.where(sample[:, None] >= 0, np.column_stack(odometry.controls)[sample], 0.0)
    noise = odometry.noise
    covariance = np.diag((noise.sigma_speed_mps**2, noise.sigma_turn**2))
    return Timeline(
        epoch_time_s=epochs,
        step_epoch=np.searchsorted(epochs, begin, side="right"),
        step_begin_s=begin,
        step_duration_s=np.diff(cuts),
        control=control,
        control_covariance=np.broadcast_to(covariance, (len(control), 2, 2)),
        measurement_epoch=np.searchsorted(epochs, seen),
        position_epoch=np.searchsorted(epochs, fixes),
    )


def _from_relative_poses(log: Log, odometry: RelativePoses, fixes: Array, looks: Array) -> Timeline:
    epochs = np.concatenate(([log.prior.time_s], odometry.time_s))
    places = []
    streams = (("measurements", log.measurements.time_s), ("positions", fixes), ("scans", looks))
    for stream, times in streams:
        where = np.minimum(np.searchsorted(epochs, times), len(epochs) - 1)
        stray = np.flatnonzero(epochs[where] != times)
        if len(stray):
            raise RecordError(
                stream,
                int(stray[0]),
                f"time {times[stray[0]]} s is no pose's, expected one of the relative poses'",
            )
        places.append(where)
    measurements, positions, _ = places
    return Timeline(
        epoch_time_s=epochs,
        step_epoch=np.arange(1, len(epochs)),
        step_begin_s=epochs[:-1],
        step_duration_s=np.diff(epochs),
        control=odometry.displacement,
        control_covariance=odometry.covariance,
        measurement_epoch=measurements,
        position_epoch=positions,
    )
