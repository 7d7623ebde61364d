"""What benchmarks/mutants.py changes, and that a change is in place."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from benchmarks import mutants as program
from benchmarks.mutants import drawn, mutants, put_in_place

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
