"""Runs of the reference EKF as events of an audit."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from comparisons.audit.own_filter import run_events, write_run
from comparisons.audit.replay import Replay
from comparisons.audit.spurious import Learnt, learnt
from comparisons.checks.spurious import SpuriousFinding
from comparisons.jobs.run import Comparison
from comparisons.logs.simulate.waypoints import WaypointRun, simulate
from comparisons.trace.events import (
    Augment,
    Directions,
    Event,
    Remove,
    Snapshot,
    TracePrior,
    Update,
)
from comparisons.trace.reader import TraceReader
from comparisons.trace.recorder import Recorder
from ekf_reference.core.landmark_types import POINT
from tests.comparisons.audit.test_spurious import by_definition
from tests.comparisons.test_ekf_run import initialised_boundless
from tests.comparisons.test_known_landmarks import with_survey
from tests.comparisons.test_pose_landmark_run import Frames
from tests.comparisons.test_pose_landmark_run import log as with_frames
from tests.helpers import Array, Source, compared, present, simulated


@cache
def sound() -> Comparison:
    return compared(simulated(seed=3, loop_s=40.0))


@cache
def framed() -> Comparison:
    """With pose landmarks, two of which are merged."""
    return compared(with_frames(), Source(Frames), filter="full", association="known")


def with_positions(name: str = "full") -> Comparison:
    log = simulate(np.random.default_rng(2), WaypointRun(most_s=40.0))
    return compared(log, filter=name, gps="on")


CASES: dict[str, Callable[[], Comparison]] = {
    "points": sound,
    "merged pose landmarks": framed,
    "positions": with_positions,
    "positions, four entries": lambda: with_positions("misono-full"),
    "updates in parts": lambda: compared(simulated(seed=3, loop_s=40.0), filter="misono"),
}


def all_learnt(c: Comparison) -> Learnt:
    return present(learnt(run_events(c.ekf)))


def at_the_end(events: list[Event]) -> tuple[Replay, Snapshot]:
    prior, *others = events
    replay = Replay(prior)  # type: ignore[arg-type]
    for event in others:
        replay.apply(event)
    last = events[-1]
    assert isinstance(last, Snapshot)
    return replay, last


def block(replay: Replay, snapshot: Snapshot) -> Array:
    rows = np.concatenate(
        [np.arange(replay.layout.size)[replay.layout.entries(b)] for b in snapshot.blocks]
    )
    found: Array = replay.covariance[np.ix_(rows, rows)]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_events_lead_to_the_filters_covariance(name: str) -> None:
    events = list(run_events(CASES[name]().ekf))
    assert [event.number for event in events] == list(range(len(events)))
    times = [event.time_s for event in events]
    assert times == sorted(times, key=lambda t: -1.0 if t is None else t)
    replay, last = at_the_end(events)
    sigma = np.sqrt(np.diag(last.covariance))
    apart = (block(replay, last) - last.covariance) / np.outer(sigma, sigma)
    assert np.abs(apart).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_a_run_learnt_is_what_its_equations_hold(name: str) -> None:
    """By one dense linear model of all noises."""
    c = CASES[name]()
    found = present(c.known.value(SpuriousFinding))
    east, north, heading = found.directions
    assert east.information == north.information == 0.0
    expected = by_definition(list(run_events(c.ekf)))[2, 2]
    assert np.isclose(heading.information, expected, rtol=1e-7)


def test_a_sensor_that_is_left_out_changes_what_was_learnt() -> None:
    """Merges that are not taken for blind."""
    events = [
        event._replace(blind=("measurements", "scan landmarks"))
        if isinstance(event, Directions)
        else event
        for event in run_events(framed().ekf)
    ]
    found = present(learnt(events))
    whole = all_learnt(framed()).directions[2]
    assert not np.isclose(found.directions[2].information, whole.information, rtol=1e-6)


def test_every_kind_of_event_is_there() -> None:
    sensors = {e.sensor for e in run_events(framed().ekf) if isinstance(e, Update)}
    assert sensors == {"measurements", "scan landmarks", "merges"}
    gone = [e for e in run_events(framed().ekf) if isinstance(e, Remove)]
    assert [e.blocks[0][:14] for e in gone] == ["scan landmark "]
    begun = [e for e in run_events(sound().ekf) if isinstance(e, Augment)]
    assert {len(present(e.numbers)) for e in begun} == {1}
    names = [e.name for e in begun]
    ids = sound().ekf.estimate.landmark_id
    assert names == [f"landmark {i}" for i in ids]
    positions = with_positions().ekf
    fixes = [e for e in run_events(positions) if isinstance(e, Update) and e.sensor == "positions"]
    assert len(fixes) == len(positions.fix_number)


def test_what_was_fused_together_is_one_update() -> None:
    """One a scan, of all that was measured there and known before."""
    run = sound().ekf
    updates = [e for e in run_events(run) if isinstance(e, Update)]
    assert len({e.time_s for e in updates}) == len(updates)
    assert sum(len(e.residual) for e in updates) == run.trace.measurements[POINT].innovation.size


@pytest.mark.slow
def test_a_boundless_prior_is_in_the_filters_own_equations() -> None:
    """A large one tells nothing; a small one holds landmarks to the world, which tells a turn."""
    c = initialised_boundless(1e8)
    usual = all_learnt(compared(simulated(seed=1, loop_s=30.0))).directions[2].information
    assert np.isclose(all_learnt(c).directions[2].information, usual, rtol=0.05)
    assert all_learnt(initialised_boundless(1e2)).directions[2].information > 1.1 * usual
    replay, last = at_the_end(list(run_events(c.ekf)))
    sigma = np.sqrt(np.diag(last.covariance))
    apart = (block(replay, last) - last.covariance) / np.outer(sigma, sigma)
    assert np.abs(apart).max() < 1e-6


def test_surveyed_landmarks_leave_no_blind_direction() -> None:
    c = compared(with_survey(simulated(seed=2, loop_s=30.0)))
    assert not any(isinstance(event, Directions) for event in run_events(c.ekf))


def same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return one == other


@pytest.mark.slow
def test_the_file_holds_the_same_events(tmp_path: Path) -> None:
    for number, c in enumerate((sound(), framed())):
        place = tmp_path / f"{number}.trace"
        write_run(c.ekf, place)
        for one, other in zip(run_events(c.ekf), TraceReader(place), strict=True):
            assert type(one) is type(other)
            assert all(map(same, one, other))
        found = present(learnt(TraceReader(place)))
        assert np.array_equal(found.information, all_learnt(c).information)


@pytest.mark.parametrize("correction", [None, np.array([0.1, -0.2])])
def test_a_correction_is_written_where_there_is_one(
    tmp_path: Path, correction: Array | None
) -> None:
    one, numbers = np.eye(2), np.zeros(1)
    prior = TracePrior(0, None, ("place",), (2,), one, np.zeros(2), ())
    measured = Update(
        1,
        None,
        "gps",
        ("place",),
        np.ones(2),
        one,
        one,
        True,
        correction,
        None,
        np.zeros(2),
        numbers,
    )
    with Recorder(tmp_path / "run.trace") as record:
        for event in (prior, measured):
            record.event(event)
    (_, read) = TraceReader(tmp_path / "run.trace")
    assert isinstance(read, Update)
    assert same(read.correction, correction)


def test_a_wrong_covariance_at_the_end_would_show() -> None:
    """The broken variant: an update is forgotten."""
    events = list(run_events(sound().ekf))
    at = next(i for i, e in enumerate(events) if isinstance(e, Update))
    replay, last = at_the_end(events[:at] + events[at + 1 :])
    assert not np.allclose(block(replay, last), last.covariance, rtol=1e-6, atol=0.0)
