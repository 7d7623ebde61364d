"""What a filter may have made of its measurements: values, Jacobians, noise, new landmarks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array, Index
from comparisons.explain.hypotheses import (
    EQUAL,
    Hypothesis,
    Quantity,
    instead,
    named,
    scaled,
)
from comparisons.explain.recorded import explained
from comparisons.faults.columns import LogColumn, read_measurements, values_of
from comparisons.faults.grammar import (
    EXPECTED,
    G_X,
    G_Z,
    INNOVATION,
    PLACE,
    H,
    R,
    Values,
    times,
)
from comparisons.faults.misreadings import LAGS, Misreading, joined_misreadings, misreadings
from comparisons.faults.streams import RANGE_POWERS, added_words
from comparisons.logs.log import Log
from comparisons.plane import turned
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.trace import MeasurementRecords
from ekf_reference.models.range_bearing import RangeBearing

_READ = read_measurements()
_COLUMNS = tuple(column.name for column in _READ[1:])
_TWO = np.eye(2)
_BEARING: NDArray[np.bool_] = np.array([False, True])


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """Uses of measurements, (M,) each.

    z, sigma: (M, 2) as the log has them. z_hat: (M, 2) what is to be expected, h: (M, 2, 5) its
    Jacobian by pose and landmark. slack: (M, 2) what storing explains, in range and bearing.
    values: (L, 2) all that the log has. others: by which, other measurements. poses, points: by
    where, other places to linearise at, (M, 3) and (M, 2).
    """

    r: MeasurementRecords
    z: Array
    sigma: Array
    z_hat: Array
    h: Array
    slack: Array
    values: Array
    others: Mapping[str, Array]
    poses: Mapping[str, Array]
    points: Mapping[str, Array]
    velocity: Array
    features: Mapping[str, Array | Index]


def measurement_hints(log: Log, run: EkfRun, rounding: float) -> Iterator[str]:
    """Yield what was done to measurements of point landmarks, those that begin them included."""
    reported: list[str] = []
    updates, starts = run.trace.measurements[POINT], run.trace.initialisations[POINT]
    if len(updates.step):
        measurements = _seen(log, run, updates, rounding)
        yield from _innovations(measurements)
        reported = list(_noise_hints("R", measurements, "measurements"))
        yield from reported
        yield from _jacobians(measurements)
    starts = starts.rows(np.flatnonzero((starts.number >= 0) & (starts.weight > 0.0)))
    if len(starts.step):
        new = _seen(log, run, starts, rounding)
        yield from _places(new)
        yield from _jacobians_of_new(new)
        alike = [text.partition(",")[0] for text in reported]
        for text in _noise_hints("R of new landmarks", new, "new landmarks"):
            if text.partition(",")[0].replace(" of new landmarks", "") not in alike:
                yield text


def _seen(log: Log, run: EkfRun, r: MeasurementRecords, rounding: float) -> _Seen:
    measurements, trace = log.measurements, run.trace
    every = values_of(log, "measurements")
    sigma = np.column_stack((measurements.sigma_range_m, measurements.sigma_bearing_rad))
    z = every[r.number]
    z_hat, h = _rays(r.pose, r.landmark)
    r = _completed(r, z - z_hat, h, sigma[r.number])
    last = np.maximum(r.step - 1, 0)
    scans, which = np.unique(r.step, return_inverse=True)
    before = r.pose[np.searchsorted(r.step, scans)][np.maximum(which - 1, 0)]
    updates, starts = trace.measurements[POINT], trace.initialisations[POINT]
    first = np.zeros((int(starts.landmark_index.max(initial=0)) + 1, 2))
    first[starts.landmark_index] = starts.landmark
    updated = dict(zip(updates.step[::-1].tolist(), updates.pose[::-1], strict=True))
    place = rounding * 4.0 * max(np.abs(r.pose[:, :2]).max(), np.abs(r.landmark).max())
    angle = rounding * 4.0 * max(np.pi, float(np.abs(r.pose[:, 2]).max()))
    velocity = trace.arrived[last] - trace.departed[last]
    return _Seen(
        r=r,
        z=z,
        sigma=sigma[r.number],
        z_hat=z_hat,
        h=h,
        slack=np.column_stack((np.full(len(z_hat), place), place / z_hat[:, 0] + angle)),
        values=every,
        others={
            "of the previous measurement": every[np.maximum(r.number - 1, 0)],
            "of the next measurement": every[np.minimum(r.number + 1, len(every) - 1)],
        },
        poses={
            "at the pose of the previous scan": before,
            "at the pose before the last prediction": trace.departed[last],
            "at the pose before the update": np.array(
                [updated.get(s, own) for s, own in zip(r.step.tolist(), r.pose, strict=True)]
            ),
        },
        points={
            "at the landmark's initial position": first[r.landmark_index],
            "at the landmark position that the measurement gives": _points(r.pose, z)[0],
        },
        velocity=velocity / run.timeline.step_duration_s[last, None],
        features={
            "time [s]": measurements.time_s[r.number],
            "range [m]": z[:, 0],
            "bearing [rad]": z[:, 1],
            "landmark": run.estimate.landmark_id[r.landmark_index].astype(np.int64),
        },
    )


def _completed(r: MeasurementRecords, nu: Array, h: Array, sigma: Array) -> MeasurementRecords:
    """Return records whose unused entries are as the log's model has them: they hint at nothing.

    nu, sigma: (N, 2) residuals and standard deviations; h: (N, 2, 5) Jacobians.
    """
    used = r.entries > 0.0
    if used.all():
        return r
    residual, noise = r.innovation.copy(), r.noise.copy()
    of_pose, of_landmark = r.jacobian_pose.copy(), r.jacobian_other.copy()
    rows, entries = np.nonzero(~used)
    wrapped = np.column_stack((nu[:, 0], wrap_angle(nu[:, 1])))
    residual[rows, entries] = wrapped[rows, entries]
    of_pose[rows, entries], of_landmark[rows, entries] = np.split(h[rows, entries], [3], axis=1)
    noise[rows, entries, entries] = sigma[rows, entries] ** 2 / r.weight[rows]
    return replace(
        r, innovation=residual, jacobian_pose=of_pose, jacobian_other=of_landmark, noise=noise
    )


def _rays(pose: Array, landmark: Array) -> tuple[Array, Array]:
    """Return measurements (N, 2) expected from poses (N, 3), and (H_v, H_l) (N, 2, 5)."""
    z, *jacobians = RangeBearing().predict(pose.T, landmark)
    return z, np.concatenate(jacobians, axis=2)


def _points(pose: Array, z: Array) -> tuple[Array, Array]:
    """Return points (N, 2) measured from poses (N, 3), and (G_x, G_z) (N, 2, 5)."""
    point, *jacobians = RangeBearing().invert(pose.T, z)
    return point, np.concatenate(jacobians, axis=2)


def _moved(pose: Array, forward: float, left: float) -> Array:
    """Return poses (N, 3) so far ahead and to the left."""
    arm = turned(np.array((forward, left)), pose[:, 2])
    return pose + np.column_stack((arm, np.zeros(len(pose))))


def _innovations(measurements: _Seen) -> Iterator[str]:
    r, nu = measurements.r, measurements.z - measurements.z_hat
    nu[:, 1] = wrap_angle(nu[:, 1])
    turns = (r.innovation[:, 1] - nu[:, 1]) / np.pi
    limit = EQUAL + measurements.slack[:, 1] / np.pi
    whole = np.round(turns)
    off = (whole != 0.0) & (np.abs(np.abs(nu[:, 1]) - np.pi) > limit)
    if off.any() and (np.abs(turns - whole) <= limit).all():
        how = (
            "not wrapped to (-pi, pi]"
            if (whole % 2 == 0).all()
            else "wrong by pi: the quadrant is lost"
        )
        yield f"{np.count_nonzero(off)} bearing innovations are {how}"
        if (whole % 2).any():
            return
    both = Quantity(
        have=r.innovation,
        meant=nu,
        tolerance=EQUAL * np.maximum(1.0, np.abs(nu)) + measurements.slack,
        records="measurements",
        angle=_BEARING,
        features=measurements.features,
    )
    # What was taken for the measurement, if the expected one is right; the bearing up to whole
    # turns.
    taken = replace(both, have=r.innovation + measurements.z_hat, meant=measurements.z)
    lines = named(both, _of_both(measurements, nu)) or list(_by_column(taken, measurements))
    yield from lines or _composed_innovation(both, measurements)


def _composed_innovation(both: Quantity, measurements: _Seen) -> list[str]:
    """The expected measurement or the innovation by the grammar; both (M, 2) are vectors."""
    factors = {"the range": measurements.z_hat[:, 0]}
    expected = Values(
        sound=measurements.z_hat[:, :, None],
        factors=factors,
        elsewhere={f"that {which}": z[:, :, None] for which, z in measurements.others.items()},
    )
    residual = Values(sound=both.meant[:, :, None], factors=factors)
    return explained(
        EXPECTED, both, expected, lambda values, rows: measurements.z[rows] - values[:, :, 0]
    ) or explained(INNOVATION, both, residual, lambda values, rows: values[:, :, 0])


def _of_both(measurements: _Seen, nu: Array) -> Iterator[Hypothesis]:
    """Mistakes that show in range and bearing together."""
    yield instead("the innovation has the opposite sign (expected minus measured)", -nu)
    r = measurements.r
    for where, expected in (
        *((where, _rays(pose, r.landmark)[0]) for where, pose in measurements.poses.items()),
        *((where, _rays(r.pose, point)[0]) for where, point in measurements.points.items()),
    ):
        yield instead(f"the expected measurement is computed {where}", measurements.z - expected)
    for misread in misreadings(_READ, LAGS):
        if misread.column is _READ[0]:
            yield _read(measurements, misread, lambda z, rows: z - measurements.z_hat[rows])

    def expected_from(pose: Array, rows: Index) -> Array:
        return measurements.z[rows] - _rays(pose, r.landmark[rows])[0]

    yield Hypothesis(
        "the expected measurement is computed {0:.4g} s after its time",
        lambda rows, s: expected_from(r.pose[rows] + s * measurements.velocity[rows], rows),
        (0.0,),
    )
    yield Hypothesis(
        "the sensor is assumed ({0:.4g}, {1:.4g}) m forward and left of the pose",
        lambda rows, forward, left: expected_from(_moved(r.pose[rows], forward, left), rows),
        (0.0, 0.0),
    )


def _read(
    measurements: _Seen, misread: Misreading, shown: Callable[[Array, Index], Array]
) -> Hypothesis:
    """The log is misread. shown: makes of measurements (R, 2) what is compared."""

    def predict(rows: Index, *numbers: float) -> Array:
        return shown(
            misread.values(measurements.values, *numbers)[measurements.r.number[rows]], rows
        )

    return Hypothesis(misread.said, predict, misread.start)


def _by_column(both: Quantity, measurements: _Seen, whose: str = "the") -> Iterator[str]:
    """Of range and bearing (M, 2) that were used, each by itself."""
    for entry, column in enumerate(_READ[1:]):
        part = both.part(entry)
        yield from named(
            part, _of_column(part, measurements, column._replace(the=f"{whose} {column.name}"))
        )


def _of_column(part: Quantity, measurements: _Seen, column: LogColumn) -> Iterator[Hypothesis]:
    z, entry, name = part.meant, column.entries[0], column.the
    expected = measurements.z_hat[:, entry]
    if column.is_angle:
        yield instead(
            "the heading is not subtracted in the expected bearing", z - measurements.r.pose[:, 2]
        )
    for misread in (*misreadings([column], LAGS), *joined_misreadings([column])):
        yield _read(measurements, misread, lambda z, rows: z[:, entry])
    yield Hypothesis(
        times(f"the expected {column.name}"),
        lambda rows, k: z[rows] - (k - 1.0) * expected[rows],
        (1.0,),
    )
    if column.name == "range":
        largest = float(part.have.max())
        yield instead(f"{name} is limited to {largest:.4g} m", np.minimum(z, largest))
    yield from _rounded(part, name, column.spelt_unit)


def _rounded(quantity: Quantity, name: str, unit: str) -> Iterator[Hypothesis]:
    """Multiples of a smallest unit, rounded or cut."""
    limit = 10.0 * float(np.median(np.broadcast_to(quantity.tolerance, quantity.have.shape)))
    used = quantity.have - 2.0 * np.pi * np.round(
        (quantity.have - quantity.meant) / (2.0 * np.pi)
    ) * bool(quantity.angle)
    levels = np.unique(np.round(used / limit)) * limit
    gaps = np.diff(levels)
    gaps = gaps[gaps > 3.0 * limit]
    if not len(gaps) or len(levels) > 0.7 * len(used):
        return
    step = float(gaps.min())
    for _ in range(3):  # a smallest unit, by all its multiples
        count = np.round(used / step)
        if not count.any():
            break
        step = float(count @ used / (count @ count))
    whole = np.round(used / step) * step
    near = np.abs(whole - quantity.meant) <= (0.5 + 1e-6) * step  # halves go either way
    nearest = np.where(near, whole, np.round(quantity.meant / step) * step)
    for how, levels in (
        ("rounded to", nearest),
        ("truncated to", np.floor(quantity.meant / step + 1e-9) * step),
        ("truncated to", np.trunc(quantity.meant / step * (1.0 + 1e-12)) * step),
    ):
        yield instead(f"{name} is {how} multiples of {step:.4g} {unit}", levels)


def _noise_hints(name: str, measurements: _Seen, records: str) -> Iterator[str]:
    """Yield what a measurement's R was made of, that of its whole information."""
    sigma = measurements.sigma
    size = sigma[:, :, None] * sigma[:, None, :]
    have = measurements.r.noise * measurements.r.weight[:, None, None] / size
    quantity = Quantity(
        have=have,
        meant=np.broadcast_to(_TWO, have.shape),
        tolerance=EQUAL,
        records=records,
        features=measurements.features,
    )
    degrees = np.degrees(1.0)

    def diagonal(text: str, variance: Array) -> Hypothesis:
        return instead(f"{name} {text}", variance[:, :, None] * _TWO / size)

    whole = (
        diagonal("contains sigma instead of sigma squared", sigma),
        diagonal("contains the square of the variances", sigma**4),
        scaled(name, quantity.meant),
        diagonal(
            "has a bearing sigma in degrees instead of radians", (sigma * (1.0, degrees)) ** 2
        ),
        diagonal(
            "has a bearing sigma converted to radians twice", (sigma * (1.0, 1.0 / degrees)) ** 2
        ),
        diagonal("has the variances of range and bearing exchanged", sigma[:, ::-1] ** 2),
    )
    if found := named(quantity, whole):
        yield from found
        return
    parts = [
        named(
            quantity.part(k, k),
            _variances(f"{name} of the {column}", sigma[:, k], measurements.z[:, 0]),
        )
        for k, column in enumerate(_COLUMNS)
    ]
    slot = replace(R, name=name)
    stated = Values(
        sound=sigma[:, :, None] ** 2 * _TWO, factors={"the range": measurements.z_hat[:, 0]}
    )
    composed = explained(
        slot, quantity, stated, lambda values, rows: values / size[rows]
    ) if not any(parts) else []  # fmt: skip
    yield from composed
    for lines in parts:
        yield from lines
    if composed:
        return
    correlated = Hypothesis(
        f"{name} has a correlation of {{0:.4g}} between range and bearing",
        lambda rows, c: np.full(len(rows), c),
        (0.0,),
    )
    yield from named(quantity.part(0, 1), [correlated])


def _variances(name: str, sigma: Array, range_m: Array) -> Iterator[Hypothesis]:
    """Of one column: its variance (M,) over sigma^2."""
    yield instead(f"{name} contains sigma instead of sigma squared", 1.0 / sigma)
    yield instead(f"{name} contains the square of the variance", sigma**2)
    yield scaled(name, np.ones(len(sigma)))
    yield Hypothesis(
        f"{name} is constant at {{0:.4g}}", lambda rows, c: c / sigma[rows] ** 2, (0.0,)
    )
    for power in RANGE_POWERS:
        shape = range_m**power / sigma**2
        yield Hypothesis(
            added_words(name, power), lambda rows, c, one=shape: 1.0 + c * one[rows], (0.0,)
        )
    for power, grows in ((2, "the range squared"), (1, "the range"), (-2, "1 / range squared")):
        shape = range_m**power / sigma**2
        yield Hypothesis(
            f"{name} is {{0:.4g}} times {grows}", lambda rows, c, one=shape: c * one[rows], (0.0,)
        )


def _jacobians(measurements: _Seen) -> Iterator[str]:
    want = measurements.h
    quantity = Quantity(
        have=np.concatenate((measurements.r.jacobian_pose, measurements.r.jacobian_other), axis=2),
        meant=want,
        tolerance=EQUAL * np.maximum(1e-6, np.abs(want).max(axis=(0, 2), keepdims=True))
        + 4.0 * measurements.slack[:, :, None] / measurements.z_hat[:, :1, None],
        records="measurements",
        features=measurements.features,
    )
    if found := named(quantity, [_beside_the_pose(measurements)]) or explained(
        H, quantity, _values_of(measurements, want)
    ):
        yield from found
        return
    rows_off = [name for k, name in enumerate(_COLUMNS) if quantity.part(k).off().any()]
    if len(rows_off) == 1:
        yield f"the {rows_off[0]} row of H is wrong, the other row is right"


def _values_of(measurements: _Seen, want: Array) -> Values:
    """H (M, 2, 5) as it should be, and at the other points that there are."""
    elsewhere = {
        **{
            where: _rays(pose, measurements.r.landmark)[1]
            for where, pose in measurements.poses.items()
        },
        **{
            where: _rays(measurements.r.pose, point)[1]
            for where, point in measurements.points.items()
        },
    }
    return Values(
        sound=want,
        factors={"the range": measurements.z_hat[:, 0]},
        elsewhere={
            **{f"linearised {where}": one for where, one in elsewhere.items()},
            "that of the previous measurement": np.roll(want, 1, axis=0),
        },
    )


def _beside_the_pose(measurements: _Seen) -> Hypothesis:
    """H of a sensor that is elsewhere on the vehicle."""
    r = measurements.r

    def from_place(rows: Index, forward: float, left: float) -> Array:
        pose = _moved(r.pose[rows], forward, left)
        h, arm = _rays(pose, r.landmark[rows])[1], pose - r.pose[rows]
        h[:, :, 2] += h[:, :, 1] * arm[:, :1] - h[:, :, 0] * arm[:, 1:2]
        return h

    return Hypothesis(
        "H is that of a sensor ({0:.4g}, {1:.4g}) m forward and left of the pose",
        from_place,
        (0.0, 0.0),
    )


def _places(new: _Seen) -> Iterator[str]:
    """Where landmarks began, as range and bearing from the recorded pose."""
    r, z = new.r, new.z
    quantity = Quantity(
        have=new.z_hat,
        meant=z,
        tolerance=EQUAL * np.maximum(1.0, np.abs(z)) + new.slack,
        records="new landmarks",
        angle=_BEARING,
        features=new.features,
    )
    others = (
        *(
            instead(f"new landmarks are initialised {where}", _rays(r.pose, _points(pose, z)[0])[0])
            for where, pose in reversed(list(new.poses.items()))
        ),
        Hypothesis(
            "new landmarks are initialised ({0:.4g}, {1:.4g}) m forward and left of their place",
            lambda rows, a, b: _rays(r.pose[rows], _points(_moved(r.pose[rows], a, b), z[rows])[0])[
                0
            ],
            (0.0, 0.0),
        ),
        instead(
            "new landmarks are initialised behind the vehicle: the quadrant is lost",
            z + (0.0, np.pi),
        ),
    )
    lines = named(quantity, others) or list(_by_column(quantity, new, "new landmarks'"))
    yield from lines or _composed_places(quantity, new)


def _composed_places(quantity: Quantity, new: _Seen) -> list[str]:
    """The way (N, 2) from the pose to a new landmark by the grammar."""
    pose = new.r.pose
    way = _points(pose, new.z)[0] - pose[:, :2]
    values = Values(sound=way[:, :, None], factors={"the range": new.z[:, 0]}, heading=pose[:, 2])
    return explained(
        PLACE, quantity, values,
        lambda values, rows: _rays(pose[rows], pose[rows, :2] + values[:, :, 0])[0],
    )  # fmt: skip


def _jacobians_of_new(new: _Seen) -> list[str]:
    have = np.concatenate((new.r.jacobian_pose, new.r.jacobian_other), axis=2)
    quantities = []
    for z in (new.z, new.z_hat):  # of what was seen, or of what was made of it
        want = _points(new.r.pose, z)[1]
        quantities.append(
            Quantity(
                have=have,
                meant=want,
                tolerance=EQUAL * np.maximum(1.0, np.abs(want).max(axis=(0, 1), keepdims=True))
                + 4.0 * (new.slack[:, :1] + new.slack[:, 1:] * z[:, :1])[:, :, None],
                records="new landmarks",
                features=new.features,
            )
        )
    quantity = min(quantities, key=lambda quantity: np.count_nonzero(quantity.off()))
    elsewhere = {
        f"linearised {where}": _points(pose, new.z)[1] for where, pose in new.poses.items()
    }
    lines = named(
        quantity, (instead(f"G_x and G_z are {at}", array) for at, array in elsewhere.items())
    )
    if lines:
        return lines
    for slot, columns in ((G_X, slice(0, 3)), (G_Z, slice(3, 5))):
        one = quantity.columns(columns)
        values = Values(
            sound=one.meant,
            factors={"the range": new.z_hat[:, 0]},
            elsewhere={words: array[:, :, columns] for words, array in elsewhere.items()},
        )
        lines += explained(slot, one, values)
    return lines
