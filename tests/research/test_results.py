"""Pages of results say what their records say, and a record that the code has left is marked."""

import json
import re
import shlex
import tempfile
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from comparisons.cli.app import COMMANDS
from research import record as recorder
from research.record import (
    ROOT,
    STALE,
    Record,
    Registry,
    StoredResultError,
    Table,
    changed,
    code_hash,
    dump,
    make,
    pages,
    read_records,
    read_registry,
    state,
)

CODE = '''"""What it does."""

LIMIT = 3.0
"""A limit."""


def twice(x: float) -> float:
    """Return it twice."""
    return 2.0 * x  # and no more
'''
WORDS = {
    "docstring": CODE.replace("Return it twice.", "Return 2 x."),
    "text of a constant": CODE.replace("A limit.", "Metres."),
    "comment": CODE.replace("# and no more", "# why"),
    "layout": CODE.replace("(x: float)", "(\n    x: float,\n)"),
}
MEANINGS = {
    "number": CODE.replace("2.0 *", "3.0 *"),
    "constant": CODE.replace("3.0", "4.0"),
    "name": CODE.replace("twice", "double"),
    "operator": CODE.replace("2.0 *", "2.0 +"),
}


def record_of(root: Path, **fields: Any) -> Record:
    """A record whose one source is a.py in `root`."""
    (root / "a.py").write_text(CODE)
    known: dict[str, Any] = {
        "name": "one",
        "title": "One",
        "commands": {"": "slamcheck run"},
        "commit": "0123456789",
        "date": "2026-01-01",
        "seeds": "0 to 9",
        "machine": {"cpu": "C", "cores": 2, "system": "S", "versions": {"Python": "3"}},
        "cpu_s": 60.0,
        "columns": ["a", "b"],
        "rows": [["1", "2|3"]],
        "printed": ["words", "| c |", "|---|", "| 4 |"],
        "pictures": {},
        "sources": {"a.py": code_hash(root / "a.py")},
    }
    return Record.model_validate_json(json.dumps(known | fields))


def registry_of(**fields: Any) -> Registry:
    table = {"name": "one", "title": "One", "command": "slamcheck run", "seeds": "0", "minutes": 1}
    other = table | {"name": "two", "title": "Two"}
    return Registry.model_validate(
        {
            "about": "About.",
            "section": [
                {"name": "here", "title": "Here", "table": [table | fields]},
                {"name": "elsewhere", "title": "Elsewhere", "table": [other]},
            ],
        }
    )


def shown(registry: Registry, record: Record, root: Path) -> str:
    """The page that has the record."""
    return pages(registry, {"one": record}, root)["results-here.md"]


def test_the_pages_in_the_repository_are_those_of_the_records() -> None:
    registry = read_registry()
    made = pages(registry, read_records(registry))
    kept = {path.name: path.read_text("utf-8") for path in (ROOT / "docs").glob("results*.md")}
    stale = [name for name in {*made, *kept} if made.get(name) != kept.get(name)]
    assert not stale, "out of date: run `python -m research.record --page`"


def test_a_record_is_shown_with_all_that_it_takes_to_make_it_again(tmp_path: Path) -> None:
    text = shown(registry_of(), record_of(tmp_path), tmp_path)
    assert "| a | b |\n| --- | --- |\n| 1 | 2\\|3 |" in text
    assert "```text\nwords\n```\n\n| c |\n|---|\n| 4 |" in text
    assert "*`slamcheck run` · commit 0123456789 · 2026-01-01 · seeds 0 to 9 · machine 1" in text
    assert text.endswith("\n\n*Machine 1: C, 2 cores, S, Python 3.*\n")
    assert "1.0 min of processor time · [record](results/records/one.json)" in text
    assert STALE not in text


def test_each_row_shows_its_command_where_there_are_several(tmp_path: Path) -> None:
    commands = {"x": "slamcheck run", "y": "slamcheck run --seed 1"}
    rows = [["x", "1"], ["y", "2"]]
    record = record_of(tmp_path, commands=commands, rows=rows, printed=[])
    text = shown(registry_of(command=commands), record, tmp_path)
    assert "| a | b | command |\n| --- | --- | --- |\n| x | 1 | `slamcheck run` |\n" in text
    assert "| y | 2 | `slamcheck run --seed 1` |\n\n*each row's command · commit" in text


def test_a_page_has_its_tables(tmp_path: Path) -> None:
    text = shown(registry_of(), record_of(tmp_path), tmp_path)
    assert text.startswith("# Here\n\n[Results](results.md)")
    assert "\n\n## One\n" in text


def test_the_first_page_lists_the_others_and_their_tables(tmp_path: Path) -> None:
    registry = registry_of(title="Nieto 2005, Fig. 2.13")
    made = pages(registry, {"one": record_of(tmp_path)}, tmp_path)
    assert list(made) == ["results.md", "results-here.md"]
    link = "[Nieto 2005, Fig. 2.13](results-here.md#nieto-2005-fig-213)"
    assert made["results.md"] == (
        f"# Results\n\nAbout.\n\n- [Here](results-here.md)\n    - {link}\n"
    )
    both = pages(registry, {name: record_of(tmp_path) for name in ("one", "two")}, tmp_path)
    assert "- [Elsewhere](results-elsewhere.md)\n    - [Two](" in both["results.md"]


@pytest.mark.parametrize("name", WORDS)
def test_comments_and_docstrings_make_no_record_stale(name: str, tmp_path: Path) -> None:
    record = record_of(tmp_path)
    assert WORDS[name] != CODE
    (tmp_path / "a.py").write_text(WORDS[name])
    assert changed(record, tmp_path) == []


@pytest.mark.parametrize("name", MEANINGS)
def test_a_change_of_a_source_is_marked(name: str, tmp_path: Path) -> None:
    record = record_of(tmp_path)
    (tmp_path / "a.py").write_text(MEANINGS[name])
    assert changed(record, tmp_path) == ["a.py"]
    assert f"## One\n\n{STALE}\n" in shown(registry_of(), record, tmp_path)


def test_a_source_that_is_gone_is_marked(tmp_path: Path) -> None:
    record = record_of(tmp_path)
    (tmp_path / "a.py").unlink()
    assert changed(record, tmp_path) == ["a.py"]


@pytest.mark.parametrize("field", Record.model_fields)
def test_a_record_with_a_missing_field_is_refused(field: str, tmp_path: Path) -> None:
    folder = tmp_path / "docs/results/records"
    folder.mkdir(parents=True)
    whole = json.loads(dump(record_of(tmp_path)))
    (folder / "one.json").write_text(json.dumps(whole))
    assert list(read_records(registry_of(), tmp_path)) == ["one"]
    del whole[field]
    (folder / "one.json").write_text(json.dumps(whole))
    with pytest.raises(
        StoredResultError, match=rf"^one\.json: {field}: field required; record it anew$"
    ):
        read_records(registry_of(), tmp_path)


@pytest.mark.parametrize(
    "wrong", [{"commit": "HEAD"}, {"sources": {}}, {"host": "x"}, {"date": "today"}]
)
def test_a_record_with_a_wrong_field_is_refused(wrong: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValidationError):
        record_of(tmp_path, **wrong)


def test_a_record_of_another_command_is_marked(tmp_path: Path) -> None:
    registry, record = registry_of(command="slamcheck run --seed 1"), record_of(tmp_path)
    text = shown(registry, record, tmp_path)
    assert f"## One\n\n{STALE}\n" in text
    assert "*`slamcheck run` ·" in text
    assert state(registry.tables["one"], record, tmp_path) == "stale (command)"
    assert state(registry.tables["two"], None) == "missing"


def test_a_record_of_no_table_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "docs/results/records"
    folder.mkdir(parents=True)
    (folder / "one.json").write_text(dump(record_of(tmp_path)))
    with pytest.raises(StoredResultError, match="no table of"):
        read_records(registry_of(name="three"), tmp_path)


@pytest.mark.slow
def test_what_a_command_loads_becomes_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also by a process that the command starts; what only prints is left out."""
    inner = "import ekf_reference.core.ekf, comparisons.cli.app, comparisons.report.job_report"
    outer = f"import subprocess, sys; subprocess.run([sys.executable, '-c', '{inner}']); print(1)"
    monkeypatch.setattr(
        recorder, "_git", lambda *words: "" if words[0] == "status" else "abcdef0123"
    )
    table = Table(
        name="one", title="One", command=shlex.join(["python", "-c", outer]), seeds="0", minutes=1
    )
    found = make(table, tmp_path)
    assert found.printed == ("1",)
    assert "ekf_reference/core/ekf.py" in found.sources
    assert not [one for one in found.sources if one.startswith(recorder.UNHASHED)]
    assert changed(found) == []


def test_what_fails_or_is_not_committed_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = Table(name="one", title="One", command="python -c 1/0", seeds="0", minutes=1)
    monkeypatch.setattr(recorder, "_git", lambda *words: "")
    with pytest.raises(StoredResultError, match="exited with 1: ZeroDivisionError"):
        make(table, tmp_path)
    monkeypatch.setattr(recorder, "_git", lambda *words: " M comparisons/errors.py")
    with pytest.raises(StoredResultError, match="commit what changed"):
        make(table, tmp_path)
    monkeypatch.setattr(recorder, "_git", lambda *words: "")
    table = Table(name="one", title="One", command="slamcheck run DATA/x", seeds="0", minutes=1)
    with pytest.raises(StoredResultError, match="--data"):
        make(table, tmp_path / "none")


def test_every_command_exists() -> None:
    for table in read_registry().tables.values():
        for command in table.commands.values():
            program, first, *rest = shlex.split(command)
            if program == "slamcheck":
                assert first in COMMANDS, command
                continue
            assert (program, first) == ("python", "-m"), command
            module = ROOT / rest[0].replace(".", "/")
            files = module.with_suffix(".py"), module / "__main__.py"
            assert any(path.is_file() for path in files), command


def test_records_name_no_machine_and_their_pictures_are_there() -> None:
    for path in (ROOT / "docs/results/records").glob("*.json"):
        text = path.read_text(encoding="utf-8")
        for private in (str(ROOT), tempfile.gettempdir(), "/home/", "/root/"):
            assert private not in text, f"{path.name}: {private}"
        for name, known in json.loads(text)["pictures"].items():
            assert code_hash(ROOT / "docs" / name) == known, f"{name}: not the recorded picture"


def test_earlier_results_are_those_without_a_record() -> None:
    """Each can be made again, names its commit, and goes when it is recorded."""
    registry = read_registry()
    records = read_records(registry)
    text = registry.after
    rows = re.findall(r"^\| `([a-z0-9-]+)` \| .* \| ([0-9a-f]{7}) \|$", text, re.MULTILINE)
    assert len(rows) == text.count("\n| ") - 1
    for name, _ in rows:
        assert name in registry.tables
        assert name not in records, f"{name} is recorded: delete its row in results.toml"
