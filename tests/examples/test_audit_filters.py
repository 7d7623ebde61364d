"""Each recorded filter is right by its own trace; each planted bug is where it says."""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from comparisons.audit.events import Clone, Event, Prior, Snapshot, Update
from comparisons.audit.trace_file import Trace
from examples.audit.faults import Planted
from tests.examples.replay import departures

NAMES = ("filterpy_ekf", "filterpy_ukf", "gtsam_filters", "msckf", "navlie_se3")
PACKAGES = {"filterpy_ekf": "filterpy", "filterpy_ukf": "filterpy", "navlie_se3": "navlie"}
ROUNDING, SEEN = 1e-9, 1e-5


@pytest.fixture(params=NAMES)
def module(request: pytest.FixtureRequest) -> ModuleType:
    """A filter's module; the test is skipped where its package is not installed."""
    package = PACKAGES.get(request.param)
    if package is not None and find_spec(package) is None:
        pytest.skip(f"{package} is not installed (the extra audit-examples)")
    return importlib.import_module(f"examples.audit.{request.param}")


def test_a_sound_trace_replays_to_rounding(module: ModuleType, tmp_path: Path) -> None:
    assert module.record(tmp_path / "trace", 3) is None
    assert max(apart for _, apart in departures(tmp_path / "trace")) < ROUNDING
    assert 200 < Trace(tmp_path / "trace").counts.events < 1500


def test_the_true_errors_are_as_the_covariance_says(module: ModuleType, tmp_path: Path) -> None:
    nees, freedom = 0.0, 0
    for seed in range(15):
        module.record(tmp_path / f"{seed}", seed)
        last = [e for e in Trace(tmp_path / f"{seed}") if isinstance(e, Snapshot)][-1]
        assert last.error is not None
        nees += float(last.error @ np.linalg.solve(last.covariance, last.error))
        freedom += len(last.error)
    low, high = chi2.interval(0.999, freedom)
    assert low < nees < high


def test_fewer_snapshots_are_of_the_same_run(module: ModuleType, tmp_path: Path) -> None:
    module.record(tmp_path / "all", 3)
    module.record(tmp_path / "some", 3, snapshots=5)
    every, some = (
        [e for e in Trace(tmp_path / n) if isinstance(e, Snapshot)] for n in ("all", "some")
    )
    assert len(some) == len(every) // 5
    for one, other in zip(every[4::5], some, strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_every_fault_shows_at_its_event(module: ModuleType, tmp_path: Path) -> None:
    module.record(tmp_path / "sound", 3)
    assert len(module.FAULTS) == 10
    assert sum(not fault.statistical for fault in module.FAULTS.values()) >= 5
    for name, fault in module.FAULTS.items():
        planted = module.record(tmp_path / name, 3, name)
        assert planted is not None
        assert _first_difference(tmp_path / "sound", tmp_path / name) == planted.event, name
        departed = [event for event, apart in departures(tmp_path / name) if apart > SEEN]
        seen = () if fault.statistical else _seen(tmp_path / name, planted.event)
        assert departed[0] in seen if seen else not departed, name
        _names_what_is_there(planted, tmp_path / name)


def _first_difference(sound: Path, faulty: Path) -> int | None:
    """The first event that differs, or that a snapshot that differs is of."""
    number = 0
    for one, other in zip(Trace(sound), Trace(faulty), strict=True):
        if not isinstance(one, Snapshot):
            number = one.number
        if not _equal(one, other):
            return number
    return None


def _seen(path: Path, event: int) -> range:
    """Events that no snapshot separates from one: where its effect may be noticed first."""
    after = (e.number for e in Trace(path) if isinstance(e, Snapshot) and e.number > event)
    return range(event, next(after))


def _equal(one: Event, other: Event) -> bool:
    return all(_same(a, b) for a, b in zip(one, other, strict=True))


def _same(one: Any, other: Any) -> bool:
    return bool(np.array_equal(one, other))


def _names_what_is_there(planted: Planted, path: Path) -> None:
    events = list(Trace(path))
    event = events[planted.event]
    assert planted.sensor == (event.sensor if isinstance(event, Update) else None)
    known = {name for one in events if isinstance(one, Prior) for name in one.blocks}
    known |= {one.name for one in events if isinstance(one, Clone)}
    assert set(planted.blocks) <= known
