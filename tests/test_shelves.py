"""Shelves hold tests that exist, cover files that exist, and are asked for where these change."""

import subprocess
from pathlib import Path

import pytest

from tests import shelves
from tests.shelves import ROOT, SHELVES, Shelf, changed_files, due, shelf_of


@pytest.mark.parametrize("name", SHELVES)
def test_what_a_shelf_names_exists(name: str) -> None:
    for test in SHELVES[name].tests:
        path, _, function = test.partition("::")
        assert (ROOT / path).exists(), test
        name_only = function.partition("[")[0]
        assert not function or f"def {name_only}(" in (ROOT / path).read_text(), test
    for start in SHELVES[name].covers:
        assert list(ROOT.glob(f"{start.rstrip('/')}*")), start


def test_of_a_file_the_slow_ones_are_on_the_shelf(monkeypatch: pytest.MonkeyPatch) -> None:
    some = Shelf(("tests/test_a.py", "tests/test_b.py::test_one"), ("docs/",))
    monkeypatch.setattr(shelves, "SHELVES", {"some": some})
    assert shelf_of("tests/test_a.py::test_any", {"slow"}) == "some"
    assert shelf_of("tests/test_a.py::test_any", {"browser", "data"}) == "some"
    assert shelf_of("tests/test_a.py::test_any", ()) is None
    assert shelf_of("tests/test_b.py::test_one[case]", ()) == "some"
    assert shelf_of("tests/test_b.py::test_two", {"slow"}) is None
    assert due(["docs/usage.md"]) == due(["tests/test_b.py"]) == {"some"}
    assert due(["comparisons/cli/run.py", "tests/test_c.py"]) == set()


def test_what_has_changed_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a branch since main, on main since the commit before, and what is not committed."""

    def git(*words: str) -> None:
        name = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(["git", *name, *words], cwd=tmp_path, check=True, capture_output=True)

    def commit(name: str) -> None:
        (tmp_path / name).write_text(name)
        git("add", name)
        git("commit", "-m", name)

    monkeypatch.setattr(shelves, "ROOT", tmp_path)
    monkeypatch.delenv("BASE", raising=False)
    assert changed_files() == set()
    git("init", "-b", "main")
    commit("first")
    assert changed_files() == set()
    commit("second")
    assert changed_files() == {"second"}
    git("switch", "-c", "work")
    commit("third")
    commit("fourth")
    (tmp_path / "new").write_text("")
    assert changed_files() == {"third", "fourth", "new"}
    monkeypatch.setenv("BASE", "HEAD~1")
    assert changed_files() == {"fourth", "new"}
