"""What the compressed filter costs (Guivant 2002, section 4.1), without a clock in a test."""

import pytest

from ekf_reference.filters.compressed import CompressedState
from research.documents import guivant_cost as cost


def test_the_active_landmarks_do_not_grow_with_the_map_and_nothing_is_lost() -> None:
    """The area holds the same part of either map, and is left once, at the end."""
    active = []
    for size in (300, 600):
        log = cost.field_log(size)
        local, compressed = cost.driven(log, "compressed")
        whole, full = cost.driven(log, "full")
        assert local.landmarks == whole.landmarks == size
        assert isinstance(compressed.state, CompressedState)
        assert [one.passive > 0 for one in compressed.state.updates] == [False, True]
        assert cost.gap(full, compressed) < 1e-9
        active.append(local.active)
    assert max(active) < 1.05 * min(active) < 0.6 * 300


def test_an_update_that_is_not_carried_over_would_be_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All landmarks have the start's error in common, so the area's measurements tell of all."""
    log = cost.field_log(300)
    full = cost.driven(log, "full")[1]
    monkeypatch.setattr(CompressedState, "_learn", lambda state, rows: None)
    assert cost.gap(full, cost.driven(log, "compressed")[1]) > 1.0


def test_the_figures_of_costs_that_are_known() -> None:
    """A step as the square of the map, and one that stays as it is."""
    sizes = (1000, 2000)
    full = tuple(
        cost.Cost(landmarks=n, step_ms=1e-6 * n**2, leaving_ms=0.0, active=n) for n in sizes
    )
    local = tuple(
        cost.Cost(landmarks=n, step_ms=0.5, leaving_ms=1e-3 * n, active=100) for n in sizes
    )
    found = cost.Costs("made up", full, local, 0.0)
    assert found.local_growth() == 1.0
    assert found.gain() == pytest.approx(8.0)
    assert found.order(full, "step_ms") == pytest.approx(2.0)
    assert found.order(local, "leaving_ms") == pytest.approx(1.0)
