"""Faults of models in a foreign filter, and what a right hint must say. Angles in radians."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks import foreign_filter as own
from benchmarks.foreign_filter import Foreign
from comparisons.arrays import Array
from comparisons.logs.odometry import SteeringOdometry

Plant = Callable[[Foreign], Foreign]


class Fault(NamedTuple):
    """A fault, and how to know that a hint is right.

    right: what one part of the hint must match. also: what other parts may say, being
    consequences. log: "any", or the kind that shows it.
    """

    name: str
    right: str
    plant: Plant
    also: str = "^$"
    log: str = "any"

    def judge(self, parts: list[str]) -> str:
        """Whether a hint's parts are right, wrong, or say nothing."""
        if not parts:
            return "general"
        if any(not re.search(f"{self.right}|{self.also}", part) for part in parts):
            return "wrong"
        return "right" if any(re.search(self.right, part) for part in parts) else "general"


def seen(change: Callable[[Foreign, int, Array], Array]) -> Plant:
    """What is taken for a measurement, initialised landmarks included."""
    return lambda f: replace(f, measured=lambda f, i: f.cast(change(f, i, own.measured(f, i))))


def noisy(change: Callable[[Foreign, int, Array], Array]) -> Plant:
    """R of updates and of new landmarks."""
    return lambda f: replace(f, noise=lambda f, i: f.cast(change(f, i, own.noise(f, i))))


def new_noise(change: Callable[[Array], Array]) -> Plant:
    """R of new landmarks alone."""
    return lambda f: replace(f, noise_new=lambda f, i: f.cast(change(own.noise(f, i))))


def driven(change: Callable[[Foreign, int, Array], Array]) -> Plant:
    """The control."""
    return lambda f: replace(f, control=lambda f, k: f.cast(change(f, k, own.control(f, k))))


def rows(change: Callable[[Array, Array, Array], Array]) -> Plant:
    """H (2, 5) from itself, pose and point."""
    return lambda f: replace(
        f, by_state=lambda f, pose, at: f.cast(change(own.by_state(f, pose, at), pose, at))
    )


def initialised(change: Callable[[Array, Array], Array]) -> Plant:
    """G_x and G_z (2, 5) from themselves and z."""
    return lambda f: replace(f, by_new=lambda f, pose, z: f.cast(change(own.by_new(f, pose, z), z)))


def spread(change: Callable[[Array, Array, Array, float], Array]) -> Plant:
    """Q (3, 3) from control's part, departing pose, arriving pose and interval, without rates."""

    def plant(f: Foreign) -> Foreign:
        def q(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
            full = own.step_noise(f, pose, arrived, u, dt) - dt * own.stabilisation(f)
            return f.cast(change(full, pose, arrived, dt) + dt * own.stabilisation(f))

        return replace(f, step_noise=q)

    return plant


def control_sigma(change: Callable[[Array], Array]) -> Plant:
    """The control's covariance (2, 2)."""

    def plant(f: Foreign) -> Foreign:
        def q(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
            b = own.by_control(f, pose, arrived, u, dt)
            s = change(own.control_noise(f))
            return f.cast(b @ s @ b.T + dt * own.stabilisation(f))

        return replace(f, step_noise=q)

    return plant


def turned(by: float) -> Array:
    """(3, 3) a rotation of the plane."""
    c, s = np.cos(by), np.sin(by)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def lagged(f: Foreign, k: int, lag: int) -> Array:
    """The control so many log samples before step k's own."""
    log = f.log.odometry
    begin = f.timeline.step_begin_s[k]
    at = int(np.searchsorted(np.round(log.time_s, 4), begin + 1e-5, side="right")) - 1 - lag
    if at < 0:
        return np.zeros(2)
    if not isinstance(log, SteeringOdometry):
        raise TypeError("no car")
    at = min(at, len(log.time_s) - 1)
    return np.array([log.speed_mps[at], log.steering_rad[at]])


def sensor_at(forward: float, left: float) -> Plant:
    """Measurements are expected from a place beside the pose, H with them."""

    def moved(pose: Array) -> Array:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        there: Array = pose + np.array([c * forward - s * left, s * forward + c * left, 0.0])
        return there

    def by_state(f: Foreign, pose: Array, at: Array) -> Array:
        h = own.by_state(f, moved(pose), at)
        arm = moved(pose) - pose
        h[:, 2] += h[:, 0] * -arm[1] + h[:, 1] * arm[0]
        return h

    return lambda f: replace(
        f, expected=lambda f, pose, at: own.expected(f, moved(pose), at), by_state=by_state
    )


def at_first(f: Foreign, pose: Array, point: Array) -> Array:
    """Return H where the landmark began."""
    return own.by_state(f, pose, f.first[f.now[1]])


def shifted(f: Foreign, i: int, z: Array) -> Array:
    """The bearing of the measurement before."""
    return np.array([z[0], f.log.measurements.bearing_rad[max(i - 1, 0)]])


def time_of(f: Foreign, i: int) -> float:
    """Of a measurement, since the start [s]."""
    return float(f.log.measurements.time_s[i] - f.log.prior.time_s)


def middle(part: float, shrunk: bool = False) -> Plant:
    """Steps along another heading; along the arc when shrunk."""

    def motion(f: Foreign, pose: Array, u: Array, dt: float) -> Array:
        far = own.motion(f, pose, u, dt)
        turn = far[2] - pose[2]
        step = (turned(part * turn) @ (far - pose)) * (
            np.array([*[np.sinc(0.5 * turn / np.pi)] * 2, 1.0]) if shrunk else 1.0
        )
        return f.cast(pose + step)

    return lambda f: replace(f, motion=motion)


def f_turned(part: float) -> Plant:
    """F's position terms as from another heading."""

    def by_pose(f: Foreign, pose: Array, arrived: Array, u: Array, dt: float) -> Array:
        full = own.by_pose(f, pose, arrived, u, dt)
        full[:2, 2] = turned(part * (arrived[2] - pose[2]))[:2, :2] @ full[:2, 2]
        return full

    return lambda f: replace(f, by_pose=by_pose)


def car(**parts: float) -> Plant:
    """Other measures of the vehicle, in its motion alone."""

    def plant(f: Foreign) -> Foreign:
        odometry = f.log.odometry
        if not isinstance(odometry, SteeringOdometry):
            raise TypeError("no car")
        other = replace(odometry, vehicle=replace(odometry.vehicle, **parts))

        def velocity(f: Foreign, u: Array) -> tuple[complex, float]:
            return own.velocity(replace(f, log=replace(f.log, odometry=other)), u)

        return replace(f, velocity=velocity)

    return plant


def faster(rate: float) -> Plant:
    """Every turn by this factor, the way as it was."""

    def motion(f: Foreign, pose: Array, u: Array, dt: float) -> Array:
        far = own.motion(f, pose, u, dt)
        return f.cast([far[0], far[1], pose[2] + rate * (far[2] - pose[2])])

    return lambda f: replace(f, motion=motion)


def scaled(*by: float) -> Callable[[object, object, Array], Array]:
    """Z or u, by a factor each."""
    return lambda f, i, z: z * by


def added(*by: float) -> Callable[[object, object, Array], Array]:
    """Z or u, and a constant each."""
    return lambda f, i, z: z + by


def blocks(range_m: float, bearing: float) -> Callable[[object, object, Array], Array]:
    """R with its variances by a factor each."""
    return lambda f, i, r: r * np.diag([range_m, bearing])


Q_ALSO = r"^Q |^the control part of Q is|noise of the"  # Q follows the control that was used
FAULTS = (
    # What is measured, and what is expected.
    Fault("range scale", r"range is 1\.03 times", seen(scaled(1.03, 1.0)), "landmarks"),
    Fault("range bias", r"range.*(\+0\.2|0\.2 m)", seen(added(0.2, 0.0)), "landmarks"),
    Fault("bearing bias", r"bearing.*0\.02", seen(added(0.0, 0.02)), "landmarks"),
    Fault("bearing scale", r"bearing is 0\.97 times", seen(scaled(1.0, 0.97)), "landmarks"),
    Fault(
        "range scale and bias", r"range.*0\.98.*0\.1\b",
        seen(lambda f, i, z: z * (0.98, 1.0) + (0.1, 0.0)), "landmarks",
    ),
    Fault(
        "expected range scale", r"expected range is 1\.02 times",
        lambda f: replace(f, expected=lambda f, x, m: f.cast(own.expected(f, x, m) * (1.02, 1.0))),
    ),
    Fault("sensor's place", r"0\.3.*-0\.1", sensor_at(0.3, -0.1), r"heading|H "),
    Fault(
        "ranges rounded", r"range.*(round|multiples).*0\.1\b",
        seen(lambda f, i, z: np.array([np.round(z[0], 1), z[1]])), "landmarks",
    ),
    Fault(
        "bearings in whole degrees", r"bearing.*(round|multiples).*(0\.0174|degree)",
        seen(lambda f, i, z: np.array([z[0], np.radians(np.round(np.degrees(z[1])))])),
        "landmarks",
    ),
    Fault(
        "far ranges scaled", r"range is 1\.05 times.*(beyond|above|range).*12",
        seen(lambda f, i, z: z * (1.05 if z[0] > 12.0 else 1.0, 1.0)), "landmarks",
    ),
    Fault(
        "one landmark's range", r"range.*0\.5.*landmark 3\b",
        seen(lambda f, i, z: z + (0.5 * (f.landmark_index[i] == 3), 0.0)), "landmarks",
    ),
    Fault(
        "bearing bias later on", r"bearing.*0\.05.*(from|since|time).*30",
        seen(lambda f, i, z: z + (0.0, 0.05 * (time_of(f, i) > 30.0))), "landmarks",
    ),
    Fault("bearing of the measurement before", r"bearing.*previous", seen(shifted), "landmarks"),
    Fault(
        "expected from the departing pose", r"expected.*before the (last )?prediction",
        lambda f: replace(f, expected=lambda f, x, m: own.expected(f, f.before, m)),
    ),
    Fault(
        "bearing of the left is negative only", r"bearing.*(absolute|without its sign)",
        seen(lambda f, i, z: np.array([z[0], abs(z[1])])), "landmarks",
    ),
    # R.
    Fault("R of ranges times 4", r"R.*range.* 4 times", noisy(blocks(4.0, 1.0))),
    Fault("R of bearings times 0.25", r"R.*bearing.* 0\.25 times", noisy(blocks(1.0, 0.25))),
    Fault("R times 9", r"R is 9 times", noisy(blocks(9.0, 9.0))),
    Fault(
        "sigma of range grows", r"R.*range.*(grows|proportion|times the range)",
        noisy(lambda f, i, r: np.diag([(0.02 * own.measured(f, i)[0]) ** 2, r[1, 1]])),
    ),
    Fault(
        "R correlated", r"R.*(correlat|off-diagonal).*0\.3",
        noisy(lambda f, i, r: r + 0.3 * np.sqrt(r[0, 0] * r[1, 1]) * (1.0 - np.eye(2))),
    ),
    Fault(
        "bearing's sigma for variance", r"R.*bearing.*sigma instead",
        noisy(lambda f, i, r: np.diag([r[0, 0], np.sqrt(r[1, 1])])),
    ),
    Fault(
        "R of new landmarks times 4", r"R of new landmarks.* 4 times", new_noise(lambda r: 4 * r)
    ),
    Fault(
        "R of new landmarks' bearing halved", r"R of new landmarks.*bearing.* 0\.5 times",
        new_noise(lambda r: r * np.diag([1.0, 0.5])),
    ),
    Fault("sigma in new landmarks", r"R of new landmarks.*sigma instead", new_noise(np.sqrt)),
    # H.
    Fault(
        "heading column's sign", r"heading.*opposite sign",
        rows(lambda h, x, m: h * (1, 1, -1, 1, 1)),
    ),
    Fault("range row halved", r"range row.* 0\.5 times", rows(lambda h, x, m: h * [[0.5], [1.0]])),
    Fault(
        "bearing row by the range", r"bearing row.*(range|distance)",
        rows(lambda h, x, m: np.vstack((h[0], np.hypot(*(m - x[:2])) * h[1] * (1, 1, 0, 1, 1)
                                        + (0, 0, -1, 0, 0)))),
    ),
    Fault(
        "landmark columns halved", r"landmark.* 0\.5 times",
        rows(lambda h, x, m: h * (1, 1, 1, 0.5, 0.5)),
    ),
    Fault("H at the first place", r"H.*(first|initial)", lambda f: replace(f, by_state=at_first)),
    Fault(
        "H before the prediction", r"H.*before the last prediction",
        lambda f: replace(f, by_state=lambda f, x, m: own.by_state(f, f.before, m)),
    ),
    # Steps.
    Fault("speed scale", r"(speed is|lasts) 1\.02 times", driven(scaled(1.02, 1.0)), Q_ALSO),
    Fault("speed bias", r"speed.*0\.05 m/s", driven(added(0.05, 0.0)), Q_ALSO),
    Fault("steering scale", r"(steering angle|yaw rate) is 1\.05 times",
          driven(scaled(1.0, 1.05)), Q_ALSO),
    Fault("steering bias", r"(steering|yaw rate).*0\.01 rad", driven(added(0.0, 0.01)), Q_ALSO),
    Fault("turn scale", r"(rotation|yaw rate).* 0\.95 times", faster(0.95)),
    Fault(
        "speed and steering scaled", r"speed is 1\.01.*(steering|yaw rate).*0\.98",
        driven(scaled(1.01, 0.98)), Q_ALSO,
    ),
    Fault(
        "odometry four samples late", r"odometry.*(4 samples|0\.[0-9]+ s)",
        driven(lambda f, k, u: lagged(f, k, 4)), Q_ALSO,
    ),
    Fault(
        "odometry a sample early", r"odometry.*(sample|0\.[0-9]+ s)",
        driven(lambda f, k, u: lagged(f, k, -1)), Q_ALSO,
    ),
    Fault(
        "steering a sample late", r"steering.*sample",
        driven(lambda f, k, u: np.array([u[0], lagged(f, k, 1)[1]])), Q_ALSO,
    ),
    Fault(
        "mean of two samples", r"mean|average|between",
        driven(lambda f, k, u: 0.5 * (u + lagged(f, k, 1))), Q_ALSO,
    ),
    Fault("F at the arriving pose", r"F.*after the step", f_turned(1.0)),
    Fault("F at the middle", r"F.*(middle|0\.5)", f_turned(0.5)),
    Fault("step along the middle heading", r"(middle|0\.5).*heading|heading.*middle", middle(0.5),
          r"^F is linearised at the pose before", "car"),
    Fault("step along the arc", r"\barc\b", middle(0.5, shrunk=True), Q_ALSO, "car"),
    Fault("sensor's place on the car", r"sensor_forward_m.*3\.5\b", car(sensor_forward_m=3.5),
          Q_ALSO, "car"),
    Fault("encoder's place", r"encoder_offset_m.*0\.5\b", car(encoder_offset_m=0.5), Q_ALSO, "car"),
    # Q.
    Fault(
        "Q not turned", r"Q.*(not rotated|vehicle's frame|vehicle's axes)",
        spread(lambda q, x, y, dt: turned(-x[2]) @ q @ turned(-x[2]).T),
    ),
    Fault(
        "Q turned by the arriving heading", r"Q.*after the step",
        spread(lambda q, x, y, dt: turned(y[2] - x[2]) @ q @ turned(y[2] - x[2]).T),
    ),
    Fault("Q times 3", r"Q is 3 times", spread(lambda q, x, y, dt: 3.0 * q)),
    Fault(
        "speed's noise times 4", r"speed.*Q.* 4 times",
        control_sigma(lambda s: s * np.diag([4.0, 1.0])),
    ),
    Fault(
        "turn's noise times 0.25", r"(yaw rate|steering).*Q.* 0\.25 times",
        control_sigma(lambda s: s * np.diag([1.0, 0.25])),
    ),
    Fault(
        "turn's sigma for variance", r"(yaw rate|steering).*Q.*sigma instead",
        control_sigma(lambda s: np.diag([s[0, 0], np.sqrt(s[1, 1])])),
    ),
    Fault(
        "Q by dt, not its square", r"Q.*interval|Q is 40 times",
        spread(lambda q, x, y, dt: q / dt),
    ),
    Fault(
        "stabilisation times 100", r"(stabilis|rate).* 100 times",
        lambda f: replace(f, step_noise=lambda f, x, y, u, dt: f.cast(
            own.step_noise(f, x, y, u, dt) + 99.0 * dt * own.stabilisation(f))),
    ),
    # New landmarks.
    Fault(
        "range bias of new landmarks", r"landmarks.*range.*0\.2",
        lambda f: replace(f, measured_new=lambda f, i: f.cast(own.measured(f, i) + (0.2, 0.0))),
    ),
    Fault(
        "new landmarks from the departing pose", r"landmarks.*before the (last )?prediction",
        lambda f: replace(f, point=lambda f, x, z: own.point(f, f.before, z)),
    ),
    Fault(
        "G_x's heading sign", r"G_x.*heading.*opposite",
        initialised(lambda g, z: g * (1, 1, -1, 1, 1)),
    ),
    Fault(
        "G_z without the range", r"G_z.*range",
        initialised(lambda g, z: g / np.array([1, 1, 1, 1, z[0]])),
    ),
    # Positions and the prior.
    Fault(
        "positions' offset", r"position.*0\.5.*-0\.2",
        lambda f: replace(f, place=lambda f, g: f.cast(own.place(f, g) + (0.5, -0.2))),
        log="positions",
    ),
    Fault(
        "positions' R times 4", r"(R|noise).*position.* 4 times",
        lambda f: replace(f, place_noise=lambda f, g: 4.0 * own.place_noise(f, g)),
        log="positions",
    ),
    Fault(
        "positions' sigma for variance", r"(R|noise).*position.*sigma instead",
        lambda f: replace(f, place_noise=lambda f, g: np.sqrt(own.place_noise(f, g))),
        log="positions",
    ),
    Fault(
        "lever arm not turned", r"(lever|antenna).*not rotated",
        lambda f: replace(f, arm=lambda f, x: f.cast(own.lever(f))),
        r"position.*(heading|H)", "positions",
    ),
    Fault(
        "prior's covariance times 100", r"prior.* 100 times",
        lambda f: replace(f, prior_covariance=100.0 * f.prior_covariance),
    ),
    Fault(
        "prior's heading", r"prior.*heading.*0\.1\b",
        lambda f: replace(f, prior_pose=f.prior_pose + np.array([0.0, 0.0, 0.1])),
    ),
)  # fmt: skip
"""Written before the hints that name them."""


def extrapolated(seconds: float) -> Plant:
    """Measurements are expected from where the vehicle will be."""

    def expected(f: Foreign, pose: Array, at: Array) -> Array:
        last = f.timeline.step_duration_s[max(f.step - 1, 0)]
        return own.expected(f, pose + seconds / last * (f.arrived - f.before), at)

    return lambda f: replace(f, expected=expected)


def mixed_rows(f: Foreign, pose: Array, at: Array) -> Array:
    """Return H with its bearing row from before the prediction."""
    return np.vstack((own.by_state(f, pose, at)[0], own.by_state(f, f.before, at)[1]))


def at_seen(f: Foreign, pose: Array, at: Array) -> Array:
    """Return H where the measurement puts the landmark."""
    return own.by_state(f, pose, own.point(f, pose, own.measured(f, f.now[0])))


HELD_OUT = (
    Fault("speed in steps", r"speed.*(rounded|multiples)",
          driven(lambda f, k, u: np.array([np.round(u[0], 1), u[1]])), Q_ALSO),
    Fault("steering clipped", r"steering.*(cut|limit|clip|always).*0\.05",
          driven(lambda f, k, u: np.clip(u, -np.inf, (np.inf, 0.05))), Q_ALSO),
    Fault("slow speeds dropped", r"speed.*(zero|always 0 )",
          driven(lambda f, k, u: u * (u[0] > 2.8, 1.0)), Q_ALSO),
    Fault("slip in left turns", r"(speed is|lasts) 0\.97",
          driven(lambda f, k, u: u * (0.97 if u[1] > 0.0 else 1.0, 1.0)), Q_ALSO),
    Fault("beam off by one", r"bearing.*0\.0087",
          seen(added(0.0, np.radians(0.5))), "landmarks"),
    Fault("steering scaled with a bias", r"steering angle is 1\.1 times.*-0\.02",
          driven(lambda f, k, u: u * (1.0, 1.1) - (0.0, 0.02)), Q_ALSO),
    Fault("measurements 50 ms late", r"0\.05 s", extrapolated(0.05)),
    Fault("H where it was seen", r"H.*measurement gives", lambda f: replace(f, by_state=at_seen)),
    Fault("bearing row of the old pose", r"bearing row.*before the last prediction",
          lambda f: replace(f, by_state=mixed_rows)),
    Fault("half the range for new ones", r"landmarks' range is 0\.5 times",
          lambda f: replace(f, measured_new=lambda f, i: own.measured(f, i) * (0.5, 1.0))),
    Fault("bearing noise added", r"R of the bearing (has a constant of 0\.0001 added|is 1\.328)",
          noisy(lambda f, i, r: r + np.diag([0.0, 1e-4]))),
    Fault("far R halved", r"R is 0\.5 times.*range.* 15",
          noisy(lambda f, i, r: r * (0.5 if own.measured(f, i)[0] > 15.0 else 1.0))),
    Fault("new R grows", r"R of new landmarks of the range is .* times .*range",
          lambda f: replace(f, noise_new=lambda f, i: f.cast(
              np.diag([(0.05 * own.measured(f, i)[0]) ** 2, own.noise(f, i)[1, 1]])))),
    Fault("new R exchanged", r"R of new landmarks has the variances",
          new_noise(lambda r: r[::-1, ::-1])),
    Fault("prior's sigma for variance", r"prior's covariance contains sigma",
          lambda f: replace(f, prior_covariance=np.sqrt(f.prior_covariance))),
    Fault("trapezoid", r"mean of a sample and the next one",
          driven(lambda f, k, u: 0.5 * (u + lagged(f, k, -1))), Q_ALSO),
    Fault("a third of the way", r"0\.3 of the way between a sample and the next one",
          driven(lambda f, k, u: u + 0.3 * (lagged(f, k, -1) - u)), Q_ALSO),
    Fault("interval in centiseconds", r"(interval|lasts)",
          lambda f: replace(f, duration=lambda f, k: max(
            0.01, np.floor(own.duration(f, k) * 100) / 100)),
          Q_ALSO),
    Fault("shorter wheelbase", r"wheelbase is 2\.500 m", car(wheelbase_m=2.5), Q_ALSO, "car"),
    Fault("speed noise with the speed", r"speed.*Q.*(grow|proportion)",
          lambda f: replace(f, by_control=lambda f, x, y, u, dt: f.cast(
              own.by_control(f, x, y, u, dt) * (abs(u[0]), 1.0)))),
    Fault("positions mirrored", r"east and north",
          lambda f: replace(f, place=lambda f, g: own.place(f, g)[::-1]), log="positions"),
    Fault("R of positions correlated", r"R of positions.*correl",
          lambda f: replace(f, place_noise=lambda f, g: own.place_noise(f, g)
                            @ np.array([[1.0, 0.5], [0.5, 1.0]])), log="positions"),
    Fault("a few labels' bearing", r"bearing.*0\.1\b",
          seen(lambda f, i, z: z + (0.0, 0.1 * (f.landmark_index[i] < 5))), "landmarks"),
    Fault("ranges logarithmic", r"range.*(log|curv)",
          seen(lambda f, i, z: np.array([10.0 * np.log1p(z[0] / 10.0), z[1]])), "landmarks"),
    Fault("noise in the range", r"range.*(random|noise)",
          seen(lambda f, i, z: z + (0.1 * np.sin(1e4 * i), 0.0)), "landmarks"),
)  # fmt: skip
"""Written after the hints. Their first run showed three mistakes of the hints, since mended."""
