"""A sound filter's events in a planar log, drawn otherwise: `check` always comes to an end.

`python -m tests.fuzz.planar_sequences 500` draws so many. Where only what a filter may do is drawn
(more snapshots or fewer, blocks that come and go, a measurement entry by entry, rejected ones), the
estimate stays equal to the references. Else events are lost, doubled, exchanged or spoilt.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from comparisons.audit.own_filter import run_events
from comparisons.audit.replay import Replay
from comparisons.config import CheckConfig
from comparisons.errors import InputError
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import write_estimate
from comparisons.estimates.planar_trace import TRACE
from comparisons.jobs.check import check
from comparisons.logs.log import Log
from comparisons.pipeline.solve import Solution, solve
from comparisons.report.check import CheckReport
from comparisons.trace.events import Clone, Event, Remove, Reset, Snapshot, TracePrior, Update
from comparisons.trace.recorder import Recorder
from tests.fuzz.drawn import Ending, try_all
from tests.helpers import compared, first_seconds, simulated

Change = Callable[[list[Event], np.random.Generator], list[Event]]


def write(events: Iterable[Event], path: Path) -> None:
    """Record events, of any kind, again."""
    with Recorder(path, synced=False) as record:
        for event in events:
            record.event(event)


def replayed(events: list[Event], count: int) -> Replay:
    """What the first events lead to."""
    prior, *others = events[:count]
    assert isinstance(prior, TracePrior)
    replay = Replay(prior)
    for event in others:
        replay.apply(event)
    return replay


def _place(events: list[Event], rng: np.random.Generator) -> int:
    return int(rng.integers(1, len(events)))


def more_snapshots(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """Of all blocks, or of the pose, or of blocks in another order."""
    count = _place(events, rng)
    replay = replayed(events, count)
    blocks = tuple(replay.layout.dims)
    if rng.random() < 0.5:
        blocks = tuple(str(name) for name in rng.permutation(blocks)[: rng.integers(1, 3)])
    at = replay.layout.columns(blocks)
    p = replay.covariance[at][:, at]
    snapshot = Snapshot(0, events[count - 1].time_s, blocks, p, None, None)
    return [*events[:count], *[snapshot] * int(rng.integers(1, 4)), *events[count:]]


def fewer_snapshots(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """Some are left out."""
    return [one for one in events if not isinstance(one, Snapshot) or rng.random() < 0.5]


def a_clone(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """Of the pose; it is removed some events later, and no snapshot of all is between."""
    count = _place(events, rng)
    pose = next(iter(replayed(events, count).layout.dims))
    last = min(len(events), count + int(rng.integers(0, 3)))
    if any(isinstance(one, Snapshot) for one in events[count:last]):
        last = count
    if not all(getattr(one, "correction", None) is None for one in events[count:last]):
        last = count
    time_s = events[count - 1].time_s
    clone, gone = Clone(0, time_s, "clone", pose), Remove(0, time_s, ("clone",))
    later = gone._replace(time_s=events[last - 1].time_s)
    return [*events[:count], clone, *events[count:last], later, *events[last:]]


def an_idle_reset(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """That changes no coordinate; no planar filter has one."""
    count = _place(events, rng)
    name, dim = next(iter(replayed(events, count).layout.dims.items()))
    reset = Reset(0, events[count - 1].time_s, (name,), np.eye(dim))
    return [*events[:count], reset, *events[count:]]


def a_rejection(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """A measurement that is fused is tried once more before, far off, and is rejected."""
    places = [k for k, one in enumerate(events) if isinstance(one, Update)]
    if not places:
        return events
    count = int(rng.choice(places))
    update = events[count]
    assert isinstance(update, Update)
    off = update._replace(residual=update.residual + 100.0, used=False, numbers=None, point=None)
    return [*events[:count], off, *events[count:]]


def _changed(events: list[Event], rng: np.random.Generator) -> tuple[int, Event]:
    count = _place(events, rng)
    return count, events[count]


def a_loss(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """An event is left out."""
    count, _ = _changed(events, rng)
    return [*events[:count], *events[count + 1 :]]


def a_double(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """An event stands twice."""
    count, event = _changed(events, rng)
    return [*events[:count], event, *events[count:]]


def an_exchange(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """Two events are exchanged; times stay where they are."""
    i, j = sorted(_place(events, rng) for _ in range(2))
    changed = list(events)
    changed[i] = events[j]._replace(time_s=events[i].time_s)
    changed[j] = events[i]._replace(time_s=events[j].time_s)
    return changed


def a_spoilt_matrix(events: list[Event], rng: np.random.Generator) -> list[Event]:
    """One field of an event is zero, larger, negative, mirrored or a unit matrix."""
    count, event = _changed(events, rng)
    fields = event._asdict().items()
    names = [name for name, field in fields if isinstance(field, np.ndarray) and field.size]
    if not names:
        return events
    name = str(rng.choice(names))
    field = np.array(getattr(event, name), dtype=float)
    kinds: list[Callable[[np.ndarray], np.ndarray]] = [
        np.zeros_like,
        lambda x: x * float(10.0 ** rng.uniform(-20, 20)),
        lambda x: -x,
        lambda x: x[::-1].copy(),
        lambda x: x + 0.1 * np.abs(x).max() * rng.standard_normal(x.shape),
        lambda x: np.eye(*x.shape) if x.ndim == 2 else np.ones_like(x),
    ]
    field = kinds[int(rng.integers(len(kinds)))](field)
    spoilt: dict[str, Any] = {name: field}
    return [*events[:count], event._replace(**spoilt), *events[count + 1 :]]


SOUND: tuple[Change, ...] = (more_snapshots, fewer_snapshots, a_clone, a_rejection)
DAMAGE: tuple[Change, ...] = (
    *(a_loss, a_double, an_exchange, an_idle_reset),
    *[a_spoilt_matrix] * 6,
)


class Planar:
    """A log, its references, and the events of the EKF over it."""

    def __init__(self) -> None:
        """Solve once."""
        self.log: Log = first_seconds(simulated(), 6.0)
        self.solution: Solution = solve(self.log)
        run = compared(self.log).ekf
        self.estimate = run.estimate
        self.events: list[Event] = list(run_events(run))

    def tried(self, seed: int, folder: Path) -> tuple[bool, str, str]:
        """Draw changes; return whether they are sound, what was done, and what is said.

        May raise anything but what says that the input is of no use.
        """
        rng = np.random.default_rng(seed)
        sound = seed % 3 == 0
        events = list(self.events)
        changes = [SOUND[int(rng.integers(len(SOUND)))] for _ in range(int(rng.integers(1, 4)))]
        if not sound:
            changes.append(DAMAGE[int(rng.integers(len(DAMAGE)))])
        done = ", ".join(change.__name__ for change in changes)
        for change in changes:
            try:
                events = change(events, rng)
            except (KeyError, ValueError):  # what is damaged already cannot be replayed
                continue
        write_estimate(self.estimate, folder)
        try:
            (folder / TRACE).unlink(missing_ok=True)
            write(events, folder / TRACE)
        except InputError as error:
            return False, done, f"recorder: {error}"
        try:
            with patch("comparisons.jobs.readings.fingerprints", lambda *given, **more: []):
                result = check(
                    self.log, read_external(folder), CheckConfig(), solver=lambda *_: self.solution
                )
        except InputError as error:
            return sound, done, f"refused: {error}"
        CheckReport.of(result).summary()
        return sound, done, f"{result.outcome}, {result.grade.value}"


if __name__ == "__main__":
    planar = Planar()

    def case(seed: int, folder: Path) -> Ending:
        """Try one."""
        sound, done, said = planar.tried(seed, folder)
        kind = said.partition(":")[0] if said.startswith(("refused", "recorder")) else said
        wrong = f"{done}: {said}" if sound and not said.startswith("agree") else ""
        return Ending(f"{'sound' if sound else 'damaged'}: {kind}", wrong)

    sys.exit(try_all(case, 500))
