"""Faults planted in a stranger's EKF, and the words that a hint that names them holds.

A function that replaces a method is given that method first, then the filter and its arguments.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from comparisons.faults.fault import derived
from research.trust.strangers import Array, StrangerLog, TextbookEkf, rotation

Plant = Callable[[type[TextbookEkf]], type[TextbookEkf]]
Change = Callable[..., Any]


class StrangerFault(NamedTuple):
    """A fault, and how to know that a report is right; patterns are regular expressions.

    hint: what one part of the hint by a trace must match. also: what other parts may say, being
    consequences. log: "any", or the kind that shows it.
    """

    name: str
    plant: Plant
    hint: str
    also: str = "^$"
    log: str = "any"

    def judge(self, parts: list[str]) -> str:
        """Whether a hint's parts are right, wrong, or say nothing."""
        if not parts:
            return "general"
        if any(not re.search(f"{self.hint}|{self.also}", part) for part in parts):
            return "wrong"
        return "right" if any(re.search(self.hint, part) for part in parts) else "general"


def instead(**methods: Change) -> Plant:
    """Replace methods."""

    def with_filter(method: Change) -> Change:
        return lambda own, *args: method(own, own.__self__, *args)

    return lambda base: derived(base, **{name: with_filter(m) for name, m in methods.items()})


def scaled(name: str, factor: Any) -> Plant:
    """Multiply what a method returns."""
    return instead(**{name: lambda own, ekf, *args: factor * own(*args)})


def fed(change: Callable[[StrangerLog], dict[str, Any]]) -> Plant:
    """Change the log's content before the filter has it."""
    return instead(fed=lambda own, ekf, log: replace(log, **change(log)))


def changed(name: str, change: Change) -> Plant:
    """Change what a method returns of a measurement or sample, by the filter, its number and that.

    seen: z. noise: R, that of new landmarks as well. first_noise: R of new landmarks alone. driven:
    speed and turn.
    """
    return instead(**{name: lambda own, ekf, k: np.asarray(change(ekf, k, own(k)))})


def rooted(k: int) -> Change:
    """Return what puts a sigma in the place of a variance on a diagonal."""

    def method(own: Change, ekf: TextbookEkf, *args: Any) -> Array:
        r: Array = own(*args)
        r[k, k] = np.sqrt(r[k, k])
        return r

    return method


def expecting(change: Change) -> Plant:
    """Change the expected measurement and leave H: by `own`, the filter, pose and point."""

    def expected(own: Change, ekf: TextbookEkf, pose: Array, point: Array) -> Any:
        return (change(own, ekf, pose, point), *own(pose, point)[1:])

    return instead(expected=expected)


def h_of(change: Change) -> Plant:
    """Change H: by `own`, the filter, pose and point; returns the parts (2, 3) and (2, 2)."""

    def expected(own: Change, ekf: TextbookEkf, pose: Array, point: Array) -> Any:
        return (own(pose, point)[0], *change(own, ekf, pose, point))

    return instead(expected=expected)


def entries(change: Callable[[Array, Array], Array]) -> Plant:
    """Change the entries of H (2, 5), by themselves and the way to the landmark."""

    def parts(own: Change, ekf: TextbookEkf, pose: Array, point: Array) -> tuple[Array, Array]:
        h = change(np.hstack(own(pose, point)[1:]), point - pose[:2])
        return h[:, :3], h[:, 3:]

    return h_of(parts)


def bearing_of_departed(
    own: Change, ekf: TextbookEkf, pose: Array, point: Array
) -> tuple[Array, ...]:
    """Return H with its bearing row from before the prediction."""
    pairs = zip(own(pose, point)[1:], own(ekf.departed, point)[1:], strict=True)
    return tuple(np.vstack((now[0], then[1])) for now, then in pairs)


def sensor_at(forward: float, left: float) -> Plant:
    """Expect measurements from a place beside the pose, with H."""

    def expected(own: Change, ekf: TextbookEkf, pose: Array, point: Array) -> Any:
        arm = rotation(pose[2]) @ (forward, left)
        z, hv, hl = own(pose + np.append(arm, 0.0), point)
        hv[:, 2] += hv[:, :2] @ (-arm[1], arm[0])
        return z, hv, hl

    return instead(expected=expected)


def extrapolated(seconds: float) -> Plant:
    """Expect measurements from where the vehicle will be."""

    def ahead(own: Change, ekf: TextbookEkf, pose: Array, point: Array) -> Any:
        return own(pose + seconds / ekf.lasted_s * (ekf.arrived - ekf.departed), point)[0]

    return expecting(ahead)


def stepping(change: Change) -> Plant:
    """Change where a step leads, but not F and B: by departing and arriving pose."""

    def motion(own: Change, ekf: TextbookEkf, pose: Array, *args: Any) -> Any:
        arrived, f, b = own(pose, *args)
        return np.asarray(change(pose, arrived)), f, b

    return instead(motion=motion)


def turned(part: float, pose: Array, arrived: Array) -> Array:
    """Return the matrix (3, 3) that turns by a part of a step's turn."""
    full = np.eye(3)
    full[:2, :2] = rotation(part * (arrived[2] - pose[2]))
    return full


def along_arc(pose: Array, arrived: Array) -> Array:
    """Lead along the heading at the middle, as long as the chord of the arc."""
    moved = turned(0.5, pose, arrived) @ (arrived - pose)
    moved[:2] *= np.sinc(0.5 * moved[2] / np.pi)
    return np.asarray(pose + moved)


def f_turned(part: float) -> Plant:
    """Take F's position terms from another heading."""

    def motion(own: Change, ekf: TextbookEkf, pose: Array, *args: Any) -> Any:
        arrived, f, b = own(pose, *args)
        f[:2, 2] = turned(part, pose, arrived)[:2, :2] @ f[:2, 2]
        return arrived, f, b

    return instead(motion=motion)


def spread(change: Change) -> Plant:
    """Change the control's part of Q, by the filter and dt."""

    def process(own: Change, ekf: TextbookEkf, b: Array, noise: Array, dt: float) -> Array:
        rates = dt * ekf.rates
        return np.asarray(change(ekf, own(b, noise, dt) - rates, dt) + rates)

    return instead(process=process)


def turning_q(by: Callable[[Array, Array], float]) -> Plant:
    """Turn the control's part of Q by an angle, of departing and arriving pose."""

    def change(ekf: TextbookEkf, q: Array, dt: float) -> Array:
        turn = np.eye(3)
        turn[:2, :2] = rotation(by(ekf.departed, ekf.arrived))
        return turn @ q @ turn.T

    return spread(change)


def with_speed(own: Change, ekf: TextbookEkf, pose: Array, u: Array, dt: float) -> Any:
    """Let the speed's noise grow with the speed."""
    arrived, f, b = own(pose, u, dt)
    return arrived, f, b * (abs(u[0]), 1.0)


def lagged(ekf: TextbookEkf, number: int, lag: int) -> Array:
    """Return speed and turn so many samples before."""
    at = number - lag
    return np.zeros(2) if at < 0 else np.asarray(ekf.log.u[min(at, len(ekf.log.u) - 1)])


def in_centiseconds(own: Change, ekf: TextbookEkf, number: int, dt: float, end_s: float) -> None:
    """Cut the interval down."""
    own(number, max(0.01, np.floor(dt * 100) / 100), end_s)


def started(change: Callable[[Array], Array]) -> Plant:
    """Change the prior's pose."""

    def meta(log: StrangerLog) -> dict[str, Any]:
        prior = log.meta["prior"]
        return {"meta": log.meta | {"prior": prior | {"pose": change(np.array(prior["pose"]))}}}

    return fed(meta)


def positioned(place: Change = lambda z: z, noise: Change = lambda r: r) -> Plant:
    """Change a position and its R."""

    def position(own: Change, ekf: TextbookEkf, g: int) -> tuple[Array, Array]:
        z, r = own(g)
        return np.asarray(place(z)), np.asarray(noise(r))

    return instead(position=position)


def placed(gx: Change = lambda gx, z: gx, gz: Change = lambda gz, z: gz) -> Plant:
    """Change G_x and G_z, by themselves and z."""

    def place(own: Change, ekf: TextbookEkf, pose: Array, z: Array) -> Any:
        point, x, by_z = own(pose, z)
        return point, gx(x, z), gz(by_z, z)

    return instead(place=place)


def from_departed(own: Change, ekf: TextbookEkf, pose: Array, z: Array) -> Any:
    """Put a new landmark where the departing pose sees it."""
    return (own(ekf.departed, z)[0], *own(pose, z)[1:])


def forgets(own: Change, ekf: TextbookEkf, *args: Any) -> None:
    """Lose a hundredth of the vehicle's covariance with the map."""
    own(*args)
    ekf.p[:3, 3:] *= 0.99
    ekf.p[3:, :3] *= 0.99


FORGETFUL = instead(carry=forgets, initialise=forgets)

Q_ALSO = r"^Q |^the control part of Q is|noise of the"  # Q follows the control that was used


def measured(name: str, hint: str, change: Change) -> StrangerFault:
    """Return a fault of what is taken for the measurement, new landmarks included."""
    return StrangerFault(name, changed("seen", change), hint, "landmarks")


def driven(name: str, hint: str, change: Change) -> StrangerFault:
    """Return a fault of the control."""
    return StrangerFault(name, changed("driven", change), hint, Q_ALSO)


def of_r(name: str, hint: str, change: Change, *, new: bool = False) -> StrangerFault:
    """Return a fault of R, that of new landmarks included or alone."""
    return StrangerFault(name, changed("first_noise" if new else "noise", change), hint)


def of_car(name: str, hint: str, **parts: float) -> StrangerFault:
    """Return a fault of the vehicle's measures, in its motion alone."""
    plant = instead(velocity=lambda own, ekf, u: own(u, **parts))
    return StrangerFault(name, plant, hint, Q_ALSO, "car")


def of_positions(name: str, hint: str, **parts: Change) -> StrangerFault:
    """Return a fault of positions: of the place, of the noise."""
    return StrangerFault(name, positioned(**parts), hint, log="positions")


HINTS = (
    # What is measured, and what is expected.
    measured("range scale", r"range is 1\.03 times", lambda ekf, k, z: z * (1.03, 1.0)),
    measured("range bias 0.2 m", r"range.*(\+0\.2|0\.2 m)", lambda ekf, k, z: z + (0.2, 0.0)),
    measured("bearing bias 0.02", r"bearing.*0\.02", lambda ekf, k, z: z + (0.0, 0.02)),
    measured("bearing scale", r"bearing is 0\.97 times", lambda ekf, k, z: z * (1.0, 0.97)),
    measured(
        "range scale and bias", r"range.*0\.98.*0\.1\b",
        lambda ekf, k, z: z * (0.98, 1.0) + (0.1, 0.0),
    ),
    StrangerFault(
        "expected range scale",
        expecting(lambda own, ekf, pose, point: own(pose, point)[0] * (1.02, 1.0)),
        hint=r"expected range is 1\.02 times",
    ),
    StrangerFault("sensor's place", sensor_at(0.3, -0.1), hint=r"0\.3.*-0\.1", also=r"heading|H "),
    measured(
        "ranges rounded", r"range.*(round|multiples).*0\.1\b",
        lambda ekf, k, z: (np.round(z[0], 1), z[1]),
    ),
    measured(
        "bearings in whole degrees", r"bearing.*(round|multiples).*(0\.0174|degree)",
        lambda ekf, k, z: (z[0], np.radians(np.round(np.degrees(z[1])))),
    ),
    measured(
        "far ranges scaled", r"range is 1\.05 times.*(beyond|above|range).*12",
        lambda ekf, k, z: z * (1.05 if z[0] > 12.0 else 1.0, 1.0),
    ),
    measured(
        "one landmark's range", r"range.*0\.5.*landmark 3\b",
        lambda ekf, k, z: z + (0.5 * (ekf.log.label[k] == 3), 0.0),
    ),
    measured(
        "bearing bias later on", r"bearing.*0\.05.*(from|since|time).*30",
        lambda ekf, k, z: z + (0.0, 0.05 * (ekf.log.used_s[k] - ekf.log.odometry_s[0] > 30.0)),
    ),
    measured(
        "bearing of the measurement before", r"bearing.*previous",
        lambda ekf, k, z: (z[0], ekf.log.z[max(k - 1, 0), 1]),
    ),
    StrangerFault(
        "expected from the departing pose",
        expecting(lambda own, ekf, pose, point: own(ekf.departed, point)[0]),
        hint=r"expected.*before the (last )?prediction",
    ),
    measured(
        "bearing of the left is negative only", r"bearing.*(absolute|without its sign)",
        lambda ekf, k, z: (z[0], abs(z[1])),
    ),
    # R.
    of_r("R of ranges times 4", r"R.*range.* 4 times", lambda ekf, k, r: r * np.diag([4.0, 1.0])),
    of_r("R of bearings times 0.25", r"R.*bearing.* 0\.25 times",
         lambda ekf, k, r: r * np.diag([1.0, 0.25])),
    of_r("R times 9", r"R is 9 times", lambda ekf, k, r: 9.0 * r),
    of_r("sigma of range grows", r"R.*range.*(grows|proportion|times the range)",
         lambda ekf, k, r: np.diag([(0.02 * ekf.log.z[k, 0]) ** 2, r[1, 1]])),
    of_r("R correlated", r"R.*(correlat|off-diagonal).*0\.3",
         lambda ekf, k, r: r + 0.3 * np.sqrt(r[0, 0] * r[1, 1]) * (1.0 - np.eye(2))),
    StrangerFault("sigma for variance, bearing", instead(noise=rooted(1)),
                  r"R.*bearing.*sigma instead"),
    of_r("R of new landmarks times 4", r"R of new landmarks.* 4 times",
         lambda ekf, k, r: 4.0 * r, new=True),
    of_r("R of new landmarks' bearing halved", r"R of new landmarks.*bearing.* 0\.5 times",
         lambda ekf, k, r: r * np.diag([1.0, 0.5]), new=True),
    of_r("sigma in new landmarks", r"R of new landmarks.*sigma instead",
         lambda ekf, k, r: np.sqrt(r), new=True),
    # H.
    StrangerFault("sign of H's heading", entries(lambda h, d: h * (1, 1, -1, 1, 1)),
          r"heading.*opposite sign"),
    StrangerFault("range row halved", entries(lambda h, d: h * [[0.5], [1.0]]),
          hint=r"range row.* 0\.5 times"),
    StrangerFault(
        "bearing row by the range",
        entries(lambda h, d: h * [[1.0] * 5, np.hypot(*d) ** np.array([1, 1, 0, 1, 1])]),
        hint=r"bearing row.*(range|distance)",
    ),
    StrangerFault("landmark columns halved", entries(lambda h, d: h * (1, 1, 1, 0.5, 0.5)),
          hint=r"landmark.* 0\.5 times"),
    StrangerFault(
        "H at the first place",
        h_of(lambda own, ekf, pose, at: own(pose, ekf.began[ekf.log.label[ekf.now]])[1:]),
        hint=r"H.*(first|initial)",
    ),
    StrangerFault("H before the prediction",
                  h_of(lambda own, ekf, pose, at: own(ekf.departed, at)[1:]),
                  hint=r"H.*before the last prediction"),
    # Steps.
    driven("speed times 1.02", r"(speed is|lasts) 1\.02 times", lambda ekf, n, u: u * (1.02, 1.0)),
    driven("speed bias", r"speed.*0\.05 m/s", lambda ekf, n, u: u + (0.05, 0.0)),
    driven("steering scale", r"(steering angle|yaw rate) is 1\.05 times",
           lambda ekf, n, u: u * (1.0, 1.05)),
    driven("steering bias", r"(steering|yaw rate).*0\.01 rad", lambda ekf, n, u: u + (0.0, 0.01)),
    StrangerFault(
        "turn scale",
        stepping(lambda pose, arrived: pose + (1.0, 1.0, 0.95) * (arrived - pose)),
        hint=r"(rotation|yaw rate).* 0\.95 times",
    ),
    driven("speed and steering scaled", r"speed is 1\.01.*(steering|yaw rate).*0\.98",
           lambda ekf, n, u: u * (1.01, 0.98)),
    driven("odometry four samples late", r"odometry.*(4 samples|0\.[0-9]+ s)",
           lambda ekf, n, u: lagged(ekf, n, 4)),
    driven("odometry a sample early", r"odometry.*(sample|0\.[0-9]+ s)",
           lambda ekf, n, u: lagged(ekf, n, -1)),
    driven("steering a sample late", r"steering.*sample",
           lambda ekf, n, u: (u[0], lagged(ekf, n, 1)[1])),
    driven("mean of two samples", r"mean|average|between",
           lambda ekf, n, u: 0.5 * (u + lagged(ekf, n, 1))),
    StrangerFault("F at the arriving pose", f_turned(1.0), hint=r"F.*after the step"),
    StrangerFault("F at the middle", f_turned(0.5), hint=r"F.*(middle|0\.5)"),
    StrangerFault(
        "step along the middle heading",
        stepping(lambda pose, arrived: pose + turned(0.5, pose, arrived) @ (arrived - pose)),
        hint=r"(middle|0\.5).*heading|heading.*middle",
        also=r"^F is linearised at the pose before", log="car",
    ),
    StrangerFault("step along the arc", stepping(along_arc), hint=r"\barc\b", also=Q_ALSO,
                  log="car"),
    of_car("sensor's place on the car", r"sensor_forward_m.*3\.5\b", sensor_forward_m=3.5),
    of_car("encoder's place", r"encoder_offset_m.*0\.5\b", encoder_offset_m=0.5),
    # Q.
    StrangerFault(
        "Q in the body's axes", turning_q(lambda departed, arrived: -departed[2]),
        r"Q.*(not rotated|vehicle's frame|vehicle's axes)",
    ),
    StrangerFault("Q turned by the arriving heading",
          turning_q(lambda departed, arrived: arrived[2] - departed[2]), hint=r"Q.*after the step"),
    StrangerFault("Q times 3", spread(lambda ekf, q, dt: 3.0 * q), hint=r"Q is 3 times"),
    StrangerFault(
        "speed's noise times 4",
        instead(of_control=lambda own, ekf, s: own(s) * np.diag([4.0, 1.0])),
        hint=r"speed.*Q.* 4 times",
    ),
    StrangerFault(
        "turn's noise times 0.25",
        instead(of_control=lambda own, ekf, s: own(s) * np.diag([1.0, 0.25])),
        hint=r"(yaw rate|steering).*Q.* 0\.25 times",
    ),
    StrangerFault("sigma for variance, turn", instead(of_control=rooted(1)),
          r"(yaw rate|steering).*Q.*sigma instead"),
    StrangerFault("Q by dt, not its square", spread(lambda ekf, q, dt: q / dt),
          hint=r"Q.*interval|Q is 40 times"),
    StrangerFault("stabilisation times 100", spread(lambda ekf, q, dt: q + 99.0 * dt * ekf.rates),
          hint=r"(stabilis|rate).* 100 times"),
    # New landmarks.
    StrangerFault("range bias of new landmarks",
          instead(first_seen=lambda own, ekf, k: own(k) + (0.2, 0.0)),
          hint=r"landmarks.*range.*0\.2"),
    StrangerFault("new landmarks from the departing pose", instead(place=from_departed),
          hint=r"landmarks.*before the (last )?prediction"),
    StrangerFault("G_x's heading sign", placed(gx=lambda gx, z: gx * (1, 1, -1)),
          hint=r"heading.*G_x.*opposite"),
    StrangerFault("G_z without the range", placed(gz=lambda gz, z: gz / (1.0, z[0])),
                  hint=r"G_z.*range"),
    # Positions and the prior.
    of_positions("positions' offset", r"position.*0\.5.*-0\.2", place=lambda z: z + (0.5, -0.2)),
    of_positions("positions' R times 4", r"(R|noise).*position.* 4 times", noise=lambda r: 4.0 * r),
    of_positions("positions' sigma for variance", r"(R|noise).*position.*sigma instead",
                 noise=np.sqrt),
    StrangerFault(
        "lever arm not turned",
        instead(arm=lambda own, ekf, pose: own(np.zeros(3))),
        hint=r"(lever|antenna).*not rotated", also=r"position.*(heading|H)", log="positions",
    ),
    StrangerFault("prior times 100", scaled("prior", 100.0), r"prior.* 100 times"),
    StrangerFault("prior's heading", started(lambda pose: pose + (0.0, 0.0, 0.1)),
          hint=r"prior.*heading.*0\.1\b"),
)  # fmt: skip
"""Written before the hints that name them."""
HELD_OUT = (
    driven("speed in steps", r"speed.*(rounded|multiples)",
           lambda ekf, n, u: (np.round(u[0], 1), u[1])),
    driven("steering clipped", r"steering.*(cut|limit|clip|always).*0\.05",
           lambda ekf, n, u: np.clip(u, -np.inf, (np.inf, 0.05))),
    driven("slow speeds dropped", r"speed.*(zero|always 0 )",
           lambda ekf, n, u: u * (u[0] > 2.8, 1.0)),
    driven("slip in left turns", r"(speed is|lasts) 0\.97",
           lambda ekf, n, u: u * (0.97 if u[1] > 0.0 else 1.0, 1.0)),
    measured("beam off by one", r"bearing.*0\.0087", lambda ekf, k, z: z + (0.0, np.radians(0.5))),
    driven("steering scaled with a bias", r"steering angle is 1\.1 times.*-0\.02",
           lambda ekf, n, u: u * (1.0, 1.1) - (0.0, 0.02)),
    StrangerFault("measurements 50 ms late", extrapolated(0.05), hint=r"0\.05 s"),
    StrangerFault(
        "H where it was seen",
        h_of(lambda own, ekf, pose, at: own(pose, ekf.place(pose, ekf.log.z[ekf.now])[0])[1:]),
        hint=r"H.*measurement gives",
    ),
    StrangerFault("bearing row of the old pose", h_of(bearing_of_departed),
          hint=r"bearing row.*before the last prediction"),
    StrangerFault("half the range for new ones",
          instead(first_seen=lambda own, ekf, k: own(k) * (0.5, 1.0)),
          hint=r"landmarks' range is 0\.5 times"),
    of_r("bearing noise added", r"R of the bearing (has a constant of 0\.0001 added|is 1\.328)",
         lambda ekf, k, r: r + np.diag([0.0, 1e-4])),
    of_r("far R halved", r"R is 0\.5 times.*range.* 15",
         lambda ekf, k, r: r * (0.5 if ekf.log.z[k, 0] > 15.0 else 1.0)),
    of_r("new R grows", r"R of new landmarks of the range is .* times .*range",
         lambda ekf, k, r: np.diag([(0.05 * ekf.log.z[k, 0]) ** 2, r[1, 1]]), new=True),
    of_r("new R exchanged", r"R of new landmarks has the variances",
         lambda ekf, k, r: r[::-1, ::-1], new=True),
    StrangerFault("sigma for variance, prior", instead(prior=lambda own, ekf, p: np.sqrt(own(p))),
          r"prior's covariance contains sigma"),
    driven("trapezoid", r"mean of a sample and the next one",
           lambda ekf, n, u: 0.5 * (u + lagged(ekf, n, -1))),
    driven("a third of the way", r"0\.3 of the way between a sample and the next one",
           lambda ekf, n, u: u + 0.3 * (lagged(ekf, n, -1) - u)),
    StrangerFault("interval in centiseconds", instead(predict=in_centiseconds),
                  hint=r"(interval|lasts)", also=Q_ALSO),
    of_car("shorter wheelbase", r"wheelbase is 2\.500 m", wheelbase_m=2.5),
    StrangerFault("speed noise with the speed", instead(motion=with_speed),
          hint=r"speed.*Q.*(grow|proportion)"),
    of_positions("positions mirrored", r"east and north", place=lambda z: z[::-1]),
    of_positions("R of positions correlated", r"R of positions.*correl",
                 noise=lambda r: r @ np.array([[1.0, 0.5], [0.5, 1.0]])),
    measured("a few labels' bearing", r"bearing.*0\.1\b",
             lambda ekf, k, z: z + (0.0, 0.1 * (ekf.log.label[k] < 5))),
    measured("ranges logarithmic", r"range.*(log|curv)",
             lambda ekf, k, z: (10.0 * np.log1p(z[0] / 10.0), z[1])),
    measured("noise in the range", r"range.*(random|noise)",
             lambda ekf, k, z: z + (0.1 * np.sin(1e4 * k), 0.0)),
)  # fmt: skip
"""Written after the hints. Their first run showed three mistakes of the hints, since mended."""
