"""What research/mutants.py changes, and that a change is in place."""

import importlib.util
import tomllib
from pathlib import Path

import pytest

from research import mutants as program
from research.mutants import EQUIVALENT, ROOT, drawn, mutants, put_in_place, score

SOURCE = '''
LIMIT = 3


def within(x: int | None = 5) -> bool:
    """Whether it is."""
    if x is None:
        raise ValueError(f"{1 + 1}")
    return x <= LIMIT and x + 1 > 0
'''


def test_every_operation_of_a_function_may_change_and_no_word() -> None:
    found = [one.key.partition(": ")[2] for one in mutants("small.py", SOURCE.encode())]
    assert sorted(found) == [
        "0 -> (1) (0)",
        "1 -> (2) (0)",
        "x + 1 -> (x - 1) (0)",
        "x + 1 > 0 -> (x + 1 < 0) (0)",
        "x + 1 > 0 -> (x + 1 >= 0) (0)",
        "x <= LIMIT -> (x < LIMIT) (0)",
        "x <= LIMIT -> (x >= LIMIT) (0)",
        "x <= LIMIT and x + 1 > 0 -> (x <= LIMIT or x + 1 > 0) (0)",
        "x is None -> (x is not None) (0)",
    ]


def test_a_line_elsewhere_draws_no_other_mutants() -> None:
    before, after = (
        drawn(mutants("small.py", text.encode()), 4, 0) for text in (SOURCE, "import os\n" + SOURCE)
    )
    assert [one.key for one in before] == [one.key for one in after]
    other = drawn(mutants("small.py", SOURCE.encode()), 4, 1)
    assert [one.key for one in before] != [one.key for one in other]


def test_what_changes_nothing_is_not_counted_and_what_survives_has_a_reason() -> None:
    assert score(20, []) == (1.0, 0, 0)
    assert score(20, [""]) == (0.95, 0, 1)
    assert score(21, [f"{EQUIVALENT}it is", "let live: words"]) == (0.95, 1, 0)


def test_every_reason_is_of_a_mutant_that_there_is() -> None:
    found = tomllib.loads((ROOT / program.REASONS).read_text(encoding="utf-8"))["survivor"]
    for file in {one["mutant"].partition(" ")[0] for one in found}:
        there = {one.key for one in mutants(file, (ROOT / file).read_bytes())}
        named = {one["mutant"] for one in found if one["mutant"].startswith(f"{file} ")}
        assert named <= there, named - there
    assert all(one["reason"] for one in found)


def test_a_mutant_takes_its_functions_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "small.py"
    path.write_text(SOURCE)
    monkeypatch.setattr(program, "ROOT", tmp_path)
    spec = importlib.util.spec_from_file_location("small", path)
    assert spec is not None
    assert spec.loader is not None
    small = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(small)
    kept = small.within
    assert kept(3)
    found = {one.new: one for one in mutants("small.py", path.read_bytes())}
    put_in_place(found["(x < LIMIT)"])
    assert not kept(3)
    put_in_place(found["(x - 1)"])
    assert (kept(3), kept(0)) == (True, False)
