"""The grammar of faults: each composition is planted as it is explained, and named."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.time_window import cut_log
from comparisons.arrays import Array
from comparisons.checks.diagnosis.known_model_errors import explain
from comparisons.explain.hypotheses import Quantity
from comparisons.explain.recorded import explained
from comparisons.faults.grammar import (
    G_X,
    POSITION,
    PRIOR,
    R_OF_POSITION,
    SLOTS,
    Composition,
    F,
    H,
    Q,
    Slot,
    Values,
    compositions,
    parts,
)
from comparisons.faults.planting import PLANTED, has, sound_values
from comparisons.logs.bundled import open_log
from comparisons.logs.log import Log
from comparisons.report.explain import explanation
from research.trust.composed import (
    DrawnFault,
    drawn,
    run_with,
    without_effect,
)
from research.trust.drawn_estimates import checked, handed_in
from tests.helpers import present

DRAWN = 40


def some_values(slot: Slot, count: int = 6) -> Values:
    """Values of a slot in some records, and all that its faults may read."""
    rng, like = np.random.default_rng(0), has(slot)
    sound = rng.standard_normal((count, *slot.shape))
    if slot.covariance:
        sound = sound @ sound.mT + np.eye(slot.shape[0])
    return Values(
        sound=sound,
        factors={name: rng.uniform(2.0, 9.0, count) for name in like.factors},
        heading=None if like.heading is None else rng.uniform(0.2, 1.0, count),
        elsewhere={words: rng.standard_normal(sound.shape) for words in like.elsewhere},
    )


@pytest.mark.parametrize("slot", SLOTS, ids=lambda slot: slot.name)
def test_each_fault_changes_its_own_terms_and_has_its_own_words(slot: Slot) -> None:
    values, every = some_values(slot), list(compositions(slot, some_values(slot)))
    words = Counter(one.said(*one.start) for one in every)
    assert words.most_common(1)[0][1] == 1
    for one in every:
        neutral = one.values(values, *one.start)
        if one.start:
            assert np.array_equal(neutral, values.sound)
        changed = one.values(values, *(number + 1.7 for number in one.start))
        assert changed.shape == values.sound.shape
        assert not np.array_equal(changed, values.sound, equal_nan=True), one.said(*one.start)
        if one.mask is not None:
            assert np.array_equal(changed[:, ~one.mask], values.sound[:, ~one.mask])


def test_the_parts_of_a_matrix_are_all_that_a_reader_calls_by_a_name() -> None:
    words = [part.words for part in parts(H)]
    assert len(set(words)) == len(words)
    assert {"H", "the bearing row of H", "the heading column of H", "the landmark block of H",
            "the position part of the range row of H",
            "the heading term of the bearing row of H"} <= set(words)  # fmt: skip
    assert [part.words for part in parts(Q)][:3] == ["Q", "the position block of Q", "Q of the x"]


def test_thousands_come_of_few_slots_and_changes() -> None:
    """And another slot costs one line."""
    counts = {slot.name: sum(1 for _ in compositions(slot, some_values(slot))) for slot in SLOTS}
    assert sum(counts.values()) > 2000
    of_another = Slot(name="the speed's derivative", rows=("x", "y"), columns=("speed", "bias"))
    assert sum(1 for _ in compositions(of_another, Values(sound=np.ones((1, 2, 2))))) > 50


@pytest.fixture(scope="module")
def log() -> Log:
    return cut_log(open_log("simulated-loop"), None, 20.0)


@pytest.fixture(scope="module")
def sound(log: Log) -> EkfRun:
    return present(run_with(log, None))


def test_a_sound_filter_has_no_fault(log: Log, sound: EkfRun) -> None:
    assert explain(log, sound) == ()


@pytest.mark.slow
def test_a_fault_that_is_drawn_is_named_by_the_records(log: Log, sound: EkfRun) -> None:
    """All of them, most with their own words; other words are of the same values."""
    rng, said = np.random.default_rng(11), list[tuple[str, Sequence[str]]]()
    values = sound_values(log)
    while len(said) < DRAWN:
        one = drawn(rng, values)
        run = run_with(log, one)
        if run is None or without_effect(sound, run):
            continue
        with np.errstate(all="ignore"):
            said.append((one.words, explain(log, run)))
    assert [words for words, lines in said if not lines] == []
    assert sum(lines[0].startswith(words) for words, lines in said) >= 0.5 * DRAWN


def fault(slot: Slot, words: str) -> Composition:
    (one,) = (one for one in compositions(slot, has(slot)) if one.words == words)
    return one


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slot", "words"),
    [
        (H, "the heading column of H is divided by the square of the range"),
        (F, "the rows of x and y in F are exchanged"),
        (G_X, "the heading column of G_x is not multiplied by the range, or divided by it once "
         "too often"),
    ],
)  # fmt: skip
def test_a_fault_is_named_without_a_trace(log: Log, slot: Slot, words: str) -> None:
    run = present(run_with(log, DrawnFault(fault(slot, words), ())))
    (first, *_) = checked(log, present(handed_in(run))).said
    assert first.startswith(words)


def recorded(have: Array, meant: Array) -> Quantity:
    return Quantity(have=have, meant=meant, tolerance=1e-9, records="predictions")


def test_what_no_change_makes_is_not_named() -> None:
    """The broken variant: a curve that is none of the grammar's changes."""
    values = some_values(F, 40)
    have = values.sound.copy()
    have[:, 0, 2] = np.exp(have[:, 0, 2])
    assert explained(F, recorded(have, values.sound), values) == []


def test_two_faults_in_two_rows_are_both_named() -> None:
    values = some_values(F, 40)
    have = values.sound.copy()
    have[:, 0] *= -1.0
    have[:, 1, 2] *= 2.5
    first, second = explained(F, recorded(have, values.sound), values)
    assert first.startswith("the x row of F has the opposite sign")
    assert second.startswith("the heading term of the y row of F is 2.5 times the correct value")


def test_planted_slots_are_those_that_a_model_gives() -> None:
    assert set(SLOTS) - set(PLANTED) == {POSITION, R_OF_POSITION, PRIOR}


def test_positions_and_the_prior_are_slots_too() -> None:
    rng = np.random.default_rng(0)
    meant = rng.standard_normal((30, 2))
    for have, words in (
        (meant * (-1.0, 1.0), "the east of the innovation of positions has the opposite sign"),
        (meant[:, ::-1], "east and north in the innovation of positions are exchanged"),
    ):
        quantity = Quantity(have=have, meant=meant, tolerance=1e-9, records="positions")
        values = Values(sound=meant[:, :, None])
        (said,) = explained(POSITION, quantity, values, lambda moved, rows: moved[:, :, 0])
        assert said == f"{words}, in 30 of 30 positions"
    prior = np.diag((0.04, 0.01, 0.001))[None]
    have = prior[:, [0, 2, 1]][:, :, [0, 2, 1]]
    quantity = Quantity(have=have, meant=prior, tolerance=1e-9, records="priors")
    (said,) = explained(PRIOR, quantity, Values(sound=prior))
    assert said.startswith("the variances of y and heading in the prior's covariance are exchanged")


def test_the_program_prints_the_grammar() -> None:
    said = explanation("faults")
    assert "H (range, bearing by x, y, heading, landmark's x, landmark's y)" in said
    assert "  H is divided by the square of the range" in said.splitlines()
