"""The tutorials' commands, run as printed, print what the pages show."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.test_docs import script
from tests.test_own_project import missing, steps

DOCS = Path(__file__).resolve().parents[1] / "docs"
DATA = {"scans": "kiss_icp"}
"""What a page's commands need beside the default installation."""


SCRIPT = script("pictures")


def faults(page: str, folder: Path) -> Iterator[str]:
    """What a page shows and its commands, run in a folder, do not print; and what they should."""
    for block in blocks_of(page):
        for step in steps(block):
            done = SCRIPT.run(step.command, folder)
            if done.returncode not in (0, 1, 3):
                yield f"{step.command}: exit code {done.returncode}: {done.stderr}"
            if not step.shown.strip() and done.stdout.strip():
                yield f"{step.command}: the page shows nothing of {done.stdout!r}"
            yield from (f"{step.command}: {one!r}" for one in missing(step.shown, done.stdout))


def blocks_of(page: str) -> list[str]:
    return re.findall(r"^```console\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPT.PICTURES)
def test_commands_print_what_the_page_shows(name: str, tmp_path: Path) -> None:
    """Where this fails: `make pictures`."""
    if name in DATA:
        pytest.importorskip(DATA[name])
    page = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    folder = SCRIPT.prepare(tmp_path / name)
    assert list(faults(page, folder)) == []
    assert [one for one in SCRIPT.PICTURES[name].values()
            if not (folder / one.partition("#")[0]).is_file()] == []  # fmt: skip


ELSEWHERE = {
    "audit-format": "comparisons/trace/test_reader.py",
    "audit-third-parties": "examples/test_audit_page.py",
    "regression-gates": "test_own_project.py",
    "your-own-filter": "test_own_project.py",
}
"""Pages whose outputs another test compares."""


def with_outputs() -> set[str]:
    """Return the pages that show commands with what they print."""
    return {page.stem for page in DOCS.glob("*.md") if blocks_of(page.read_text(encoding="utf-8"))}


def test_every_output_of_a_page_is_compared() -> None:
    """A page that neither `make pictures` nor another test runs would go stale."""
    assert with_outputs() == {*SCRIPT.PICTURES, *ELSEWHERE}
    for page, file in ELSEWHERE.items():
        assert f"{page}.md" in (DOCS.parent / "tests" / file).read_text(encoding="utf-8")


def test_a_page_that_shows_something_else_is_found(tmp_path: Path) -> None:
    page = "```console\n$ echo agree; exit 1\nagree\n$ echo disagree\n```\n"
    assert len(list(faults(page, tmp_path))) == 1  # nothing of the second is shown
    wrong = page.replace("\nagree", "\nverdict").replace("echo disagree", "exit 2")
    assert [one.split(": ")[1] for one in faults(wrong, tmp_path)] == ["'verdict'", "exit code 2"]


def test_outputs_are_shortened_and_rewritten(tmp_path: Path) -> None:
    lines = "".join(f"row {i}\n" for i in range(40))
    times = "a\nseconds  read 0.1,\n         check 0.2\nb, 35.1 scans/s\n"
    assert SCRIPT.shortened(times) == "a\nb, ... scans/s\n"
    assert SCRIPT.shortened(lines).splitlines()[11:14] == ["row 11", "...", "row 24"]
    page = "text\n\n```console\n$ echo one\nstale\n```\n\nmore\n"
    assert SCRIPT.rewritten(page, tmp_path) == page.replace("stale", "one")


def test_every_picture_of_a_page_is_there_and_small() -> None:
    for page in DOCS.glob("*.md"):
        for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (DOCS / name).stat().st_size < 500_000, f"{page.name}: {name}"
    made = [name for pictures in SCRIPT.PICTURES.values() for name in pictures]
    assert [name for name in made if not (DOCS / name).is_file()] == []
