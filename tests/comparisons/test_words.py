"""What a user reads: every kind of cause is explained, and no text has a word of the old idiom."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from comparisons.report.explain import every_explanation
from tools.verdicts_page import written

ROOT = Path(__file__).resolve().parents[2]
VERDICTS = (ROOT / "docs" / "verdicts.md").read_text(encoding="utf-8")
USER_FACING = ("comparisons", "graphslam", "slamcheck")
BANNED = re.compile(
    r"\b(sightings?|told|begun|wild|(un)?proven|culprits?|hangs? on|held against|worth|handed in"
    r"|hand in|look at|surer|as meant|as if|judged by|beginnings?)\b",
    re.IGNORECASE,
)
NAMES = re.compile(r"sightings\.csv|\[sightings\]")
"""What the release 0.1 called a file; also the section of it."""


def literals(source: str) -> Iterator[str]:
    """Yield texts of several words that are not docstrings, f-strings without their values."""
    tree = ast.parse(source)
    skipped: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        if isinstance(node, ast.FormattedValue):
            skipped |= {id(inner) for inner in ast.walk(node.value)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or id(node) in skipped:
            continue
        if isinstance(node.value, str) and " " in node.value.strip():
            yield node.value


def old_words(source: str) -> list[str]:
    return [text for text in literals(source) if BANNED.search(NAMES.sub("", text))]


def kinds_in(source: str) -> set[str]:
    """Return the kinds that calls of Cause or motion name, where they name one by a literal."""
    return {
        str(call.args[0].value)
        for call in ast.walk(ast.parse(source))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id in ("Cause", "motion")
        and call.args
        and isinstance(call.args[0], ast.Constant)
        and call.args[0].value
    }


def sources() -> Iterator[Path]:
    for name in USER_FACING:
        path = ROOT / name
        assert path.exists(), name
        yield from sorted(path.rglob("*.py")) if path.is_dir() else [path]


@pytest.mark.slow
def test_every_kind_of_cause_is_explained() -> None:
    used: set[str] = set()
    for path in (ROOT / "comparisons").rglob("*.py"):
        used |= kinds_in(path.read_text(encoding="utf-8"))
    used |= {"frame", "scale"}  # a variable's values in checks.diagnosis.diagnosis
    assert used == set(every_explanation())


def test_the_page_of_verdicts_says_what_the_code_says() -> None:
    assert written(VERDICTS) == VERDICTS, "run make settings"
    for kind, one in every_explanation().items():
        assert f"\n## Cause: {kind}\n\n**{one.title}.**" in VERDICTS
    for old, new in (
        ("are assigned to", "belong to"),
        ("| `unverified` |\n| [`linear", "| `agree` |\n| [`linear"),
    ):
        assert written(VERDICTS.replace(old, new, 1)) == VERDICTS
    gone = VERDICTS.replace("## Cause: motion", "## Motion")
    assert "\n## Cause: motion\n" in written(gone), "a kind without a section was not seen"


@pytest.mark.parametrize("kind", every_explanation())
def test_an_explanation_is_of_whole_sentences(kind: str) -> None:
    one = every_explanation()[kind]
    for text in (one.meaning, one.check):
        assert text.endswith(".")
        assert 1 <= len(re.findall(r"\.(?: |$)", text)) <= 4
    assert not BANNED.search(f"{one.title} {one.meaning} {one.check}")


@pytest.mark.slow
def test_no_text_has_a_word_of_the_old_idiom() -> None:
    found = {
        str(path.relative_to(ROOT)): words
        for path in sources()
        if (words := old_words(path.read_text(encoding="utf-8")))
    }
    assert found == {}


def test_a_text_with_an_old_word_is_found() -> None:
    assert old_words('raise InputError(f"{path}: {count} sightings were begun twice")') == [
        " sightings were begun twice"
    ]
    assert old_words('"""Sightings are told."""') == []
    assert old_words('text = "no such file as sightings.csv"') == []
    assert old_words('text = f"the {told} of {sighting}"') == []
