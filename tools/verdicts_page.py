"""The causes in `docs/verdicts.md`, written anew: `python -m tools.verdicts_page`.

What a kind of cause means, what to check, what it decides, the slots of the grammar, the edges of
graphs and the formulas of events come from the code. How it is found, examples and how often it
errs are by hand.
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from comparisons.faults.recipes import formulas_in_words
from comparisons.report.explain import edge_rows, every_explanation, grammar_rows
from comparisons.words import DECIDES, Explanation

PAGE = Path(__file__).resolve().parents[1] / "docs" / "verdicts.md"
_TABLE = re.compile(r"\| kind \| .*?\n\n", re.DOTALL)
_GRAMMAR = re.compile(r"\| slot \| .*?\n\n", re.DOTALL)
_EDGES = re.compile(r"\| edges of a graph \| .*?\n\n", re.DOTALL)
_FORMULAS = re.compile(r"\| event \| .*?\n\n", re.DOTALL)
_SECTION = re.compile(r"^## Cause: (\w+)\n\n(.*?)(?=^## )", re.DOTALL | re.MULTILINE)
_WIDTH = 120


def written(page: str) -> str:
    """Return the page with what the code says of each kind of cause."""
    kinds = every_explanation()
    own = {one[1]: one[2] for one in _SECTION.finditer(page)}
    sections = [_section(kind, kinds[kind], text) for kind, text in own.items() if kind in kinds]
    sections += [_section(kind, one, "") for kind, one in kinds.items() if kind not in own]
    found = list(_SECTION.finditer(page))
    page = page[: found[0].start()] + "".join(sections) + page[found[-1].end() :]
    page = _GRAMMAR.sub(lambda _: _grammar(), page, count=1)
    page = _EDGES.sub(lambda _: _edges(), page, count=1)
    page = _FORMULAS.sub(lambda _: _formulas(), page, count=1)
    return _TABLE.sub(lambda _: _table(kinds), page, count=1)


def _grammar() -> str:
    rows = [f"| {' | '.join(map(str, row))} |" for row in grammar_rows()]
    head = "| slot | rows | columns | faults | named by |"
    return "\n".join((head, "|---|---|---|---|---|", *rows, "", ""))


def _edges() -> str:
    rows = [f"| {' | '.join(map(str, row))} |" for row in edge_rows()]
    head = "| edges of a graph | components | faults without a number | with fitted numbers |"
    return "\n".join((head, "|---|---|---|---|", *rows, "", ""))


def _formulas() -> str:
    rows = [f"| {name} | `{text}` |" for name, text in formulas_in_words().items()]
    return "\n".join(("| event | formulas |", "|---|---|", *rows, "", ""))


def _table(kinds: dict[str, Explanation]) -> str:
    rows = [
        f"| [`{kind}`](#cause-{kind}) | {one.title} | {DECIDES[one.decides]} |"
        for kind, one in kinds.items()
    ]
    return "\n".join(("| kind | what is wrong | what it decides |", "|---|---|---|", *rows, "", ""))


def _section(kind: str, one: Explanation, text: str) -> str:
    """Return a section. text: the former one, of which what is written by hand stays."""
    hand = [part for part in text.strip().split("\n\n") if part and not part.startswith("**")]
    check = _wrapped(f"What to check: {one.check}")
    places = [k for k, part in enumerate(hand) if part.startswith("What to check:")]
    if places:
        hand[places[0]] = check
    else:
        hand.append(check)
    meaning = _wrapped(f"**{one.title}.** {one.meaning}")
    return "\n\n".join([f"## Cause: {kind}", meaning, *hand]) + "\n\n"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, _WIDTH, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
