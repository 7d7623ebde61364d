"""Legitimate designs of EKF-SLAM: one filter whose options compose, in numpy alone.

    python -m research.trust.designs [--list] [--broken] [--names] [--log NAME] [--form NAME]
                                     [--seed N]

A `Design` says how a filter is built: in which order it updates, how it keeps its covariance, where
its pose stands in the state, which data it leaves out on purpose. All designs are right; `broken`
plants an error in any of them. Each is run on five logs and handed to `slamcheck check`, with its
trace and without. Counted are the right ones that are convicted or refused, and the broken ones
that are not convicted. The exit code is 1 where a right one is convicted or refused.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.time_window import cut_log
from comparisons.config import CheckConfig
from comparisons.errors import InputError
from comparisons.estimates.external import read_external
from comparisons.jobs import check as check_job
from comparisons.jobs.check import check
from comparisons.jobs.readings import FAULT, MOTION, READINGS
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log as ProjectLog
from comparisons.logs.log_folder import read_log_folder, write_log_folder
from comparisons.logs.odometry import RelativePoses
from comparisons.pipeline.solve import solve
from research.script import options
from research.trust.odometry_drives import drive
from research.trust.strangers import rotation, wrapped
from slamcheck import Recorder

Array = NDArray[Any]
Chosen = tuple[str, ...]
GATE = {0.95: 5.991464547107979, 0.99: 9.21034037197618, 0.997: 11.618285980628055}
"""Chi-square quantiles of two degrees of freedom, from a table."""
NEAR, NEAR_M = 25.0, 0.5
"""Without labels: innovation squared, and distance, within which a landmark is the same."""
VAST_M = 1e3
"""Sigma of a landmark of which nothing is known."""


@dataclass(frozen=True)
class Design:
    """How a filter is built.

    update: all landmarks of an instant at once, one after the other, or range and bearing as two
    scalars; `entries`: all at once, ranges first. covariance: form of the update. state: where pose
    and map stand. order: of sequential updates. wrap: the heading in the state, in the output.
    skip: so many first measurements of each landmark are dropped. gate: probability, of the
    innovation squared. recorded: whether rejected measurements are. delayed: a landmark starts
    by its first measurement at a clone of the pose, once there is a second. prune: landmarks with
    fewer measurements are removed, at the end or (forget_s) once they were not measured for so
    long. prior: factor of the start's variances of position. rounds: of the iterated update.
    single: float32. two_inputs: on a log without stabilisation noise. vast: new landmarks have a
    large covariance, then are updated. composed: one prediction from measurement to measurement.
    new_first: landmarks are initialised before the others are updated.
    """

    update: Literal["joint", "landmark", "scalar", "entries"] = "joint"
    covariance: Literal["standard", "joseph", "root", "information"] = "standard"
    state: Literal["pose first", "map first", "heading first", "heading in the middle"] = (
        "pose first"
    )
    order: Literal["row", "backward", "label", "nearest"] = "row"
    bearing_first: bool = False
    wrap: Literal["no", "state", "output"] = "no"
    skip: int = 0
    gate: float = 0.0
    recorded: bool = True
    delayed: bool = False
    prune: int = 0
    forget_s: float = 0.0
    prior: float = 1.0
    rounds: int = 1
    single: bool = False
    two_inputs: bool = False
    vast: bool = False
    composed: bool = False
    new_first: bool = False

    @property
    def setting(self) -> bool:
        """Whether it starts otherwise than the log says."""
        return self.prior != 1.0


MRCLAM = Path(__file__).resolve().parents[3] / "shared/data/mrclam/MRCLAM_Dataset6"


class DesignLog(NamedTuple):
    """A log folder's content: controls u (N, 2) or displacements (N, 3) with covariances q."""

    meta: dict[str, Any]
    odometry_s: Array
    u: Array
    q: Array
    seen_s: Array
    z: Array
    sigma: Array
    label: NDArray[np.int64]


def read_log(folder: Path) -> DesignLog:
    """Read log.toml, odometry.csv and measurements.csv."""

    def table(name: str) -> dict[str, Array]:
        with (folder / name).open() as file:
            head, *rows = csv.reader(file)
        return dict(zip(head, np.array(rows, dtype=float).T, strict=True))

    meta = tomllib.loads((folder / "log.toml").read_text())
    moved, seen = table("odometry.csv"), table("measurements.csv")
    q = np.zeros((len(moved["time_s"]), 3, 3))
    if meta["odometry"]["kind"] == "relative-poses":
        u = np.column_stack((moved["dx_m"], moved["dy_m"], moved["dheading_rad"]))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            q[:, i, j] = q[:, j, i] = moved[f"cov_{i}{j}"]
    else:
        turn = "steering_rad" if meta["odometry"]["kind"] == "steering" else "yaw_rate_radps"
        u = np.column_stack((moved["speed_mps"], moved[turn]))
    return DesignLog(
        meta=meta,
        odometry_s=moved["time_s"],
        u=u,
        q=q,
        seen_s=seen["time_s"],
        z=np.column_stack((seen["range_m"], seen["bearing_rad"])),
        sigma=np.column_stack((seen["sigma_range_m"], seen["sigma_bearing_rad"])),
        label=seen["landmark"].astype(np.int64),
    )


class Filter:
    """An EKF-SLAM of a design. x, p: the state; at: rows of each block; broken: a planted error."""

    def __init__(self, design: Design, log: DesignLog, broken: str = "") -> None:
        """Start at the log's prior."""
        self.design, self.log, self.broken = design, log, broken
        self.dtype = np.float32 if design.single else np.float64
        rows = {"heading first": (1, 2, 0), "heading in the middle": (0, 2, 1)}
        self.at: dict[str, Array] = {"pose": np.array(rows.get(design.state, (0, 1, 2)))}
        prior = log.meta["prior"]
        self.x = np.zeros(3, self.dtype)
        self.p = np.zeros((3, 3), self.dtype)
        v = self.at["pose"]
        self.x[v] = prior["pose"]
        scale = np.sqrt([design.prior, design.prior, 1.0])
        self.p[np.ix_(v, v)] = np.outer(scale, scale) * np.array(prior["covariance"])
        self.first: dict[str, int] = {}
        self.uses: dict[str, int] = {}
        self.last_s: dict[str, float] = {}
        self.places: dict[int, Array] = {}
        self.skipped: dict[int, int] = {}
        self.waiting: dict[int, tuple[int, str]] = {}
        self.composed: tuple[Array, Array, Array] | None = None
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.path: list[tuple[float, Array, Array]] = []
        self.note("prior", {"pose": 3}, self.p[np.ix_(v, v)].copy(), point=self.x[v])

    def note(self, call: str, *matrices: Any, **more: Any) -> None:
        """Keep what goes into a recorder."""
        self.calls.append((call, matrices, more))

    # State

    def append(self, name: str, point: Array, across: Array, own: Array) -> None:
        """Add a block with cross-covariance (n, d) and covariance (d, d)."""
        n, d = len(self.x), len(point)
        p = np.block([[self.p, across], [across.T, own]]).astype(self.dtype)
        x = np.append(self.x, point).astype(self.dtype)
        if self.design.state == "map first":
            turned = np.concatenate((np.arange(n, n + d), np.arange(n)))
            x, p = x[turned], p[np.ix_(turned, turned)]
            self.at = {block: rows + d for block, rows in self.at.items()}
            self.at[name] = np.arange(d)
        else:
            self.at[name] = np.arange(n, n + d)
        self.x, self.p = x, p

    def remove(self, name: str) -> None:
        """Marginalise a block out."""
        gone = self.at.pop(name)
        stay = np.setdiff1d(np.arange(len(self.x)), gone)
        self.x, self.p = self.x[stay], self.p[np.ix_(stay, stay)]
        self.at = {block: np.searchsorted(stay, rows) for block, rows in self.at.items()}
        self.note("remove", name)

    @property
    def pose(self) -> Array:
        """x, y, heading."""
        return self.x[self.at["pose"]].copy()

    # Prediction

    def motion(self, pose: Array, number: int, dt: float) -> tuple[Array, Array, Array]:
        """Return the pose after dt, F and Q."""
        u, odometry, f = self.log.u[number], self.log.meta["odometry"], np.eye(3)
        if odometry["kind"] == "relative-poses":
            turn, ahead = np.eye(3), np.eye(3)
            turn[:2, :2] = rotation(pose[2])
            moved = turn @ u
            ahead[:2, :2] = rotation(pose[2] + u[2])
            f[:2, 2] = -moved[1], moved[0]
            return pose + moved, f, ahead @ self.log.q[number] @ ahead.T
        noise = odometry["noise"]
        m = np.diag([noise["sigma_speed_mps"], noise["sigma_turn"]]) ** 2
        rates = np.diag([noise["variance_rate_position"]] * 2 + [noise["variance_rate_heading"]])
        if odometry["kind"] == "steering":
            bend, length = np.tan(u[1]), odometry["vehicle"]["wheelbase_m"]
            c, s, rate = np.cos(pose[2]), np.sin(pose[2]), u[0] * bend / length
            slope = u[0] * (1.0 + bend**2) / length
            b = dt * np.array([[c, 0.0], [s, 0.0], [bend / length, slope]])
        else:
            c, s = np.cos(pose[2] + 0.5 * dt * u[1]), np.sin(pose[2] + 0.5 * dt * u[1])
            d, rate = dt * u[0], u[1]
            b = dt * np.array([[c, -0.5 * d * s], [s, 0.5 * d * c], [0.0, 1.0]])
        d = dt * u[0]
        f[:2, 2] = -d * s, d * c
        if self.broken == "sign":
            f[:2, 2] *= -1.0
        q = b @ m @ b.T + dt * rates
        return pose + [d * c, d * s, dt * rate], f, q

    def predict(self, number: int, dt: float, end_s: float) -> None:
        """Drive by a sample for dt."""
        if not self.design.composed:
            self.carry(self.pose, *self.motion(self.pose, number, dt), end_s)
            return
        pose, f, q = self.composed or (self.pose, np.eye(3), np.zeros((3, 3)))
        pose, step, noise = self.motion(pose, number, dt)
        self.composed = pose, step @ f, step @ q @ step.T + noise

    def carry(self, before: Array, after: Array, f: Array, q: Array, end_s: float) -> None:
        """Move the state."""
        v = self.at["pose"]
        f, q = f.astype(self.dtype), q.astype(self.dtype)
        self.x[v] = after
        if self.broken == "cross":
            self.p[np.ix_(v, v)] = f @ self.p[np.ix_(v, v)] @ f.T
        else:
            self.p[v] = f @ self.p[v]
            self.p[:, v] = self.p[:, v] @ f.T
        self.p[np.ix_(v, v)] += q
        self.note("at", end_s)
        self.note("predict", f, q, ["pose"], point=before, after=self.pose)
        if self.design.wrap == "state":
            self.x[v[2]] = wrapped(self.x[v[2]])

    def arrive(self, t: float) -> None:
        """Move by what was composed."""
        if self.composed is not None:
            self.carry(self.pose, *self.composed, t)
            self.composed = None

    # Measurements

    def expected(self, x: Array, name: str) -> tuple[Array, Array, Array]:
        """Return range and bearing, H of the pose and of the landmark."""
        pose, (dx, dy) = x[self.at["pose"]], x[self.at[name]] - x[self.at["pose"]][:2]
        d = np.hypot(dx, dy)
        hl = np.array([[dx / d, dy / d], [-dy / d**2, dx / d**2]])
        hv = np.column_stack((-hl, [0.0, 1.0 if self.broken == "sign" else -1.0]))
        return np.array([d, wrapped(np.arctan2(dy, dx) - pose[2])]), hv, hl

    def linearised(self, ks: list[int], names: list[str], x: Array) -> tuple[Array, Array, Array]:
        """Return H, z - h and R at a state."""
        h, nu = np.zeros((2 * len(ks), len(x))), np.zeros(2 * len(ks))
        for i, (k, name) in enumerate(zip(ks, names, strict=True)):
            rows = slice(2 * i, 2 * i + 2)
            expected, hv, hl = self.expected(x, name)
            h[rows, self.at["pose"]], h[rows, self.at[name]] = hv, hl
            nu[rows] = self.log.z[k] - expected
            nu[2 * i + 1] = wrapped(nu[2 * i + 1])
        r = np.diag(self.log.sigma[ks].ravel() ** 2) * (0.25 if self.broken == "noise" else 1.0)
        return h.astype(self.dtype), nu.astype(self.dtype), r.astype(self.dtype)

    def known_update(self, ks: list[int], names: list[str], rows: Array | None = None) -> None:
        """Update by measurements; rows: of their entries, by default all."""
        chosen = np.arange(2 * len(ks)) if rows is None else rows
        mean, x = self.x.copy(), self.x
        for _ in range(self.design.rounds):
            whole = self.linearised(ks, names, x)
            h, nu, r, point = whole[0][chosen], whole[1][chosen], whole[2][chosen][:, chosen], x
            nu = nu - np.asarray(h @ np.subtract(mean, point), self.dtype)
            gain = np.linalg.solve(h @ self.p @ h.T + r, h @ self.p).T
            x = mean + gain @ nu
            if np.abs(x - point).max() < 1e-12:
                break
        blocks = ["pose", *dict.fromkeys(names)]
        if self.design.state == "map first":
            blocks = blocks[::-1]
        at = np.concatenate([self.at[name] for name in blocks])
        numbers = np.repeat(ks, 2)[chosen] if rows is not None else np.array(ks)
        self.note(
            "update", "landmarks", nu, h[:, at], r, blocks, point=point[at], numbers=numbers,
            correction=(gain @ nu)[self.in_order()],
        )  # fmt: skip
        self.x = x
        self.p = self.updated(gain, h, r)

    def in_order(self) -> Array:
        """Return rows of all blocks as a recorder has them, in the order in which they began."""
        return np.concatenate([self.at[name] for name in self.began()])

    def began(self) -> list[str]:
        """Return blocks in the order in which they began, which `at` has."""
        return list(self.at)

    def updated(self, gain: Array, h: Array, r: Array) -> Array:
        """Return the covariance after an update."""
        p, form = self.p, self.design.covariance
        found: Array
        if form == "joseph":
            left = np.eye(len(p), dtype=self.dtype) - gain @ h
            found = left @ p @ left.T + gain @ r @ gain.T
            return found
        if form == "root":
            # QR of [R^1/2 0; S H' S], whose lower right block is the new root.
            root = np.linalg.cholesky(p)
            m = len(r)
            stack = np.block(
                [[np.linalg.cholesky(r).T, np.zeros((m, len(p)))], [root.T @ h.T, root.T]]
            )
            upper = np.asarray(np.linalg.qr(stack, mode="r"))[m:, m:]
            return np.asarray(upper.T @ upper, self.dtype)
        if form == "information":
            found = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h)
            return 0.5 * (found + found.T)
        found = p - gain @ h @ p
        return 0.5 * (found + found.T)

    def name(self, label: int) -> str:
        """Return the block of a label's landmark."""
        return f"landmark {label}"

    def initialise(self, k: int, label: int, source: str = "pose") -> None:
        """Add a landmark from a measurement at the pose, or at a clone of it."""
        v, name, z = self.at[source], self.name(label), self.log.z[k]
        pose = self.x[v].copy()
        c, s = np.cos(pose[2] + z[1]), np.sin(pose[2] + z[1])
        point = pose[:2] + z[0] * np.array([c, s])
        gx: Array = np.array([[1.0, 0.0, -z[0] * s], [0.0, 1.0, z[0] * c]]).astype(self.dtype)
        gz: Array = np.array([[c, -z[0] * s], [s, z[0] * c]]).astype(self.dtype)
        r: Array = np.diag(self.log.sigma[k] ** 2).astype(self.dtype)
        weight = {}
        if self.design.vast:
            gx, gz, r = np.zeros((2, 3)), np.eye(2), VAST_M**2 * np.eye(2)
            weight = {"weight": 0.0}
        self.note(
            "augment", name, gx, gz, r, [source], point=pose, after=point, numbers=k, **weight
        )
        across = np.zeros((len(self.x), 2)) if self.broken == "new" else self.p[:, v] @ gx.T
        self.append(name, point, across, gx @ self.p[np.ix_(v, v)] @ gx.T + gz @ r @ gz.T)
        self.uses[name] = 0
        if self.design.vast:
            self.fuse_known([(k, name)])
        else:
            self.uses[name] = 1

    def distance(self, k: int, name: str) -> float:
        """Return the innovation squared."""
        h, nu, r = self.linearised([k], [name], self.x)
        return float(nu @ np.linalg.solve(h @ self.p @ h.T + r, nu))

    def passes(self, k: int, name: str) -> bool:
        """Return whether the gate, if any, lets a measurement pass."""
        if not self.design.gate or self.distance(k, name) <= GATE[self.design.gate]:
            return True
        if self.design.recorded:
            at = np.concatenate((self.at["pose"], self.at[name]))
            h, nu, r = self.linearised([k], [name], self.x)
            point = self.x[at]
            self.note(
                "reject", "landmarks", nu, h[:, at], r, ["pose", name], point=point, numbers=k
            )
        return False

    def fuse_known(self, pairs: list[tuple[int, str]]) -> None:
        """Update by known landmarks, in the design's order."""
        design = self.design
        if design.order == "backward":
            pairs = pairs[::-1]
        elif design.order == "label":
            pairs = sorted(pairs, key=lambda pair: int(pair[1].split()[1]))
        elif design.order == "nearest":
            pairs = sorted(pairs, key=lambda pair: self.log.z[pair[0], 0])
        for k, name in pairs:
            self.last_s[name] = self.log.seen_s[k]
        if design.update in ("joint", "entries"):
            pairs = [pair for pair in pairs if self.passes(*pair)]
            if pairs:
                ks, names = [k for k, _ in pairs], [name for _, name in pairs]
                count = 2 * len(ks)
                ranges_first = np.concatenate((np.arange(0, count, 2), np.arange(1, count, 2)))
                self.known_update(ks, names, ranges_first if design.update == "entries" else None)
        for k, name in () if design.update in ("joint", "entries") else pairs:
            if not self.passes(k, name):
                continue
            if design.update == "landmark":
                self.known_update([k], [name])
            else:
                for entry in (1, 0) if design.bearing_first else (0, 1):
                    self.known_update([k], [name], np.array([entry]))
        for _, name in pairs:
            self.uses[name] += 1

    def labelled(self, ks: list[int]) -> list[int]:
        """Return labels: the log's or, without these, the nearest landmark's, or a new one's.

        A landmark that waits for its second measurement is known by the place of its first.
        """
        if self.log.label[ks[0]] >= 0:
            return [int(label) for label in self.log.label[ks]]
        found = list[int]()
        for k in ks:
            near = {
                name: self.distance(k, name) for name in self.uses if int(name[9:]) not in found
            }
            best = min(near, key=near.__getitem__, default="")
            if best and near[best] < NEAR:
                found.append(int(best[9:]))
                continue
            here = self.place(k)
            apart = {n: np.hypot(*(here - there)) for n, there in self.places.items()}
            label = min(apart, key=apart.__getitem__, default=-1)
            if label < 0 or apart[label] > NEAR_M or label in found:
                label = len(self.places)
                self.places[label] = here
            found.append(label)
        return found

    def place(self, k: int) -> Array:
        """Return where a measurement says that its landmark is."""
        pose, z = self.pose, self.log.z[k]
        there: Array = pose[:2] + z[0] * np.array([np.cos(pose[2] + z[1]), np.sin(pose[2] + z[1])])
        return there

    def fuse(self, ks: list[int]) -> None:
        """Use the measurements of an instant."""
        named = [
            (k, label, self.name(label)) for k, label in zip(ks, self.labelled(ks), strict=True)
        ]
        known = [(k, name) for k, _, name in named if name in self.at]
        new = [(k, label) for k, label, name in named if name not in self.at]
        if self.design.new_first:
            self.begin(new)
        if known:
            self.fuse_known(known)
        if not self.design.new_first:
            self.begin(new)

    def begin(self, new: list[tuple[int, int]]) -> None:
        """Initialise landmarks, or wait."""
        for k, label in new:
            if self.skipped.get(label, 0) < self.design.skip:
                self.skipped[label] = self.skipped.get(label, 0) + 1
            elif self.design.delayed and label not in self.waiting:
                clone = f"clone {label}"
                v = self.at["pose"]
                self.note("clone", "pose", clone)
                self.append(clone, self.x[v].copy(), self.p[:, v], self.p[np.ix_(v, v)])
                # A clone's rows are x, y, heading, as a recorder's are.
                self.waiting[label] = k, clone
            elif self.design.delayed:
                first, clone = self.waiting.pop(label)
                self.initialise(first, label, clone)
                self.remove(clone)
                self.fuse_known([(k, self.name(label))])
            else:
                self.initialise(k, label)

    # Run and output

    def run(self) -> Filter:
        """Filter the whole log."""
        log, now = self.log, self.log.meta["prior"]["time_s"]
        relative = log.meta["odometry"]["kind"] == "relative-poses"
        times = np.union1d(log.odometry_s, log.seen_s)
        for t in times[times >= now].tolist():
            if t > now:
                side: Literal["left", "right"] = "left" if relative else "right"
                sample = int(np.searchsorted(log.odometry_s, t if relative else now, side))
                self.predict(sample - (not relative), t - now, t)
            now = t
            ks = np.flatnonzero(log.seen_s == t).tolist()
            if ks or t == times[-1]:
                self.arrive(t)
            if ks:
                self.fuse(ks)
                self.forget(t)
            if self.composed is None:
                v = self.at["pose"]
                pose = self.pose
                if self.design.wrap == "output":
                    pose[2] = wrapped(pose[2])
                self.path.append((t, pose, self.p[np.ix_(v, v)].copy()))
        if not self.design.forget_s:
            for name in [n for n in self.uses if self.uses[n] < self.design.prune]:
                self.drop(name)
        for _, clone in self.waiting.values():
            self.remove(clone)
        return self

    def forget(self, t: float) -> None:
        """Remove landmarks of few measurements that were not measured for long."""
        if not self.design.forget_s:
            return
        for name in list(self.uses):
            old = t - self.last_s.get(name, t) > self.design.forget_s
            if self.uses[name] < self.design.prune and old:
                self.drop(name)

    def drop(self, name: str) -> None:
        """Remove a landmark."""
        self.remove(name)
        del self.uses[name]

    def write(self, folder: Path, *, traced: bool) -> None:
        """Write an estimate folder, in the order of docs/formats.md."""
        folder.mkdir(parents=True)
        rows = [
            (t, *pose[:2], 0.0, 0.0, 0.0, np.sin(0.5 * pose[2]), np.cos(0.5 * pose[2]))
            for t, pose, _ in self.path
        ]
        np.savetxt(folder / "trajectory.tum", rows, ["%.9f"] + ["%.17g"] * 7)
        names = list(self.uses)
        places = [(name.split()[1], *self.x[self.at[name]].tolist()) for name in names]
        lines = [f"{label},{px!r},{py!r}" for label, px, py in places]
        (folder / "landmarks.csv").write_text("\n".join(["id,x_m,y_m", *lines]) + "\n")
        order = np.concatenate([self.at[name] for name in ("pose", *names)])
        np.savez(
            folder / "covariances.npz",
            pose=np.array([p for _, _, p in self.path]),
            last_pose_and_landmarks=self.p[np.ix_(order, order)],
        )
        text = 'version = 1\ninformation = "filtered"\nestimator = "ekf"\n'
        (folder / "estimate.toml").write_text(text)
        if traced:
            with Recorder(folder / "filter.trace") as record:
                for call, matrices, more in self.calls:
                    getattr(record, call)(*matrices, **more)


FORMS: dict[str, Design] = {
    "joint": Design(),
    "joint, Joseph": Design(covariance="joseph"),
    "joint, square root": Design(covariance="root"),
    "joint, information form": Design(covariance="information"),
    "joint, ranges before bearings": Design(update="entries"),
    "by landmark": Design(update="landmark"),
    "by landmark, Joseph, backward": Design("landmark", "joseph", order="backward"),
    "by landmark, by label": Design("landmark", order="label"),
    "by landmark, nearest first, square root": Design("landmark", "root", order="nearest"),
    "scalars": Design("scalar"),
    "scalars, Joseph": Design("scalar", "joseph"),
    "scalars, square root, backward": Design("scalar", "root", order="backward"),
    "scalars, bearing first": Design("scalar", bearing_first=True),
    "map first": Design(state="map first"),
    "map first, scalars": Design("scalar", state="map first"),
    "heading first, by landmark": Design("landmark", state="heading first"),
    "heading in the middle, wrapped": Design(state="heading in the middle", wrap="state"),
    "headings wrapped in the output": Design(wrap="output"),
    "first dropped": Design(skip=1),
    "first dropped, scalars": Design("scalar", skip=1),
    "gate of 99 %": Design(gate=0.99),
    "gate of 99 %, by landmark, not recorded": Design("landmark", gate=0.99, recorded=False),
    "gate of 99 %, scalars": Design("scalar", gate=0.99),
    "first dropped, gate of 95 %": Design(skip=1, gate=0.95),
    "delayed by clones": Design(delayed=True),
    "delayed by clones, by landmark, Joseph": Design("landmark", "joseph", delayed=True),
    "pruned at the end": Design(prune=4),
    "pruned on the way, by landmark": Design("landmark", prune=4, forget_s=6.0),
    "another prior": Design(prior=0.01),
    "iterated": Design(rounds=5),
    "iterated, by landmark, Joseph": Design("landmark", "joseph", rounds=5),
    "single precision": Design(single=True),
    "single precision, scalars, Joseph": Design("scalar", "joseph", single=True),
    "noise of the two inputs alone": Design(two_inputs=True),
    "new landmarks vast": Design("landmark", vast=True),
    "new landmarks first": Design(new_first=True),
    "predictions composed": Design(composed=True),
    "predictions composed, scalars, first dropped": Design("scalar", composed=True, skip=1),
}
"""Each is right."""
BROKEN = ("cross", "sign", "noise", "new")
"""Covariance of pose and map not moved; sign of the heading's Jacobians; R divided by 4; a new
landmark without cross-covariance."""


# Logs


def unlabelled(log: ProjectLog) -> ProjectLog:
    """Take the labels away, and two landmarks of three, so that none are near each other."""
    seen = log.measurements.chosen(log.measurements.landmark % 3 == 0)
    nothing = np.full(len(seen.landmark), -1, dtype=np.int64)
    return replace(log, measurements=replace(seen, landmark=nothing))


def of_two_inputs(log: ProjectLog) -> ProjectLog:
    """Take the stabilisation noise away, where the two inputs have a noise of their own."""
    moved = log.odometry
    if isinstance(moved, RelativePoses) or not moved.noise.sigma_turn:
        return log
    noise = replace(moved.noise, variance_rate_position=0.0, variance_rate_heading=0.0)
    return replace(log, odometry=replace(moved, noise=noise))


def rovers(seed: int) -> ProjectLog:
    """A minute of a robot's drive among its landmarks (MR.CLAM), and another one's by seed."""
    start = 30.0 + 90.0 * (seed % 5)
    return cut_log(open_log(str(MRCLAM), robot=1 + seed % 2), start, start + 60.0)


LOGS: dict[str, Callable[[int], ProjectLog]] = {
    "velocity": lambda seed: drive(seed, "velocity", 120),
    "steering": lambda seed: drive(seed, "steering", 120),
    "relative poses": lambda seed: drive(seed, "poses", 120),
    "no labels": lambda seed: unlabelled(drive(seed, "velocity", 120)),
    "MR.CLAM": rovers,
}


class DesignResult(NamedTuple):
    """What `check` says of one design on one log. code: its exit code."""

    form: str
    log: str
    traced: bool
    broken: str
    code: int
    said: str


class Quick:
    """`check` without the searches that name a fault: they take long, and acquit few."""

    def __enter__(self) -> None:
        """Put nothing in their place."""
        job: Any = check_job
        self.kept = job.READINGS
        job.READINGS = [kind for kind in READINGS if kind not in (FAULT, MOTION)]

    def __exit__(self, *error: object) -> None:
        """Put them back."""
        job: Any = check_job
        job.READINGS = self.kept


def outcome(log: ProjectLog, folder: Path, solver: Any) -> tuple[int, str]:
    """Check an estimate folder; return the exit code and what is said first."""
    try:
        found = check(log, read_external(folder), CheckConfig(), solver=solver)
    except InputError as error:
        return 2, str(error).rpartition("/")[2]
    cause = next((f"{one.gap}: {one.evidence}" for one in found.causes), "")
    remarks = " | ".join(found.remarks)
    code = {"agree": 0, "disagree": 1}.get(found.outcome, 3)
    return code, f"{found.grade.value} {cause} || {remarks}"


def solved_once() -> Any:
    """Return a `solve` that keeps what it has solved, by log."""
    kept: list[tuple[ProjectLog, Any]] = []

    def solver(log: ProjectLog, *others: Any) -> Any:
        for other, solution in kept:
            if other is log:
                return solution
        kept.append((log, solve(log, *others)))
        return kept[-1][1]

    return solver


def results(
    names: Iterable[str],
    forms: Iterable[str],
    broken: Iterable[str],
    seed: int = 0,
    *,
    named: bool = False,
) -> Iterator[DesignResult]:
    """Yield what is said of each form on each log, traced or not, right or broken.

    named: whether the names of faults are looked for where that decides nothing.
    """
    for name in names:
        log, solver = LOGS[name](seed), solved_once()
        with tempfile.TemporaryDirectory() as place:
            write_log_folder(log, Path(place) / "log")
            write_log_folder(of_two_inputs(log), Path(place) / "bare")
            folders = [Path(place) / one for one in ("log", "bare")]
            logs = [(read_log(one), read_log_folder(one)) for one in folders]
            for form in forms:
                data, log = logs[FORMS[form].two_inputs]
                for error in broken:
                    run = Filter(FORMS[form], data, error).run()
                    for traced in (False, True):
                        folder = Path(place) / f"{form} {error} {traced}"
                        run.write(folder, traced=traced)
                        with nullcontext() if named or FORMS[form].setting else Quick():
                            found = outcome(log, folder, solver)
                        yield DesignResult(form, name, traced, error, *found)


if __name__ == "__main__":
    asked = options(__doc__, list=False, broken=False, names=False, log="", form="", seed=0)
    wrong = 0
    for one in results(
        [asked.log] if asked.log else LOGS,
        [asked.form] if asked.form else FORMS,
        BROKEN if asked.broken else ("",),
        int(asked.seed),
        named=asked.names,
    ):
        wrong += one.code != 0 if not one.broken else one.code == 0
        if asked.list or (one.code != 0) != bool(one.broken):
            kind = "traced" if one.traced else "alone"
            print(
                f"{one.log:<15}{one.form:<45}{kind:<7}{one.broken:<6}{one.code} {one.said}",
                flush=True,
            )
    print(f"{wrong} wrong")
    sys.exit(wrong > 0)
