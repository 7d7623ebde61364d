"""Nieto 2005, section 5.6: Scan-SLAM among objects, what it found and how far it is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.adapters.smoother_input import build_problem
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import assess, assess_trajectory
from comparisons.config import RunConfig, setting_default
from comparisons.documented.preset import published
from comparisons.errors import InputError
from comparisons.extensions.scan_landmarks.config import ScanLandmarksConfig
from comparisons.extensions.scan_landmarks.figure import place_covariances
from comparisons.extensions.scan_landmarks.result import in_words, template_rule
from comparisons.extensions.scan_landmarks.source import ScanSlamSource
from comparisons.jobs.run import run_filter
from comparisons.logs.log import Log, Poses
from comparisons.logs.simulate.scan_drive import scan_slam, simulate
from comparisons.pipeline.prepare import prepare
from comparisons.pipeline.prepared import Preparation, Prepared
from comparisons.report.marks import EKF_COLOUR, SMOOTHER_COLOUR, TRUTH_COLOUR, ellipses
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import rotation
from ekf_reference.core.landmark_types import POSE
from ekf_reference.scan_landmarks.scan_slam import ScanLandmarks
from graphslam.increments import dead_reckoned
from graphslam.scan import planar
from research.documents.claims import (
    Claim,
    Claims,
    at_least,
    at_most,
    elsewhere,
    ours,
    theirs,
)
from research.documents.drawing import SIGMAS, draw_lines, plan
from research.documents.drives import Drives, true_surroundings
from research.documents.interface import DocumentFigure, Experiment, Sources
from research.documents.measures import SHARE_WITHIN_3_SIGMA, mean, within_3_sigma

MOST_DRIVES = 3
"""A drive takes a minute, by the thesis' settings a minute and a half."""
CLOSED_S = 60.0
"""A landmark that was last seen so long ago is seen again because the loop is closed."""
END_M = 2.0
"""Farther off at the end a loop was missed, whatever was seen; objects are 4 m across and more."""
OURS = ScanLandmarksConfig(landmarks="scans")


@dataclass(frozen=True)
class ScanMap:
    """Scan landmarks at one instant, each row one of them.

    landmark_index: (Q,) among the filter's pose landmarks. place: (Q, 3) of the axes.
    covariance: (Q, 2, 2) of their places. true: (Q, 3) where the axes are, had the vehicle been
    where it was when it first saw them. points: of the templates, in their axes.
    """

    landmark_index: Index
    place: Array
    covariance: Array
    true: Array
    points: tuple[Array, ...]

    @property
    def placed(self) -> Array:
        """(P, 2) all points [m] as the map has them."""
        return _placed(self, self.place)

    @property
    def truly_placed(self) -> Array:
        """(P, 2) with every axis where it is."""
        return _placed(self, self.true)

    @property
    def rms_m(self) -> float:
        """Root mean square distance of the axes from where they are."""
        return float(np.sqrt(np.square(self.place - self.true)[:, :2].sum(axis=1).mean()))

    @property
    def within(self) -> NDArray[np.bool_]:
        """(Q,) whose true place is within 3 sigma of the estimate."""
        return within_3_sigma(self.place[:, :2] - self.true[:, :2], self.covariance)

    def at(self, rows: NDArray[np.bool_]) -> ScanMap:
        """Some of them (Q,)."""
        return ScanMap(
            self.landmark_index[rows],
            self.place[rows],
            self.covariance[rows],
            self.true[rows],
            tuple(p for p, chosen in zip(self.points, rows, strict=True) if chosen),
        )


@dataclass(frozen=True, kw_only=True)
class ScanDrive:
    """One drive.

    templates: the rule by which they were made. path, true_path: (K, 2), (T, 2). before: the map
    when it was about to be moved the most, at closing_s, as a rule by the loop's closing, and
    path_before up to there; after: in the end. ate_m, wheels_m: root mean square errors of the path
    and of odometry alone. end_m: distance from the truth at the end. again: measurements of
    landmarks that were out of sight for CLOSED_S. segment: (S, 4) true surfaces.
    """

    seed: int
    templates: str
    path: Array
    true_path: Array
    closing_s: float
    before: ScanMap
    path_before: Array
    after: ScanMap
    ate_m: float
    wheels_m: float
    end_m: float
    again: int
    segment: Array

    @property
    def closed(self) -> bool:
        """Old landmarks were seen again, and the end is where it is."""
        return self.again > 0 and self.end_m <= END_M

    @property
    def errors_m(self) -> tuple[float, float]:
        """Root mean squares of the landmarks that there were before; then, and in the end."""
        old = self.after.at(np.isin(self.after.landmark_index, self.before.landmark_index))
        return self.before.rms_m, old.rms_m


@dataclass(frozen=True)
class ScanDrives(Drives[ScanDrive]):
    """`shown` of them is drawn. published: the same logs, by the thesis' settings."""

    published: tuple[ScanDrive, ...]

    @property
    def shown(self) -> ScanDrive:
        """The one whose map the closing of its loop corrects the most, as the thesis shows one."""
        return min(self.each, key=lambda d: d.errors_m[1] / d.errors_m[0])

    @property
    def shown_published(self) -> ScanDrive:
        """The same log by the thesis' settings."""
        return next(d for d in self.published if d.seed == self.shown.seed)


class _Remembering:
    """Scan-SLAM, with the covariances as they were before the scan that moved the map the most."""

    def __init__(self, slam: ScanSlamSource) -> None:
        self.slam = slam
        self.covariance = np.zeros((0, 3, 3))

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        """See ScanSlamSource.look."""
        landmark_indices = ekf.state.layout.present(POSE)
        before, known = np.full((len(ekf.state.places(POSE)), 3, 3), np.nan), self.slam.closing
        if len(landmark_indices):
            before[landmark_indices] = ekf.state.map_of(landmark_indices, POSE).own
        self.slam.look(ekf, epoch, time_s, recorder)
        if self.slam.closing is not known:
            self.covariance = before


class _Remember(Preparation):
    """Lets the source of scan landmarks, which comes before it, remember."""

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Take the source's place."""
        slam = setup.find(ScanSlamSource)
        if slam is None:
            raise TypeError("there is no source of scan landmarks")
        setup.source = _Remembering(slam)
        setup.offers.append(setup.source)


def drives(sources: Sources) -> ScanDrives:
    """Table 5.1, seeds from 0, with the settings of runs and with the thesis'."""
    count = min(sources.drives, MOST_DRIVES)
    logs = [simulate(np.random.default_rng(seed), scan_slam()) for seed in range(count)]
    ours, thesis = (
        tuple(of_log(log, seed, config) for seed, log in enumerate(logs))
        for config in (OURS, published_config())
    )
    found = ScanDrives("", ours, thesis)
    reported = f"that of seed {found.shown.seed} drawn, whose map is corrected the most"
    rules = f"ours: {ours[0].templates}; the thesis': {thesis[0].templates}"
    return replace(found, log=f"scan-slam, {count} drives from seed 0, {reported}; {rules}")


def published_config() -> ScanLandmarksConfig:
    """Scan landmarks by all that the thesis says of them; the filter stays as it is in runs."""
    asked = {"extensions": {"scan_landmarks": OURS.model_dump(exclude_defaults=True)}}
    given = published("nieto-2005", asked, (), setting_default)
    return ScanLandmarksConfig.of(**given["extensions"]["scan_landmarks"])


def of_log(log: Log, seed: int = 0, settings: ScanLandmarksConfig | None = None) -> ScanDrive:
    """A log with scans and truth, driven. Raises InputError where no landmark is ever moved."""
    poses, segment = true_surroundings(log)
    config = RunConfig(extensions={"scan_landmarks": settings or OURS})
    prepared = prepare(log, config)
    watched = replace(prepared, extensions=(*prepared.extensions, _Remember()))
    run, setup = run_filter(watched)
    source = setup.find(_Remembering)
    if source is None or source.slam.closing is None or run.breakdown is not None:
        raise InputError(f"{log.name}: {run.breakdown or 'no scan moved a landmark'}")
    closing, found = source.slam.closing, source.slam.found
    estimate, problem = run.estimate, build_problem(prepared.log, run)
    wheels = dead_reckoned(problem.prior_pose, problem.increment)
    errors = assess(estimate, log, labelled=False), assess_trajectory(estimate.time_s, wheels, log)
    ate_m, wheels_m = (float("nan") if e is None or e.ate_m is None else e.ate_m for e in errors)
    after = scan_map(found, run, poses)
    still = np.isin(closing.landmark_index, after.landmark_index)
    old = closing.landmark_index[still]
    before = replace(
        after.at(np.isin(after.landmark_index, old)),
        place=closing.before[still],
        covariance=source.covariance[old, :2, :2],
    )
    then = estimate.time_s < closing.time_s
    off = estimate.pose[-1] - poses.at(estimate.time_s[-1:])[0]
    return ScanDrive(
        seed=seed,
        templates=in_words(template_rule(source.slam.options)),
        path=estimate.pose[:, :2],
        true_path=poses.pose[:, :2],
        closing_s=closing.time_s,
        before=before,
        path_before=estimate.pose[then, :2],
        after=after,
        ate_m=ate_m,
        wheels_m=wheels_m,
        end_m=float(np.hypot(*off[:2])),
        again=seen_again(run),
        segment=segment,
    )


def seen_again(run: EkfRun) -> int:
    """Measurements of landmarks that were out of sight for CLOSED_S."""
    time_s = run.estimate.time_s[run.pose_landmarks.pose]
    order = np.lexsort((time_s, run.pose_landmarks.landmark))
    gap, same = np.diff(time_s[order]), np.diff(run.pose_landmarks.landmark[order]) == 0
    return int(np.count_nonzero(same & (gap >= CLOSED_S)))


def scan_map(found: ScanLandmarks, run: EkfRun, poses: Poses) -> ScanMap:
    """Landmarks in the end, with where their axes are. poses: the vehicle's true ones."""
    estimate, seen = run.estimate, run.pose_landmarks
    landmark_index = np.asarray(estimate.pose_landmark_id, dtype=np.intp)
    first = first_measurements(run)[landmark_index]
    born = poses.at(estimate.time_s[seen.pose[first]])
    return ScanMap(
        landmark_index,
        estimate.pose_landmarks,
        place_covariances(estimate),
        true_axes(born, seen.measured[first]),
        tuple(found.template[k].shape.mean for k in landmark_index.tolist()),
    )


def first_measurements(run: EkfRun) -> Index:
    """(Q,) rows of the measurements by which the landmarks began."""
    return np.unique(run.pose_landmarks.landmark, return_index=True)[1]


def true_axes(pose: Array, z: Array) -> Array:
    """(Q, 3) where axes are that were measured as z (Q, 3) from the vehicle's true poses (Q, 3)."""
    each = [planar.compose(*both) for both in zip(pose, z, strict=True)]
    return np.array(each).reshape(-1, 3)


def _placed(held: ScanMap, place: Array) -> Array:
    moved = [planar.moved(at, points) for at, points in zip(place, held.points, strict=True)]
    return np.vstack([np.zeros((0, 2)), *moved])


def _claims_5_8(found: ScanDrives) -> Claims:
    ratio = [d.ate_m / d.wheels_m for d in found.each]
    fall = [now / then for then, now in (d.errors_m for d in found.each)]
    before, after = [d.before for d in found.each], [d.after for d in found.each]
    missed = ours(f"by drive {_each(fall)}; where the loop is missed the map stays as it drifted")
    text = (
        "the estimated path is close to the true one (RMS error over that of odometry alone, "
        "median of drives)"
    )
    yield at_most(text, np.median(ratio), 1.0).over(ratio)
    text = "before the loop closes the landmarks' errors are within their 3-sigma ellipses"
    yield _inside(text, before)
    yield _inside("and so they are after it", after)
    text = (
        "closing the loop reduces the error of the objects' places in every drive (RMS "
        "distance of the landmarks from the true ones, after over before, largest)"
    )
    yield at_most(text, max(fall), 1.0, why=missed).over(fall)
    yield _closed("every loop closes", found.each)
    yield from _by_the_thesis(found.published)


def _closed(text: str, drives: Sequence[ScanDrive]) -> Claim:
    missed = [f"{d.end_m:.2g} m off, {d.again} seen again" for d in drives if not d.closed]
    why = ours(f"missed: {'; '.join(missed)}")
    text = f"{text} (share of drives that see old landmarks again and end within {END_M:g} m)"
    return at_least(text, float(np.mean([d.closed for d in drives])), 1.0, why=why)


def _by_the_thesis(drives: Sequence[ScanDrive]) -> Claims:
    """What comes of the settings that the thesis states, on the same logs."""
    ratio = [d.ate_m / d.wheels_m for d in drives]
    landmarks = [len(d.after.landmark_index) for d in drives]
    form = elsewhere(
        f"by drive {_each(ratio)}, {min(landmarks)} to {max(landmarks)} landmarks: segments of "
        "30 returns (5.6 has no number for this drive, 5.7 has 100 on its car park) and the "
        "covariance of eqs. 5.16 and 5.17"
    )
    text = (
        "by the thesis' settings the path is close to the true one (RMS error over that of "
        "odometry alone, largest of the drives)"
    )
    yield at_most(text, max(ratio), 1.0, why=form).over(ratio)
    yield _closed("by the thesis' settings every loop closes", drives)
    text = (
        "by the thesis' settings the landmarks' errors are within their 3-sigma ellipses before "
        "the loop closes"
    )
    yield _inside(text, [d.before for d in drives])
    yield _inside("by the thesis' settings they are so after it", [d.after for d in drives])


def _inside(text: str, maps: list[ScanMap]) -> Claim:
    """Of all landmarks the share within 3 sigma; beside it the shares by map."""
    each = [m.within for m in maps if len(m.landmark_index)]
    shares = _each([float(np.mean(one)) for one in each])
    why = theirs(f"by drive {shares}: where the filter has drifted it is too sure")
    text = f"{text} (share of all drives' landmarks)"
    inside = np.concatenate([np.zeros(0, dtype=bool), *each])
    return at_least(text, mean(inside), SHARE_WITHIN_3_SIGMA, why=why)


def _each(value: list[float]) -> str:
    return ", ".join(f"{v:.2f}" for v in value)


EXPERIMENT = Experiment("section 5.6", drives)


_OBJECT_COLOUR = "#aaaaaa"


def _draw_5_8(canvas: Canvas, found: ScanDrives) -> None:
    left, right, thesis = canvas.subplots(1, 3, sharex=True, sharey=True)
    d, other = found.shown, found.shown_published
    _draw(left, d, d.before, d.path_before)
    _draw(right, d, d.after, d.path)
    then, now = d.errors_m
    plan(left, f"(a) before the loop closes, {d.closing_s:.0f} s; landmarks off by {then:.1f} m")
    plan(right, f"(b) after; the same landmarks off by {now:.1f} m (RMS)")
    _draw(thesis, other, other.after, other.path)
    ends = "closed" if other.closed else "missed"
    plan(
        thesis,
        f"(c) by the thesis' settings, {len(other.after.landmark_index)} landmarks, loop {ends}; "
        f"off by {other.after.rms_m:.1f} m",
    )
    canvas.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=6,
                  fontsize=9)  # fmt: skip


def _draw(axis: Axes, d: ScanDrive, held: ScanMap, path: Array) -> None:
    draw_lines(axis, d.segment.reshape(-1, 2, 2), _OBJECT_COLOUR, "objects", 1.2, 1)
    axis.plot(*d.true_path.T, "-", color=TRUTH_COLOUR, linewidth=1.0, label="true path")
    axis.plot(*path.T, "--", color=EKF_COLOUR, linewidth=1.0, label="estimated path")
    axis.plot(*held.placed.T, ".", color="#111111", markersize=1.0, label="templates", zorder=3)
    draw_lines(axis, axes_at(held.place, 4.0), SMOOTHER_COLOUR, "axes", 1.2, 4)
    outline = ellipses(held.place[:, :2], held.covariance, SIGMAS)
    draw_lines(axis, outline, SMOOTHER_COLOUR, "3 sigma", 0.8, 4)


def axes_at(place: Array, length_m: float) -> Array:
    """(Q, 3, 2) ahead's end, origin, left's end of axes at places (Q, 3)."""
    ends = length_m * np.array(((1.0, 0.0), (0.0, 0.0), (0.0, 1.0)))
    drawn = [ends @ rotation(float(at[2])).T + at[:2] for at in place]
    return np.array(drawn).reshape(-1, 3, 2)


FIGURES = (
    DocumentFigure(
        name="N5.8", title="Scan-SLAM among objects, before and after the loop closes",
        says="Pieces of scans serve as landmarks of an EKF; the estimated path follows the true "
        "one, and once the loop is closed the error between true and estimated objects is smaller.",
        experiment=EXPERIMENT, draw=_draw_5_8, claims=_claims_5_8, size=(21.0, 7.6),
    ),
)  # fmt: skip
