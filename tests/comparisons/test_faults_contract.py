"""Contract: every sound filter and every known fault runs on every kind of log."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from comparisons.adapters.ekf_factory import build_ekf
from comparisons.adapters.filter_loop import FilterAttachment, FilterObservers, run_filter_loop
from comparisons.adapters.filter_variants import FirstEstimatesEkf
from comparisons.adapters.pose_landmark_measurements import PoseLandmarkRecorder
from comparisons.arrays import Array, Index
from comparisons.config import CheckConfig, SolveConfig
from comparisons.errors import InputError
from comparisons.estimates.reference import Reference
from comparisons.faults.catalogue import own_start
from comparisons.faults.fault import NONE, Fault, with_state
from comparisons.faults.tried import TriedFaults
from comparisons.fingerprints.trial import filter_with
from comparisons.logs.log import Log
from comparisons.logs.transforms.known_landmarks import SURVEYED
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import EKF, FILTERS, VARIANTS, filter_of
from comparisons.pipeline.solve import prepare_solve
from ekf_reference.core.ekf import NEW, Ekf
from ekf_reference.core.invariant_state import InvariantState
from ekf_reference.core.landmark_types import POINT, POSE, NewLandmarks
from ekf_reference.core.linearisation import FirstEstimates
from ekf_reference.core.state import FilterDivergedError, KalmanState
from ekf_reference.core.trace import Trace
from tests.comparisons.kinds_of_logs import MAPS, ODOMETRY, SURVEY_SIGMA_M
from tests.helpers import present

QUICK = (
    ("velocity", "some landmarks surveyed"),
    ("steering", "surveyed, and positions"),
    ("relative poses", "some surveyed, no labels"),
)
"""A log of each odometry; the others are slow only in sum."""
REFUSED = ("all landmarks surveyed", "positions alone", "dead reckoning")
"""Without a measurement of a landmark that is not surveyed."""
EVERY = [
    pytest.param(odometry, world, marks=() if (odometry, world) in QUICK else pytest.mark.slow)
    for odometry in ODOMETRY
    for world in MAPS
    if world not in REFUSED
]


def prepared(odometry: str, world: str) -> Prepared[SolveConfig]:
    """A log of a kind as the checks read it."""
    log = MAPS[world](ODOMETRY[odometry]())
    return prepare_solve(log, CheckConfig(gps="off" if log.positions is None else "on"))


@pytest.mark.parametrize("world", REFUSED)
def test_logs_without_a_landmark_to_map_are_refused(world: str) -> None:
    with pytest.raises(InputError, match="no measurements, expected at least one record"):
        prepared("velocity", world)


def every_fault(log: Log) -> Iterator[Fault]:
    """Without a number, and with one: every few of those that are tried."""
    tried = TriedFaults(log)
    yield from (*tried.single[::9], *tried.joined[::80])
    for family in tried.numbered[::6]:
        yield family.member(1.1 * family.neutral if family.factor else 0.01)
    yield own_start(log, 2.0 * log.prior.covariance)


def run(prepared: Prepared[SolveConfig], fault: Fault = NONE, name: str = EKF) -> Reference | None:
    """A filter with a fault over the log; None where it breaks down, which is no error."""
    times = prepared.filter_timeline.instants_s()
    return filter_with(fault, name, prepared, times, FilterObservers())


@pytest.mark.parametrize(("odometry", "world"), EVERY)
def test_every_sound_filter_runs(odometry: str, world: str) -> None:
    """And is near the EKF, by its last pose and its surveyed landmarks."""
    log = prepared(odometry, world)
    reference = present(run(log))
    sigma = np.sqrt(np.diag(reference.joint_covariance))[:3]
    for name in FILTERS:
        other = present(run(log, name=name))
        assert np.abs(other.pose[-1] - reference.pose[-1]).max() < 3.0 * sigma.max(), name
        table = log.log.known_landmarks
        if table is not None:
            count = len(table.id)
            assert other.landmark_id[:count].tolist() == (SURVEYED + table.id).tolist()
            off = np.abs(other.landmark[:count] - table.position_m)
            assert off.max() < 5.0 * SURVEY_SIGMA_M, name


@pytest.mark.parametrize(("odometry", "world"), EVERY)
def test_every_fault_runs(odometry: str, world: str) -> None:
    """A fault leaves surveyed landmarks in the map, and their ids."""
    log = prepared(odometry, world)
    table, ran = log.log.known_landmarks, 0
    for fault in every_fault(log.log):
        try:
            found = run(log, fault)
        except InputError:  # such as a measurement between poses: the search goes on
            continue
        ran += found is not None
        if found is not None and table is not None:
            assert found.landmark_id[: len(table.id)].tolist() == (SURVEYED + table.id).tolist()
    assert ran > 30


class Corners:
    """Sees a pose landmark at each epoch: of two in turn."""

    def look(self, ekf: Ekf, epoch: int, time_s: float, recorder: PoseLandmarkRecorder) -> None:
        mapped = len(ekf.state.layout.first[POSE])
        which = np.array([NEW if mapped < 2 else epoch % 2])
        z = np.array([[3.0, 1.0 - 2.0 * (epoch % 2), 0.1]])
        if mapped == 2:
            local = ekf.state.map_of(which, POSE)
            z = ekf.models[POSE].predict(local.pose, local.landmark).z + 1e-3
        recorder.observe(ekf, epoch, z, 1e-4 * np.eye(3)[None], which)


def with_pose_landmarks(
    log: Prepared[SolveConfig], kind: type[Ekf] = Ekf, fault: Fault = NONE
) -> Array:
    """The last mean of a filter that has landmarks of both kinds, and its size."""
    given = log.log if fault.feed is None else fault.feed(log.log)
    timeline = replace(log, log=given).filter_timeline
    plain = build_ekf(given, log.ekf, Trace())
    ekf = kind(plain.motion, plain.association, given.prior.pose, given.prior.covariance)
    ekf.stabilisation, ekf.fixes = plain.stabilisation, plain.fixes
    if fault.plant is not None:
        fault.plant(ekf)
    beside = FilterAttachment(source=Corners())
    with np.errstate(all="ignore"):
        for state in run_filter_loop(ekf, given, timeline, None, beside):
            assert state.fault is None
    assert len(ekf.state.layout.first[POSE]) == 2
    return np.array(ekf.state.mean)


def test_every_sound_filter_runs_with_pose_landmarks() -> None:
    log = prepared("velocity", "labels")
    reference = with_pose_landmarks(log)
    for name, kind in VARIANTS.items():
        found = with_pose_landmarks(log, kind)
        assert len(found) == len(reference), name
        assert np.abs(found[:3] - reference[:3]).max() < 0.5, name


def test_every_fault_runs_with_pose_landmarks() -> None:
    log, ran = prepared("velocity", "labels"), 0
    for fault in every_fault(log.log):
        try:
            with_pose_landmarks(log, fault=fault)
        except (InputError, FilterDivergedError, np.linalg.LinAlgError, AssertionError):
            continue
        ran += 1
    assert ran > 30


def updated(made: type[KalmanState]) -> tuple[Array, KalmanState]:
    """The mean before an update and the state after it, of a pose landmark and a point."""
    rng = np.random.default_rng(5)
    state = made(np.array([1.0, 2.0, 0.5]), np.diag((0.01, 0.02, 0.03)))
    landmarks = (POSE, [4.0, 3.0, 2.0]), (POSE, [1.0, -3.0, 0.0]), (POINT, [-2.0, 5.0])
    for kind, landmark in landmarks:
        new = NewLandmarks.independent(np.array([landmark]), 3)
        state.augment(new, 0.02 * np.eye(kind.width)[None], kind)
    before, every = state.mean.copy(), np.arange(11)
    state.update(every, rng.normal(size=(4, 11)), np.full(4, 0.3), 0.1 * np.eye(4))
    return before, state


def carried_by_group(made: type[KalmanState]) -> bool:
    """Whether places are turned with the map, and headings corrected as in the EKF."""
    before, plain = updated(KalmanState)
    state, error = updated(made)[1], plain.mean - before
    expected, turn = before + error, error[2]
    along = np.array([[np.sin(turn), np.cos(turn) - 1.0], [1.0 - np.cos(turn), np.sin(turn)]])
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    for x in (0, 3, 6, 9):
        place = before[x : x + 2]
        moved = error[x : x + 2] - turn * np.array([-place[1], place[0]])
        expected[x : x + 2] = spin @ place + along @ moved / turn
    return np.allclose(state.mean, expected, rtol=0.0, atol=1e-12)


class ByRows(InvariantState):
    """Broken: takes every entry behind the heading for one of a point."""

    def _places(self) -> Index:
        rows: Index = np.delete(np.arange(len(self.mean)), 2).reshape(-1, 2)
        return rows


def test_an_invariant_state_has_landmarks_of_both_kinds() -> None:
    assert carried_by_group(InvariantState)
    assert not carried_by_group(ByRows)


class OfNewOnes(FirstEstimatesEkf):
    """Broken: the first estimates of surveyed landmarks are not kept."""

    def insert_surveyed(self, point: Array, covariance: Array) -> None:
        assert isinstance(self.linearisation, FirstEstimates)
        before = dict(self.linearisation.first)
        super().insert_surveyed(point, covariance)
        self.linearisation.first = before


def test_what_takes_the_first_map_for_empty_is_rejected() -> None:
    """Each broken variant ends in an error that no search expects."""
    surveyed = prepared("velocity", "some landmarks surveyed")
    anew = Fault("the state is made anew", with_state(KalmanState))
    with pytest.raises(ValueError, match="broadcast"):
        run(surveyed, anew)
    instants_s = surveyed.filter_timeline.instants_s()
    with pytest.raises(IndexError):
        filter_of("first estimates of new ones alone", OfNewOnes, surveyed, instants_s)
