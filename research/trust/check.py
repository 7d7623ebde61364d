"""How `slamcheck check` grades external estimates that leave no trace, right and wrong ones.

    python -m research.trust.check [--quick] [--table]

Faults: exports of a sound filter's estimate, sound filters that were fed something else, and the
named ones of comparisons.faults, but those that show on other logs only; a filter that breaks
down hands in what it has until then. Sound: the EKF in other implementations, orders, precisions
and formats, other filters, and smoothers. --table prints every grade with its first reason.
--quick takes a drive of 30 s and every fourth estimate.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comparisons.adapters import filter_variants
from comparisons.adapters.ekf_factory import settle
from comparisons.adapters.ekf_run import run_ekf
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.adapters.reference_filter import FilterRun, run_reference
from comparisons.adapters.timeline import build_timeline
from comparisons.arrays import Array
from comparisons.config import EkfConfig, SmootherConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.estimate import landmark_blocks
from comparisons.estimates.external import ExternalEstimate, read_external
from comparisons.estimates.trajectory_files import FORMATS, Trajectory, write_trajectory
from comparisons.faults.algebra import other_gain
from comparisons.faults.catalogue import NAMED
from comparisons.faults.fault import StateChange, after
from comparisons.jobs.external_check import ExternalCheck
from comparisons.jobs.grading import check_external
from comparisons.logs.log import Log
from comparisons.logs.simulate.drive import Drive, simulate
from comparisons.pipeline.solve import Solution, solve
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.geometry import Index, wrap_angle
from research.script import options, present
from research.trust.defects import shows
from research.trust.exports import EXPORTS, FEEDS, with_landmarks, with_poses
from research.trust.row import PromiseRow, print_table

QUICK_S = 30.0
NO_COVARIANCES: dict[str, Any] = {"landmark_covariance": None, "joint_covariance": None}
"""Of the map."""
NO_MAP = {"landmark": None, "landmark_id": None, **NO_COVARIANCES}


class GradedEstimate(NamedTuple):
    """An estimate to be graded. like: it has to be found like a reference, not just not wrong."""

    name: str
    sound: bool
    make: Callable[[], ExternalEstimate]
    like: bool = False


@dataclass(frozen=True)
class CheckOutcome:
    """A case and what became of it; `refused` where the estimate could not be read or compared."""

    case: GradedEstimate
    grade: str
    by: str
    reason: str


def of_run(run: FilterRun | None, time_s: Array) -> ExternalEstimate:
    """What a filter knew at some times."""
    if run is None:
        raise InputError("the filter broke down")
    pose, covariance = run.at(time_s)
    return ExternalEstimate(
        time_s=time_s,
        pose=pose,
        landmark_id=run.map.landmark_id,
        landmark=run.map.landmark,
        pose_covariance=covariance,
        landmark_covariance=landmark_blocks(run.map.joint_covariance),
        joint_covariance=run.map.joint_covariance,
        information="filtered",
    )


def by_information(done: StateChange, columns: Index, h: Array, nu: Array, r: Array) -> None:
    """Update by inverses, P^-1 + H^T R^-1 H."""
    whole = np.zeros((len(h), len(done.p)))
    np.add.at(whole.T, columns, h.T)
    found = np.linalg.inv(np.linalg.inv(done.before) + whole.T @ np.linalg.inv(r) @ whole)
    done.p[:] = 0.5 * (found + found.T)


def rounded(done: StateChange, *_: Array) -> None:
    """Keep the covariance in single precision."""
    done.p[:] = done.p.astype(np.float32)


class IteratedThrice(filter_variants.IteratedEkf):
    """An iterated EKF that stops after three rounds."""

    most_iterations = 3


class Cases:
    """All estimates of one log."""

    def __init__(self, log: Log) -> None:
        """log: with labels; only a long one returns to landmarks after they were out of view."""
        self.shown = ("loop", "closing") if log.end_s > QUICK_S else ("loop",)
        self.log, self.config = log, settle(EkfConfig(), log)
        self.timeline = build_timeline(log)
        self.right = ExternalEstimate.of(run_ekf(log, self.timeline, self.config).estimate)

    def all(self) -> Iterator[GradedEstimate]:
        """Faults, then sound ones."""
        right = self.right
        for name, export in EXPORTS.items():
            yield GradedEstimate(f"export: {name}", False, partial(export, right))
        for name, feed in FEEDS.items():
            yield GradedEstimate(f"fed: {name}", False, partial(self._fed, feed))
        for defect in NAMED:
            if shows(defect) in self.shown and defect.plant is not None:
                yield GradedEstimate(
                    f"defect: {defect.name}", False, partial(self._filtered, defect.plant)
                )
        yield from self._filters()
        yield from self._exports()
        yield from self._smoothers()

    def _filtered(
        self, plant: Callable[[Ekf], None] = lambda ekf: None, **settings: str
    ) -> ExternalEstimate:
        config = settle(EkfConfig.of(**settings), self.log)
        setup = FilterSetup(modify=[plant])
        try:
            run = run_ekf(self.log, self.timeline, config, None, setup)
        except TypeError as error:  # a defect of another vehicle
            raise InputError(str(error)) from None
        return ExternalEstimate.of(run.estimate)

    def _known(
        self, time_s: Array, log: Log | None = None, kind: type[Ekf] = Ekf
    ) -> ExternalEstimate:
        """What a reference filter knew at some times, of this log or fed with another."""
        log = log or self.log
        return of_run(run_reference(log, build_timeline(log), self.config, kind=kind), time_s)

    def _fed(self, feed: Callable[[Log], Log]) -> ExternalEstimate:
        return self._known(self.right.time_s, feed(self.log))

    def _filters(self) -> Iterator[GradedEstimate]:
        yield GradedEstimate("the reference EKF", True, lambda: self.right, True)
        yield GradedEstimate("compressed", True, lambda: self._filtered(filter="compressed"), True)
        for name, plant, like in (
            ("Joseph form", other_gain(1.0), True),
            ("information form", after("update", by_information), True),
            ("computed in single precision", after("update", rounded), False),
        ):
            yield GradedEstimate(name, True, partial(self._filtered, plant), like)
        for name, kind in (
            ("sequential", filter_variants.SequentialEkf),
            ("sequential, backward", filter_variants.BackwardEkf),
            ("iterated", filter_variants.IteratedEkf),
            ("unscented", filter_variants.UnscentedEkf),
            ("iterated three times", IteratedThrice),
            ("unscented, wide", filter_variants.WideUnscentedEkf),
            ("landmarks initialised before the update", filter_variants.NewFirstEkf),
        ):
            yield GradedEstimate(
                name, True, partial(self._known, self.right.time_s, kind=kind), True
            )
        for name in ("compressed-suboptimal", "misono-full"):
            yield GradedEstimate(name, True, partial(self._filtered, filter=name))

    def _exports(self) -> Iterator[GradedEstimate]:
        right = self.right
        bare = ExternalEstimate(time_s=right.time_s, pose=right.pose)
        whole = single(right)
        last, backwards = len(right.time_s) - 1, np.arange(len(present(right.landmark)))[::-1]
        for name, given in (
            ("no covariances", replace(right, pose_covariance=None, **NO_COVARIANCES)),
            ("no joint covariance", replace(right, joint_covariance=None)),
            ("no map", replace(right, **NO_MAP)),
            ("another order of landmarks", with_landmarks(right, backwards)),
            ("headings between -pi and pi", replace(right, pose=wrapped(right.pose))),
            ("stored in single precision", whole),
            (
                "covariances in single precision",
                replace(whole, pose=right.pose, landmark=right.landmark),
            ),
            ("every fifth pose", with_poses(right, np.union1d(np.arange(0, last, 5), last))),
        ):
            yield GradedEstimate(name, True, partial(replace, given), True)
        samples = np.append(np.round(self.timeline.step_begin_s, 4), right.time_s)
        sampled = partial(self._known, np.unique(samples))
        yield GradedEstimate("at every odometry sample", True, sampled, True)
        yield GradedEstimate("resampled between poses", True, lambda: resampled(right))
        for name in FORMATS:
            yield GradedEstimate(f"a {name} file", True, partial(from_file, bare, name), True)
        rounded_path = replace(bare, time_s=np.round(bare.time_s, 6), pose=np.round(bare.pose, 6))
        yield GradedEstimate("TUM with six decimals", True, lambda: rounded_path, True)

    def _smoothers(self) -> Iterator[GradedEstimate]:
        def smoothed(**settings: str) -> ExternalEstimate:
            config = SolveConfig(smoother=SmootherConfig.of(**settings))
            return ExternalEstimate.of(solve(self.log, config).estimate)

        yield GradedEstimate("smoother", True, smoothed, True)
        path = partial(replace, pose_covariance=None, information=None, **NO_MAP)
        yield GradedEstimate("smoother, its path alone", True, lambda: path(smoothed()), True)
        yield GradedEstimate("smoother, dogleg", True, lambda: smoothed(optimiser="dogleg"), True)
        yield GradedEstimate("iSAM2", True, lambda: smoothed(method="isam2"))
        yield GradedEstimate("fixed lag", True, lambda: smoothed(method="fixed-lag"))


def wrapped(pose: Array) -> Array:
    """Poses (K, 3) with headings between -pi and pi."""
    return np.column_stack((pose[:, :2], wrap_angle(pose[:, 2])))


def single(given: ExternalEstimate) -> ExternalEstimate:
    """Every number but times as a float32."""
    names = ("pose", "landmark", "pose_covariance", "landmark_covariance", "joint_covariance")
    found = {name: getattr(given, name).astype(np.float32).astype(float) for name in names}
    return replace(given, **found)


def resampled(given: ExternalEstimate) -> ExternalEstimate:
    """Poses half way between those there are, by interpolation."""
    middle = 0.5 * (given.time_s[1:] + given.time_s[:-1])
    pose = 0.5 * (given.pose[1:] + given.pose[:-1])
    return ExternalEstimate(time_s=middle, pose=pose)


def from_file(given: ExternalEstimate, format_name: str) -> ExternalEstimate:
    """Written and read."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "path.txt"
        write_trajectory(Trajectory(given.time_s, given.pose), path, format_name)
        return read_external(path)


def grade(case: GradedEstimate, solution: Solution) -> CheckOutcome:
    """Grade an estimate."""
    try:
        found = check_external(case.make(), solution)
    except (InputError, np.linalg.LinAlgError) as error:
        return CheckOutcome(case, "refused", "", str(error))
    by = found.grade.by
    name = by.reference.name if by is not None and by.grade is not None else ""
    return CheckOutcome(case, found.grade.value or "none", name, reason(found))


def reason(found: ExternalCheck) -> str:
    """The first cause, or what stands beside."""
    if found.causes:
        return f"{found.causes[0].gap}: {found.causes[0].evidence}"
    return next((remark for remark in found.remarks if remark.startswith("plausible")), "")


def outcomes(log: Log, every: int = 1) -> Iterator[CheckOutcome]:
    """Grade the estimates of a log, one in so many of them."""
    solution = solve(log)
    for case in islice(Cases(log).all(), None, None, every):
        yield grade(case, solution)


def summary(found: list[CheckOutcome], log: str) -> list[PromiseRow]:
    """What was promised, and what holds."""
    faults = [one for one in found if not one.case.sound and one.grade != "refused"]
    refused = sum(not one.case.sound for one in found) - len(faults)
    sound = [one for one in found if one.case.sound]
    passed = [one.case.name for one in faults if one.grade in ("like", "equal")]
    wrong = [one.case.name for one in sound if one.grade in ("wrong", "none", "refused")]
    akin = [one for one in sound if one.case.like]
    unlike = [one.case.name for one in akin if one.grade not in ("like", "equal")]
    counts = Counter(one.grade for one in faults)
    shown = ", ".join(f"{count} {name}" for name, count in counts.items())
    return [
        PromiseRow(
            f"faults without a trace are below like ({log})",
            "at least 95 %",
            f"{len(faults) - len(passed)} of {len(faults)} ({shown}"
            + (f"; {refused} more left no estimate" if refused else "")
            + ")"
            + (f"; not: {', '.join(passed)}" if passed else ""),
            len(passed) <= 0.05 * len(faults),
        ),
        PromiseRow(
            f"no sound estimate is wrong ({log})",
            "none",
            f"{len(wrong)} of {len(sound)}" + (f": {', '.join(wrong)}" if wrong else ""),
            not wrong,
        ),
        PromiseRow(
            f"sound estimates of the references' kinds are like one ({log})",
            "all",
            f"{len(akin) - len(unlike)} of {len(akin)}"
            + (f"; not: {', '.join(unlike)}" if unlike else ""),
            not unlike,
        ),
    ]


def rows(quick: bool = False, *, table: bool = False) -> list[PromiseRow]:
    """The rows of the table of trust: the simulated loop at a third of its noise; quick on 30 s."""
    loop_s = QUICK_S if quick else 85.0
    log = simulate(np.random.default_rng(0), Drive(noise_scale=0.3, loop_s=loop_s))
    found = []
    for one in outcomes(log, every=4 if quick else 1):
        found.append(one)
        if table:
            kind = "sound" if one.case.sound else "fault"
            print(f"{kind} {one.case.name:<46} {one.grade:<9} {one.by or one.reason}", flush=True)
    return summary(found, "simulated-loop, noise 0.3")


if __name__ == "__main__":
    asked = options(__doc__, quick=False, table=False)
    sys.exit(print_table(rows(asked.quick, table=asked.table)))
