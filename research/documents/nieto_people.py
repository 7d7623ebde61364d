"""Nieto 2005, section 3.7.1: SLAM among walking people, whose tracks only receive information.

The thesis has no numbers: world, noise and people are ours. The robot starts at a known place and
tells all landmarks and people apart. It sees all landmarks in every scan, and people until they
leave its reach; from then on a track is only predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure as Canvas
from scipy.linalg import block_diag

from comparisons.arrays import Array
from comparisons.report.figures.style import draw_reference, draw_trajectory
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR
from comparisons.statistics import mean_band, normalise
from ekf_reference.core.blocks import stack
from ekf_reference.core.geometry import Index, wrap_angle
from ekf_reference.core.state import Correction, KalmanState
from ekf_reference.models.motion import MotionStep, UnicycleModel
from ekf_reference.models.range_bearing import RangeBearing
from research.documents.claims import Claims, at_most, within
from research.documents.drawing import chart, plan
from research.documents.drives import Drives
from research.documents.interface import Experiment, Figure, Sources

_MODEL, _SENSOR = UnicycleModel(), RangeBearing()
_SCAN_S, _SCANS, _LANDMARKS, _PEOPLE = 0.2, 100, 16, 10
_CONTROL, _SIGMA_CONTROL = np.array((1.5, 0.15)), np.array((0.1, 0.03))
_SIGMA_Z = np.array((0.1, np.deg2rad(1.0)))
_REACH_M = 25.0
_WALK_MPS, _SPEED_MPS = 0.3, 0.7
"""Deviations of a person's speed: its change in a second, and at the start."""
_STEP = np.kron([[1.0, _SCAN_S], [0.0, 1.0]], np.eye(2))
_STEP_NOISE = _WALK_MPS**2 * np.kron(
    [[_SCAN_S**3 / 3.0, _SCAN_S**2 / 2.0], [_SCAN_S**2 / 2.0, _SCAN_S]], np.eye(2)
)
"""Of a person's place and speed (4,) from scan to scan; the speed is a random walk."""


class FullFilter:
    """Information flows both ways. state: the robot (3,), landmarks (2 L,), people (4 q,)."""

    def __init__(self, landmark: Array, person: Array) -> None:
        """landmark: (L, 2) and person: (q, 2) as they are seen from the known start."""
        (place, spread), (at, near) = _seen(landmark), _seen(person)
        own = [block_diag(one, _SPEED_MPS**2 * np.eye(2)) for one in near]
        mean = np.concatenate((np.zeros(3), place.ravel(), np.hstack((at, 0.0 * at)).ravel()))
        self.state = KalmanState(mean, block_diag(np.zeros((3, 3)), *spread, *own))
        self._rows = np.arange(3 + place.size, len(mean)).reshape(-1, 4)
        self._still = np.arange(3, 3 + place.size)

    @property
    def people(self) -> tuple[Array, Array]:
        """(q, 4) and their own covariances (q, 4, 4)."""
        rows = self._rows
        return self.state.mean[rows], self.state.covariance[rows[:, :, None], rows[:, None]]

    @property
    def kept(self) -> int:
        """Elements of the covariance that are kept."""
        return self.state.covariance.size

    def predict(self, step: MotionStep) -> None:
        """The robot moves as the wheels tell, people at random."""
        each, landmarks = np.eye(len(self._rows)), np.eye(len(self._still))
        by_control = step.jacobian_control * _SIGMA_CONTROL
        f = block_diag(step.jacobian_pose, landmarks, np.kron(each, _STEP))
        q = (by_control @ by_control.T, 0.0 * landmarks, np.kron(each, _STEP_NOISE))
        self.state.predict(np.append(step.pose, (f @ self.state.mean)[3:]), f, block_diag(*q))

    def see(self, z: Array) -> None:
        """All landmarks (L, 2)."""
        self._fuse(z, self._still)

    def see_people(self, which: Index, z: Array) -> None:
        """Some people (k,), as z (k, 2)."""
        self._fuse(z, self._rows[which, :2].ravel())

    def _fuse(self, z: Array, entry: Index) -> tuple[Index, Array, Correction]:
        """Fuse what is seen of places at these state entries (2 m,)."""
        at = _SENSOR.predict(self.state.pose[:3], self.state.mean[entry].reshape(-1, 2))
        columns = np.append(np.arange(3), entry)
        jacobian = stack(at.jacobian_pose, at.jacobian_landmark)
        noise = np.diag(np.tile(_SIGMA_Z**2, len(z)))
        gap = _SENSOR.innovation(z, at.z).ravel()
        return columns, jacobian, self.state.update(columns, jacobian, gap, noise)


class UnidirectionalFilter(FullFilter):
    """People receive information and give none (Example 3.3).

    The filter's state holds robot and landmarks, n entries. cross: (q, 4, n) covariance of people
    with these, own: (q, 4, 4); people's covariances with each other are not kept.
    """

    def __init__(self, landmark: Array, person: Array) -> None:
        """As the full filter starts."""
        self._mean, self._own = FullFilter(landmark, person).people
        super().__init__(landmark, person[:0])
        self._cross = np.zeros((len(person), 4, len(self.state.mean)))

    @property
    def people(self) -> tuple[Array, Array]:
        """(q, 4) and (q, 4, 4); copies."""
        return self._mean.copy(), self._own.copy()

    @property
    def kept(self) -> int:
        """Elements of the three blocks."""
        return super().kept + self._cross.size + self._own.size

    def predict(self, step: MotionStep) -> None:
        """All move, the covariance between them too."""
        super().predict(step)
        self._mean = self._mean @ _STEP.T
        self._own = _STEP @ self._own @ _STEP.T + _STEP_NOISE
        self._cross = _STEP @ self._cross
        self._cross[:, :, :3] = self._cross[:, :, :3] @ step.jacobian_pose.T

    def see(self, z: Array) -> None:
        """Landmarks correct people through their covariance with robot and landmarks."""
        before = self._cross
        columns, jacobian, made = self._fuse(z, self._still)
        share = before[:, :, columns] @ (made.inverse_root @ jacobian).T  # C H^T L^-T
        self._mean = self._mean + share @ made.whitened
        self._own = self._own - share @ share.mT
        self._cross = before - share @ made.gain_root

    def see_people(self, which: Index, z: Array) -> None:
        """Each corrects its own track alone; with its covariance to the rest that is exact."""
        cross, own = self._cross[which], self._own[which]
        at = _SENSOR.predict(self.state.pose[:3], self._mean[which, :2])
        robot, place = at.jacobian_pose, at.jacobian_landmark
        to_rest = robot @ self.state.covariance[:3] + place @ cross[:, :2]
        to_own = robot @ cross[:, :, :3].mT + place @ own[:, :2]
        spread = to_rest[:, :, :3] @ robot.mT + to_own[:, :, :2] @ place.mT + np.diag(_SIGMA_Z**2)
        root = np.linalg.inv(np.linalg.cholesky(spread))
        share = (root @ to_own).mT
        self._mean[which] += (share @ root @ _SENSOR.innovation(z, at.z)[:, :, None])[:, :, 0]
        self._own[which] = own - share @ share.mT
        self._cross[which] = cross - share @ root @ to_rest


def _seen(z: Array) -> tuple[Array, Array]:
    """Places (m, 2) seen as z (m, 2) from the start, which is known exactly, and (m, 2, 2)."""
    new = _SENSOR.invert(np.zeros(3), z)
    return new.landmark, new.jacobian_z @ np.diag(_SIGMA_Z**2) @ new.jacobian_z.mT


class Tracks(NamedTuple):
    """One filter, after each of T scans. kept: elements of its covariance.

    pose: (T, 3), with covariance: (T, 3, 3). person: (T, q, 4), with own: (T, q, 4, 4).
    """

    pose: Array
    covariance: Array
    person: Array
    own: Array
    kept: int

    @property
    def sigma_m(self) -> Array:
        """(T,) of the robot's place."""
        sigma: Array = np.sqrt(np.einsum("tii->t", self.covariance[:, :2, :2]))
        return sigma


@dataclass(frozen=True)
class PeopleDrive:
    """Both filters over the same measurements. pose, person, landmark: true, as in Tracks."""

    pose: Array
    person: Array
    landmark: Array
    full: Tracks
    one_way: Tracks


def people_drives(sources: Sources) -> Drives[PeopleDrive]:
    """Seeds from 0."""
    each = tuple(_drive(np.random.default_rng(seed)) for seed in range(sources.drives))
    return Drives(f"{_PEOPLE} people walk, {len(each)} simulated drives from seed 0", each)


def _drive(rng: np.random.Generator) -> PeopleDrive:
    landmark, start = rng.uniform(-20.0, 20.0, (_LANDMARKS, 2)), rng.uniform(-12, 12, (_PEOPLE, 2))
    person = np.hstack((start, _SPEED_MPS * rng.standard_normal(start.shape)))
    root, pose = np.linalg.cholesky(_STEP_NOISE), np.zeros(3)

    def seen(place: Array) -> Array:
        z = _SENSOR.predict(pose, place).z
        return z + _SIGMA_Z * rng.standard_normal(z.shape)

    first = seen(landmark), seen(person[:, :2])
    filters = FullFilter(*first), UnidirectionalFilter(*first)
    kept: tuple[list[tuple[Array, ...]], ...] = ([], [])
    true, there = [], np.ones(_PEOPLE, dtype=bool)
    for _ in range(_SCANS):
        pose = _MODEL.step(pose, _CONTROL, _SCAN_S).pose
        person = person @ _STEP.T + rng.standard_normal(person.shape) @ root.T
        control = _CONTROL + _SIGMA_CONTROL * rng.standard_normal(2)
        there &= np.linalg.norm(person[:, :2] - pose[:2], axis=1) <= _REACH_M
        near = np.flatnonzero(there)
        of_landmarks, of_people = seen(landmark), seen(person[near, :2])
        for one, rows in zip(filters, kept, strict=True):
            one.predict(_MODEL.step(one.state.pose[:3], control, _SCAN_S))
            one.see(of_landmarks)
            one.see_people(near, of_people)
            rows.append((one.state.pose[:3], one.state.pose_covariance[:3, :3], *one.people))
        true.append((pose, person))
    tracks = [
        Tracks._make((*map(np.array, zip(*rows, strict=True)), one.kept))
        for one, rows in zip(filters, kept, strict=True)
    ]
    poses, people = (np.array(column) for column in zip(*true, strict=True))
    return PeopleDrive(poses, people, landmark, *tracks)


def _claims_3_7_1(found: Drives[PeopleDrive]) -> Claims:
    drives = found.each
    gap = [(d.full.person - d.one_way.person)[:, :, :2].reshape(-1, 2) for d in drives]
    own = [d.one_way.own[:, :, :2, :2].reshape(-1, 2, 2) for d in drives]
    apart = normalise(np.concatenate(gap), np.concatenate(own))
    error = np.array([d.one_way.pose[-1] - d.pose[-1] for d in drives])
    error[:, 2] = wrap_angle(error[:, 2])
    robot = normalise(error, np.array([d.one_way.covariance[-1] for d in drives]))
    one = [d.one_way.person[-1, 0] - d.person[-1, 0] for d in drives]
    person = normalise(np.array(one), np.array([d.one_way.own[-1, 0] for d in drives]))
    rest, people = 3 + drives[0].landmark.size, drives[0].person[0].size
    ratio = np.mean([d.full.sigma_m / d.one_way.sigma_m for d in drives])
    text = (
        "people tell the robot little, as they walk at random (standard deviation of its place, "
        "full filter over unidirectional, mean of all scans and drives)"
    )
    yield within(text, ratio, (0.9, 1.0), own=True)
    text = "the tracks are the same (RMS difference of places along each axis, in their sigmas)"
    yield at_most(text, np.sqrt(np.mean(apart.squared) / 2.0), 0.3, own=True)
    for name, squared, dof in (("the robot", robot.squared, 3), ("a person", person.squared, 4)):
        text = (
            f"the unidirectional filter is consistent: {name} errs as stated (mean NEES at the "
            "end of the drives; limits: its 95 % band)"
        )
        yield within(text, np.mean(squared), mean_band(len(drives), dof))
    text = (
        "of the covariance N1 (N1 + N2) elements and each person's own are kept (number; "
        f"N1 = {rest}, N2 = {people}, of which a person has 4)"
    )
    yield at_most(text, max(d.one_way.kept for d in drives), rest * (rest + people) + 4 * people)
    text = "which costs less: elements that an update changes, over those of the full filter"
    yield at_most(text, max(d.one_way.kept / d.full.kept for d in drives), 0.5, own=True)


def _draw_3_7_1(canvas: Canvas, found: Drives[PeopleDrive]) -> None:
    left, right = canvas.subplots(1, 2, width_ratios=(1.2, 1.0))
    one = found.each[0]
    draw_reference(left, one.landmark, "*", "landmarks")
    draw_trajectory(left, one.one_way.pose, EKF_COLOUR, "robot")
    for k in range(one.person.shape[1]):
        names = ("people", "their tracks") if k == 0 else ("", "")
        draw_trajectory(left, one.person[:, k], TRUTH_COLOUR, names[0])
        draw_trajectory(left, one.one_way.person[:, k], SMOOTHER_COLOUR, names[1], "--")
    plan(left, "tracks of the unidirectional filter", legend="best")
    time_s = _SCAN_S * np.arange(1, len(one.pose) + 1)
    right.plot(time_s, one.full.sigma_m, color=SMOOTHER_COLOUR, label="full")
    right.plot(time_s, one.one_way.sigma_m, "--", color=EKF_COLOUR, label="unidirectional")
    right.set_ylim(bottom=0.0)
    chart(right, "standard deviation of the robot's place", "time [s]", "[m]")


FIGURES = (
    Figure(
        name="N3.7.1", title="People tracked by the unidirectional information flow",
        says="People walk at random and tell a robot that does SLAM nothing, while their tracks "
        "receive what it learns: covariances among people need not be kept.",
        experiment=Experiment("section 3.7.1", people_drives), draw=_draw_3_7_1,
        claims=_claims_3_7_1, size=(12.0, 5.4), place="section 3.7.1",
    ),
)  # fmt: skip
