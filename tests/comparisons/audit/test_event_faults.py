"""Faults of events: composed of the formulas, computed together as one by one, and named."""

from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.replay import Replay
from comparisons.faults.formulas import evaluated, formula, shape_of, variants, written
from comparisons.faults.of_events import (
    LEVELS,
    NUMBERED_LEVELS,
    EventFault,
    EventFaults,
    afters,
)
from comparisons.faults.recipes import AFTER, FORMS, recipe_of
from comparisons.faults.recursion import Remembering
from comparisons.trace.events import Augment, Event, Predict, TracePrior, Update
from research.trust.mutated_filters import SlipOutcome, slip, tried

DRAWN = 40
RNG = np.random.default_rng(0)


def covariance(size: int) -> Array:
    root = RNG.standard_normal((size, size))
    return np.asarray(0.3 * root @ root.T + np.eye(size))


P, R = covariance(5), covariance(2)
PRIOR = TracePrior(0, None, ("place", "speed", "bias"), (2, 2, 1), P)
STATE = PRIOR.blocks
MOVE = Predict(1, 0.5, STATE, np.eye(5) + 0.2 * RNG.standard_normal((5, 5)), covariance(5))
MEASURE = Update(
    2, 1.0, "range", STATE, np.zeros(2), RNG.standard_normal((2, 5)), R, True, None, None
)
BEGIN = Augment(3, 1.5, "tree", STATE, RNG.standard_normal((2, 5)), np.eye(2), R)
EVENTS = (MOVE, MEASURE, BEGIN)


def remembering() -> Remembering:
    return Remembering(Replay(PRIOR), (), P + np.eye(5), 2.0 * P)


def without_numbers(event: Event) -> list[EventFault]:
    every = EventFaults(event, remembering())
    return [fault for level in LEVELS for fault in every.at(level)]


@pytest.mark.parametrize("text", ["F P F^T + Q", "P - K H P", "- F * P F^-1 + Q"])
def test_a_formula_is_its_text(text: str) -> None:
    assert written(formula(text)) == text


def test_a_formula_is_what_its_text_says() -> None:
    f, q = MOVE.jacobian, MOVE.noise
    matrices = {"F": f, "P": P, "Q": q}
    for text, right in (
        ("F P F^T + Q", f @ P @ f.T + q),
        ("F * P - Q^-1", f * P - np.linalg.inv(q)),
        ("F P * F^T", (f @ P) * f.T),
    ):
        assert np.allclose(evaluated({"x": formula(text)}, matrices)["x"], right, rtol=1e-12)


def test_variants_have_the_shape_of_the_formula_and_differ() -> None:
    shapes = {"K": (5, 2), "H": (2, 5), "R": (2, 2), "S": (2, 2), "P": (5, 5)}
    every = list(variants(formula("P - K S K^T"), shapes))
    texts = [written(one) for one in every]
    assert len(set(texts)) == len(texts)
    assert {"P - K K^T", "P + K S K^T", "P - K R K^T", "P", "P - K S^-1 K^T"} <= set(texts)
    assert {shape_of(one, shapes) for one in every} == {(5, 5)}
    assert shape_of(formula("P K^T"), shapes) is None


def test_all_forms_of_an_update_are_one_for_kalmans_gain() -> None:
    replay = remembering()
    first = replay.sound_results(MEASURE, "")[AFTER]
    for form in FORMS:
        other = evaluated(recipe_of(MEASURE, form), replay.matrices(MEASURE))[AFTER]
        assert np.allclose(other, first, rtol=0.0, atol=1e-12), form
    replay.apply(MEASURE)
    assert np.allclose(replay.covariance, first, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_faults_are_computed_together_as_they_are_one_by_one(event: Event) -> None:
    faults = without_numbers(event)
    assert len(faults) > 200
    together = afters(faults, [()] * len(faults), remembering(), event)
    with np.errstate(all="ignore"):
        for fault, made in list(zip(faults, together, strict=True))[::7]:
            replay = remembering()
            fault.do(replay, event)
            if made is not None:
                assert np.allclose(replay.covariance, made, rtol=1e-9, equal_nan=True), fault.kind


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_a_number_of_no_fault_changes_nothing(event: Event) -> None:
    every, sound = EventFaults(event, remembering()), remembering()
    faults = [fault for level in NUMBERED_LEVELS for fault in every.numbered(level)]
    assert len(faults) > 50
    sound.apply(event)
    for p in afters(faults, [fault.start for fault in faults], remembering(), event):
        assert p is None or np.allclose(p, sound.covariance, rtol=0.0, atol=1e-11)


def test_each_fault_has_its_own_words() -> None:
    for event in EVENTS:
        kinds = [fault.kind for fault in without_numbers(event)]
        assert len(set(kinds)) == len(kinds)


@pytest.mark.slow
def test_what_a_slip_of_the_hand_does_is_named(tmp_path: Path) -> None:
    """Most changes of one expression in a filter's own lines, each at its event."""
    rng, outcomes = np.random.default_rng(5), list[SlipOutcome]()
    while len(outcomes) < DRAWN:
        outcome = tried(slip(rng), len(outcomes), 1, tmp_path / "trace")
        (tmp_path / "trace").unlink(missing_ok=True)
        if outcome is not None:
            outcomes.append(outcome)
    assert sum(one.event for one in outcomes) >= 0.95 * DRAWN
    assert sum(one.named for one in outcomes) >= 0.85 * DRAWN
