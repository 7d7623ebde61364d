"""Each recorded filter is right by its own trace; each planted bug is where it says.

The audit passes the sound traces, and finds five bugs of each filter by event, sensor and blocks.
"""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from comparisons.audit.audit import audit
from comparisons.trace.events import Clone, Event, Snapshot, TracePrior, Update
from comparisons.trace.reader import TraceReader
from examples.audit.faults import Fault, Planted
from research.trust.audit_faults import judge
from tests.helpers import present

PACKAGES = {"filterpy_ekf": "filterpy", "filterpy_ukf": "filterpy", "navlie_se3": "navlie"}
AUDITED = {
    "filterpy_ekf": ("cross-stale", "twice", "no-noise", "sigma", "wrong-sign"),
    "filterpy_ukf": ("cross-dropped", "not-updated", "no-noise", "one-sided", "not-applied"),
    "gtsam_filters": ("no-reset", "cross-predicted", "cross-stale", "transposed", "wrong-sign"),
    "msckf": ("lone-clone", "conditioned", "wrong-removed", "cross-predicted", "no-krk"),
    "navlie_se3": ("cross-stale", "cross-dropped", "not-updated", "no-noise", "half-gain"),
}
ROUNDING, LAST_BITS = 1e-9, 1e-14
SEED = 3


def needs(name: str) -> None:
    """Skip a test of a filter whose package, of the extra, is not installed."""
    package = PACKAGES.get(name)
    if package is not None and find_spec(package) is None:
        pytest.skip(f"{package} is not installed (the extra audit-examples)")


class Recorded(NamedTuple):
    """A filter's traces: the sound one, and by fault with where it is."""

    record: Callable[..., Planted | None]
    faults: dict[str, Fault]
    sound: Path
    faulty: dict[str, tuple[Path, Planted]]
    audited: tuple[str, ...]


@pytest.fixture(scope="module", params=AUDITED)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Traces of a filter; the test is skipped where its package is not installed."""
    name = request.param
    needs(name)
    module: Any = import_module(f"examples.audit.{name}")
    folder = tmp_path_factory.mktemp(name)
    assert module.record(folder / "sound", SEED) is None
    faulty = {}
    for fault in module.FAULTS:
        planted = present(module.record(folder / fault, SEED, fault))
        faulty[fault] = folder / fault, planted
    return Recorded(module.record, module.FAULTS, folder / "sound", faulty, AUDITED[name])


def test_fewer_snapshots_are_of_the_same_run(recorded: Recorded, tmp_path: Path) -> None:
    recorded.record(tmp_path / "some", SEED, snapshots=5)
    every, some = (
        [e for e in TraceReader(path) if isinstance(e, Snapshot)]
        for path in (recorded.sound, tmp_path / "some")
    )
    assert len(some) == len(every) // 5
    for one, other in zip(every[4::5], some, strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.slow
def test_every_fault_shows_at_its_event(recorded: Recorded) -> None:
    assert len(recorded.faults) == 10
    assert sum(not fault.statistical for fault in recorded.faults.values()) >= 8
    for name, (path, planted) in recorded.faulty.items():
        assert _first_difference(recorded.sound, path) in _seen(path, planted.event), name
        _names_what_is_there(planted, path)


def test_the_audit_passes_a_sound_trace(recorded: Recorded) -> None:
    result = audit(recorded.sound)
    assert result.sound, result.findings
    assert result.nees is not None
    assert present(result.largest_gap).worst < ROUNDING
    assert 400 < result.events < 1000


@pytest.mark.slow
def test_the_audit_finds_five_faults(recorded: Recorded) -> None:
    for name in recorded.audited:
        path, planted = recorded.faulty[name]
        judged = judge(path, planted, recorded.faults[name])
        assert judged[:3] == (True, True, True), (name, judged)
        assert present(judged.first).sensor == planted.sensor, name


def _first_difference(sound: Path, faulty: Path) -> int | None:
    """The first event that differs, or that a snapshot that differs is of."""
    number = 0
    for one, other in zip(TraceReader(sound), TraceReader(faulty), strict=True):
        if not isinstance(one, Snapshot):
            number = one.number
        if not _equal(one, other):
            return number
    return None


def _seen(path: Path, event: int) -> range:
    """Events that no snapshot separates from one: where its effect may be noticed first."""
    after = (e.number for e in TraceReader(path) if isinstance(e, Snapshot) and e.number > event)
    return range(event, next(after))


def _equal(one: Event, other: Event) -> bool:
    return all(_same(a, b) for a, b in zip(one, other, strict=True))


def _same(one: Any, other: Any) -> bool:
    """Rows to their last bits, which are not the same for equal numbers elsewhere in memory."""
    if not isinstance(one, float | np.ndarray) or np.shape(one) != np.shape(other):
        return bool(np.array_equal(one, other))
    rows, others = np.atleast_1d(one), np.atleast_1d(other)
    largest = np.abs(rows).max(axis=-1, keepdims=True, initial=0.0)
    return bool((np.abs(rows - others) <= LAST_BITS * largest).all())


def _names_what_is_there(planted: Planted, path: Path) -> None:
    events = list(TraceReader(path))
    event = events[planted.event]
    assert planted.sensor == (event.sensor if isinstance(event, Update) else None)
    known = {name for one in events if isinstance(one, TracePrior) for name in one.blocks}
    known |= {one.name for one in events if isinstance(one, Clone)}
    assert set(planted.blocks) <= known
