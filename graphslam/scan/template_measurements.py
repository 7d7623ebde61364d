"""Templates of scans as landmarks, seen by the smoother's own matcher from its own estimate.

A template is a piece of one scan. Which landmarks there are, and which returns each was made of,
is data; where it is in later scans is found here: predicted from the joint covariance of all that
was measured so far, matched, and believed only within a gate. After each piece of the drive
everything is solved anew.

All alignments of one template share the noise of its points, which no factor between a pose and a
landmark can say. So as factors they are wider than the matcher's covariance says, by as much as one
return is wrong by.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import gtsam
import numpy as np
from scipy.spatial import cKDTree

from graphslam.arrays import Array, Mask
from graphslam.graph_builder import POSE_KEY, POSE_LANDMARK_KEY, build_graph, pose_landmarks_from
from graphslam.initialisation import extension
from graphslam.layout import Layout
from graphslam.marginals import joint_marginal, to_global
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import PoseLandmarkMeasurements, SlamProblem
from graphslam.running_estimate import RunningEstimate
from graphslam.scan import planar
from graphslam.scan.loop_closure import starts
from graphslam.scan.matchers import COARSE_M
from graphslam.scan.odometry import KissIcpOptions
from graphslam.scan.registration import Registration, ScanError, squared_distance
from graphslam.scan.template_matchers import Template, TemplateMatchers, lever_m

USED, INITIALISED = "used", "initialised"
APART = "does not meet the scan"
UNMATCHED = "not matched"
MISFIT = "does not fit"
AMBIGUOUS = "ambiguous"
GATED = "contradicts the estimate"
LEFT_OUT = "left out"


@dataclass(frozen=True, kw_only=True)
class TemplateOptions:
    """When a template is looked for and when a match is believed.

    reach_m: axes farther away are not looked for. per_scan: most templates matched with one scan,
    those first that were not seen for the longest. least_share: of a template's points that must
    have returns near them to be matched; only these are. least_overlap, most_residual_m, gate: of
    a match to believe; the gate is of three degrees of freedom, 99.9 %. piece: scans between two
    solutions.
    initialised_m: sigma of a new template along what its shape does not fix: of all axes that fit,
    its own is the one where it was taken. shared_m: sigma of one return, by which factors are wider
    than the matcher says.
    """

    reach_m: float = 50.0
    per_scan: int = 8
    least_share: float = 0.5
    least_overlap: float = 0.7
    most_residual_m: float = 0.35
    gate: float = 16.27
    piece: int = 5
    initialised_m: float = 0.05
    shared_m: float = 0.05

    @classmethod
    def suited(cls, settings: KissIcpOptions, sigma_m: float) -> Self:
        """For scans that suit these settings of scan odometry, each return sigma_m off."""
        residual_m = max(0.15, 0.4 * settings.refinement.reach_m)
        return cls(most_residual_m=residual_m, shared_m=sigma_m)


class PoseMeasurement(NamedTuple):
    """One, as in PoseLandmarkMeasurements."""

    pose: int
    landmark: int
    measured: Array
    covariance: Array


@dataclass(frozen=True)
class TemplateMeasurements:
    """What was found. alignments: of templates by number, the first of each being its beginning.

    factors: the same, wide enough to be taken as independent. reasons: how often a template near
    the scanner was USED, or why not.
    """

    alignments: PoseLandmarkMeasurements
    factors: PoseLandmarkMeasurements
    reasons: Counter[str] = field(default_factory=Counter)


def measure_templates(
    problem: SlamProblem,
    templates: Mapping[int, Template],
    clouds: Mapping[int, Array],
    matchers: TemplateMatchers,
    options: TemplateOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TemplateMeasurements:
    """Look for all templates in all scans, in the order of the drive.

    problem: whose pose landmarks are not read. templates: by number, all from 0 on.
    clouds: (M, 3) by the pose that they were seen from. progress: called with the poses done, of
    all.
    Raises graphslam.marginals.SingularProblemError.
    """
    drive = _Drive(
        replace(problem, pose_landmarks=PoseLandmarkMeasurements()), templates, matchers, options
    )
    initialised: dict[int, list[int]] = {}
    for number, template in templates.items():
        initialised.setdefault(template.pose, []).append(number)
    for pose in range(problem.pose_count):
        drive.move_to(pose)
        if pose in clouds or pose in initialised:
            progress(pose, problem.pose_count)
            try:
                cloud = clouds[pose]
            except (KeyError, ScanError):  # nothing to match; what began here was seen, though
                cloud = np.zeros((0, 3))
            drive.look(cloud)
            drive.begin(sorted(initialised.get(pose, [])), cloud)
    return TemplateMeasurements(drive.alignments(), drive.factors(), drive.reasons)


class _Drive:
    """What is known so far. pose: the last; running_estimate: of it and of `_known` templates."""

    def __init__(
        self,
        problem: SlamProblem,
        templates: Mapping[int, Template],
        matchers: TemplateMatchers,
        options: TemplateOptions | None,
    ) -> None:
        self._problem, self._templates, self._matchers = problem, templates, matchers
        self._options = options or TemplateOptions()
        self.reasons: Counter[str] = Counter()
        self._seen: list[PoseMeasurement] = []
        self._last: dict[int, int] = {}
        self._pose = 0
        self._running_estimate = RunningEstimate(problem.prior_pose, problem.prior_covariance)
        self._known = 0
        self._values = gtsam.Values()
        self._solved, self._since = 0, 0

    def factors(self) -> PoseLandmarkMeasurements:
        """All measurements so far, as the smoother's input."""
        seen = self.alignments()
        levers = {n: lever_m(self._templates[n].points) for n in np.unique(seen.landmark).tolist()}
        wider = np.array([levers[n] for n in seen.landmark.tolist()])
        shared = np.zeros((len(wider), 3, 3))
        shared[:, 0, 0] = shared[:, 1, 1] = self._options.shared_m**2
        shared[:, 2, 2] = (self._options.shared_m / wider) ** 2
        shared[np.unique(seen.landmark, return_index=True)[1]] = 0.0
        return replace(seen, covariance=seen.covariance + shared)

    def alignments(self) -> PoseLandmarkMeasurements:
        """All measurements so far, as they were matched, in order."""
        seen = self._seen
        return PoseLandmarkMeasurements(
            np.array([s.pose for s in seen], dtype=np.intp),
            np.array([s.landmark for s in seen], dtype=np.intp),
            np.array([s.measured for s in seen]).reshape(-1, 3),
            np.array([s.covariance for s in seen]).reshape(-1, 3, 3),
        )

    def move_to(self, pose: int) -> None:
        """By the odometry."""
        p = self._problem
        for k in range(self._pose, pose):
            self._running_estimate.move(p.increment[k], p.increment_covariance[k])
        self._pose = pose

    def begin(self, numbers: list[int], cloud: Array) -> None:
        """Templates taken from here."""
        for number in numbers:
            t = self._templates[number]
            spread = self._matchers.initialised(t, cloud, self._options.initialised_m)
            self._take(PoseMeasurement(self._pose, number, t.place, spread), INITIALISED)

    def look(self, cloud: Array) -> None:
        """Match what may be in view with the scan from here (N, 3)."""
        self._since += 1
        if self._since >= self._options.piece and len(self._last) > 0:
            self._solve()
        if not len(cloud):
            return
        tree = cKDTree(cloud)
        tried = 0
        for number in sorted(range(self._known), key=self._last.__getitem__):
            expected, spread = self._expected(number)
            near = self._near(number, expected, spread, tree)
            if np.mean(near) < self._options.least_share:
                continue
            if tried == self._options.per_scan:
                self.reasons[LEFT_OUT] += 1
                continue
            tried += 1
            found = self._match(self._templates[number].points[near], cloud, expected, spread)
            if isinstance(found, str):
                self.reasons[found] += 1
            else:
                self._take(
                    PoseMeasurement(self._pose, number, found.motion, found.covariance), USED
                )

    def _take(self, measurement: PoseMeasurement, reason: str) -> None:
        self._seen.append(measurement)
        self._last[measurement.landmark] = self._pose
        self.reasons[reason] += 1

    def _expected(self, number: int) -> tuple[Array, Array]:
        """(3,) the template's axis in the pose's frame, and its covariance (3, 3) in these axes."""
        at = 3 + 3 * number
        rows = np.concatenate((np.arange(3), np.arange(at, at + 3)))
        mean, covariance = self._running_estimate.mean, self._running_estimate.covariance
        return planar.relative(mean[:3], mean[at : at + 3], covariance[np.ix_(rows, rows)])

    def _near(self, number: int, expected: Array, spread: Array, tree: cKDTree) -> Mask:
        """(M,) which points of a template have returns near them; none of one out of reach."""
        o, points = self._options, self._templates[number].points
        if np.hypot(*expected[:2]) > o.reach_m:
            return np.zeros(len(points), dtype=bool)
        reach = COARSE_M + 2.0 * float(np.sqrt(np.trace(spread[:2, :2])))
        place = planar.moved(expected, points)
        near: Mask = np.isfinite(tree.query(place, distance_upper_bound=reach)[0])
        if near.mean() < o.least_share:
            self.reasons[APART] += 1
        return near

    def _match(
        self, points: Array, cloud: Array, expected: Array, spread: Array
    ) -> Registration | str:
        """A believable match of a template's points (M, 3), or the reason why there is none."""
        o = self._options
        found: list[Registration] = []
        reason = ""
        for start in starts(expected, spread, lever_m(points)):
            try:
                match = self._matchers.matcher(len(points)).match(points, cloud, start)
            except ScanError:
                reason = reason or UNMATCHED
                continue
            if match.overlap < o.least_overlap or match.residual_m > o.most_residual_m:
                reason = reason or MISFIT
            elif squared_distance(match, expected, spread) > o.gate:
                reason = reason or GATED
            else:
                found.append(match)
        if not found:
            return reason
        best = min(found, key=lambda match: match.residual_m)
        turn = planar.rotation(best.motion[2])
        own = turn @ best.covariance @ turn.T
        if any(squared_distance(other, best.motion, own) > o.gate for other in found):
            return AMBIGUOUS
        return best

    def _solve(self) -> None:
        """Everything up to the last pose anew, and the running estimate from it."""
        known = len(self._last)
        part = replace(self._problem, pose_landmarks=self.factors()).prefix(self._pose + 1)
        graph = build_graph(part)
        for s in self._seen:  # initialised where everything was solved the last time, after that
            if s.pose < self._solved and not self._values.exists(POSE_LANDMARK_KEY + s.landmark):
                here = self._values.atPose2(POSE_KEY + s.pose)
                place = here.compose(gtsam.Pose2(*s.measured))
                self._values.insert(POSE_LANDMARK_KEY + s.landmark, place)
        self._values.insert(extension(part, self._values, self._solved, self._pose + 1))
        self._values, *_ = levenberg_marquardt(graph, self._values, 1e-4, limit=5)
        here = self._values.atPose2(POSE_KEY + self._pose)
        keys = [POSE_KEY + self._pose, *range(POSE_LANDMARK_KEY, POSE_LANDMARK_KEY + known)]
        size = Layout(1, pose_landmarks=known).size
        local = joint_marginal(graph.linearize(self._values), keys, size).covariance
        places = pose_landmarks_from(self._values, part)
        mean = np.concatenate(([here.x(), here.y(), here.theta()], places.ravel()))
        self._running_estimate = RunningEstimate(mean, to_global(local, here.theta(), places[:, 2]))
        self._known, self._solved, self._since = known, self._pose + 1, 0
