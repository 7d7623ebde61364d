"""A drive past points and pose landmarks, the latter associated by hand."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import NEW, Ekf, Stabilisation
from ekf_reference.core.geometry import Array
from ekf_reference.core.landmark_types import (
    POINT,
    POSE,
    LandmarkKind,
    NewLandmarks,
    PredictedMeasurements,
)
from ekf_reference.core.trace import Trace
from ekf_reference.filters.compressed import CompressedEkf, CompressedState, LocalAreas
from ekf_reference.models.motion import UnicycleModel
from ekf_reference.models.relative_pose import RelativePose
from ekf_reference.scan_landmarks.merging import merge_landmarks

RADIUS_M, RANGE_M, STEP_S = 15.0, 11.0, 0.5
AREAS = LocalAreas(half_m=5.0, reach_m=11.0)
CONTROL = np.array([2.0, 2.0 / RADIUS_M])
Q = np.diag((0.02, 0.002)) ** 2
SIGMA = np.array([0.03, 0.003])
PRIOR = np.diag((0.02, 0.03, 0.004)) ** 2
_ANGLE = np.arange(0.0, 2.0 * np.pi, 2.0 * np.pi / 9.0)
POINTS = np.column_stack(((RADIUS_M + 4.0) * np.cos(_ANGLE), (RADIUS_M - 3.0) * np.sin(_ANGLE)))
FRAMES = np.column_stack(
    ((RADIUS_M - 5.0) * np.cos(_ANGLE + 0.3), (RADIUS_M + 3.0) * np.sin(_ANGLE + 0.3), 2.5 * _ANGLE)
)
DUPLICATES = (1, 2)
"""Of the frames, two that will turn out to lie on one thing."""


@dataclass
class Script:
    """What happens in a drive.

    order: of the kinds at one stop. noise: scale of all that is drawn. fuse_at, remove_at: steps.
    """

    steps: int = 140
    order: str = "points first"
    noise: float = 1.0
    fuse_at: int = -1
    remove_at: int = -1


@dataclass
class Made:
    """What a drive led to. known: landmark index of each frame. The rest is a smoother's input."""

    truth: Array
    steps: int
    known: dict[int, int] = field(default_factory=dict)
    seen: list[tuple[int, int, Array, Array]] = field(default_factory=list)
    points_seen: list[tuple[int, int, Array]] = field(default_factory=list)
    fused: list[tuple[int, int, int, Array, Array]] = field(default_factory=list)
    label_of: dict[int, int] = field(default_factory=dict)


def relative(base: Array, frame: Array) -> Array:
    """`frame` in `base`, both (3,), by complex numbers."""
    place = (frame[0] - base[0] + 1j * (frame[1] - base[1])) * np.exp(-1j * base[2])
    return np.array([place.real, place.imag, np.angle(np.exp(1j * (frame[2] - base[2])))])


def composed(base: Array, shift: Array) -> Array:
    """A frame in `base`, both (3,), in the frame that `base` is in."""
    place = base[0] + 1j * base[1] + (shift[0] + 1j * shift[1]) * np.exp(1j * base[2])
    return np.array([place.real, place.imag, base[2] + shift[2]])


def covariance_of(rng: np.random.Generator) -> Array:
    """A measurement's, correlated."""
    root = np.diag((0.03, 0.04, 0.004)) @ (np.eye(3) + 0.4 * rng.uniform(-1.0, 1.0, (3, 3)))
    spread: Array = root @ root.T
    return spread


def build(kind: str = "full", trace: Trace | None = None, make: Callable[..., Ekf] = Ekf) -> Ekf:
    """A filter at the start of the circle."""
    common = (
        UnicycleModel(),
        KnownAssociation(),
        np.array([RADIUS_M, 0.0, 0.5 * np.pi]),
        PRIOR,
        Stabilisation(1e-8, 1e-10),
        trace,
    )
    if kind == "compressed":
        return CompressedEkf(*common, AREAS)
    return make(*common)


def drive(ekf: Ekf, seed: int, script: Script | None = None) -> Made:
    """Drive a filter; the draws are the same for all filters."""
    return _Tour(ekf, seed, script or Script()).drive()


class _Tour:
    """One drive."""

    def __init__(self, ekf: Ekf, seed: int, script: Script) -> None:
        self.ekf, self.script, self.rng = ekf, script, np.random.default_rng(seed)
        self.made = Made(ekf.read_pose().pose + self.draw(PRIOR), script.steps)
        self.gone: set[int] = set()
        self.gone_points: set[int] = set()

    def draw(self, covariance: Array) -> Array:
        root = np.linalg.cholesky(covariance)
        value: Array = self.script.noise * root @ self.rng.standard_normal(len(covariance))
        return value

    def drive(self) -> Made:
        model, drift = UnicycleModel(), Stabilisation(1e-8, 1e-10)
        kinds = {
            "points first": ((self.points, self.frames),) * 2,
            "frames first": ((self.frames, self.points),) * 2,
            "in turn": ((self.points, self.frames), (self.frames, self.points)),
            "frames only": ((self.frames,),) * 2,
        }[self.script.order]
        for k in range(1, self.script.steps + 1):
            arrived = model.step(self.made.truth, CONTROL + self.draw(Q), STEP_S).pose
            self.made.truth = arrived + self.draw(drift.covariance(STEP_S, arrived))
            self.ekf.predict(CONTROL, Q, STEP_S)
            for look in kinds[k % 2]:
                look(k)
            if k == self.script.fuse_at:
                self.fuse(k)
            if k == self.script.remove_at:
                self.remove()
        return self.made

    def points(self, k: int) -> None:
        offset = POINTS - self.made.truth[:2]
        near = np.flatnonzero(np.hypot(*offset.T) < RANGE_M).tolist()
        label = np.array([i for i in near if i not in self.gone_points], dtype=np.int64)
        d = offset[label]
        bearing = np.arctan2(d[:, 1], d[:, 0]) - self.made.truth[2]
        z = np.column_stack((np.hypot(*d.T), bearing))
        z += self.script.noise * SIGMA * self.rng.standard_normal(z.shape)
        landmark_indices = self.ekf.observe(z, np.tile(SIGMA, (len(z), 1)), label).tolist()
        self.made.points_seen += [(k, s, at) for s, at in zip(landmark_indices, z, strict=True)]
        self.made.label_of.update(zip(landmark_indices, label.tolist(), strict=True))

    def frames(self, k: int) -> None:
        near = np.flatnonzero(np.hypot(*(FRAMES[:, :2] - self.made.truth[:2]).T) < RANGE_M).tolist()
        which = [i for i in near if i not in self.gone]
        if not which:
            return
        r = np.array([covariance_of(self.rng) for _ in which])
        places = [relative(self.made.truth, FRAMES[i]) for i in which]
        z = np.array([at + self.draw(c) for at, c in zip(places, r, strict=True)])
        landmark_index = np.array([self.made.known.get(i, NEW) for i in which], dtype=np.intp)
        found = self.ekf.observe_known(z, r, landmark_index, POSE).tolist()
        self.made.known.update(zip(which, found, strict=True))
        self.made.seen += [(k, s, at, c) for s, at, c in zip(found, z, r, strict=True)]

    def fuse(self, k: int) -> None:
        first, second = (self.made.known[i] for i in DUPLICATES)
        r = covariance_of(self.rng)
        z = relative(FRAMES[DUPLICATES[0]], FRAMES[DUPLICATES[1]]) + self.draw(r)
        self.made.fused.append((k, first, second, z, r))
        merge_landmarks(self.ekf, first, second, z, r)
        self.gone.add(DUPLICATES[1])

    def remove(self) -> None:
        self.gone.add(0)
        self.ekf.remove(np.array([self.made.known[0]]), POSE)
        if self.script.order != "frames only":
            landmark_index = sorted(self.made.label_of)[1]
            self.gone_points.add(self.made.label_of[landmark_index])
            self.ekf.remove(np.array([landmark_index]))


def error(ekf: Ekf, made: Made) -> Array:
    """Of the whole state, in its own order; headings wrapped."""
    layout, mean = ekf.state.layout, ekf.state.mean
    off = np.empty(len(mean))
    off[:3] = ekf.state.pose - made.truth
    for landmark_index in layout.present():
        at = layout.first[POINT][landmark_index]
        off[at : at + 2] = mean[at : at + 2] - POINTS[made.label_of[int(landmark_index)]]
    angles = [2]
    frame_of = {landmark_index: frame for frame, landmark_index in made.known.items()}
    for landmark_index in layout.present(POSE):
        at = layout.first[POSE][landmark_index]
        off[at : at + 3] = mean[at : at + 3] - FRAMES[frame_of[int(landmark_index)]]
        angles.append(int(at) + 2)
    off[angles] = np.angle(np.exp(1j * off[angles]))
    return off


class Unwrapped(RelativePose):
    """Headings are not wrapped."""

    def innovation(self, z: Array, predicted: Array) -> Array:
        return z - predicted


class Flipped(RelativePose):
    """The heading's column of the Jacobian, as by the pose, with its sign flipped."""

    def predict(self, pose: Array, landmarks: Array) -> PredictedMeasurements:
        at = super().predict(pose, landmarks)
        by_pose = at.jacobian_pose.copy()
        by_pose[:, :2, 2] *= -1.0
        return at._replace(jacobian_pose=by_pose)


class NoRows(CompressedState):
    """Broken: pose landmarks are added as if they knew nothing of the passive ones."""

    def augment(self, new: NewLandmarks, noise: Array, kind: LandmarkKind = POINT) -> None:
        super().augment(new, noise, kind)
        if kind == POSE:
            self._phi[-new.landmark.size :] = 0.0
