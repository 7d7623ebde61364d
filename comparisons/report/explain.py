"""Checks and causes in words, from what they say of themselves."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Iterable, Iterator
from pkgutil import resolve_name
from typing import Any

from comparisons.checks.causes import EXPLANATIONS
from comparisons.checks.check import Check, Question
from comparisons.checks.registry import BASIS, CHECKS, EXPLAINING, OF_RUN, OF_SOLUTION
from comparisons.config import config_class
from comparisons.errors import InputError
from comparisons.extension_names import EXTENSIONS
from comparisons.figures import kept_fields, meanings
from comparisons.words import DECIDES, Explanation, cause_name

_WIDTH = 80


def every_check(extensions: Iterable[str] = EXTENSIONS) -> Iterator[type[Check]]:
    """Yield the checks that every run is asked, then those of extensions, loaded one by one."""
    yield from map(type, (*CHECKS, *EXPLAINING))
    for name in extensions:
        yield resolve_name(config_class(name).extension)


def job_parts() -> list[type[Question[Any]]]:
    """Return what jobs have, of which their gaps are."""
    parts = (*BASIS, *OF_RUN, *OF_SOLUTION)
    return list(dict.fromkeys(type(part) for part in parts))


def event_checks() -> list[type[Question[Any]]]:
    """Return the checks of an audit, which a run's page does without."""
    from comparisons.checks.of_events import EVENT_CHECKS

    return [type(check) for check in EVENT_CHECKS]


def every_explanation() -> dict[str, Explanation]:
    """Return what each kind of cause means, the checks' own last."""
    own = {kind: one for check in every_check() for kind, one in check.explains.items()}
    return {**EXPLANATIONS, **own}


def explained(kind: str) -> Explanation | None:
    """Return what a kind of cause means, without a check being loaded that is not asked."""
    if kind in EXPLANATIONS:
        return EXPLANATIONS[kind]
    return next((one.explains[kind] for one in every_check() if kind in one.explains), None)


def overview() -> str:
    """Return every check with its question, and every cause with its title."""
    asked = [(one.name, _question(one)) for one in every_check()]
    own = len(asked) - len(EXTENSIONS)
    checks, more = asked[:own], asked[own:]
    events = [(check.name, _question(check)) for check in event_checks()]
    parts = [(part.name, _question(part)) for part in job_parts()]
    causes = [(name, one.title) for name, one in every_explanation().items()]
    longest = max(len(name) for name, _ in (*asked, *events, *parts, *causes)) + 2
    lines = []
    for title, rows in (
        ("Checks of a run:", checks),
        ("Checks on request, and sources of landmarks and motion:", more),
        ("Checks of an audit:", events),
        ("What results have besides:", parts),
        ("Causes of a verdict:", causes),
    ):
        named = [_wrapped(f"  {name:<{longest}}{words}", longest + 2) for name, words in rows]
        lines += ["", title, *named]
    lines += ["", "faults: how the faults of a filter are composed."]
    return "\n".join(lines[1:])


def explanation(name: str) -> str:
    """Return what a check asks, needs and finds, and what a cause means. Raises InputError.

    Of `faults` which are composed of what.
    """
    asked = _spoken(name)
    if asked == "faults":
        return composed_faults_in_words()
    checks: list[type[Question[Any]]] = [*every_check(), *event_checks(), *job_parts()]
    kinds = every_explanation()
    parts = ["\n".join(_of_check(check)) for check in checks if _spoken(check.name) == asked]
    asked = asked.removesuffix(" gap")
    parts += ["\n".join(_of_cause(*one)) for one in kinds.items() if one[0] == asked]
    if not parts:
        known = ", ".join(dict.fromkeys((*(check.name for check in checks), *kinds, "faults")))
        raise InputError(f"{name[:80]}: no check or cause is called so, expected one of {known}")
    return "\n\n".join(parts)


SEEN_BY = {
    "trace": "check of an estimate with a trace, by the matrices that it recorded",
    "estimate": "check of an estimate alone, by a filter with the fault beside it",
}
"""Who can name a composed fault."""


def grammar_rows() -> list[tuple[str, str, str, int, str]]:
    """Return each slot of a filter: name, rows, columns, number of faults, and who names them."""
    from comparisons.faults.grammar import SLOTS, compositions
    from comparisons.faults.planting import PLANTED, has

    return [
        (
            slot.name,
            ", ".join(slot.rows),
            ", ".join(slot.columns),
            sum(1 for _ in compositions(slot, has(slot))),
            "trace, estimate" if slot in PLANTED else "trace",
        )
        for slot in SLOTS
    ]


def edge_rows() -> list[tuple[str, str, int, int]]:
    """Return each slot of a graph's edges: name, components, changes without and with numbers."""
    from comparisons.faults.edges import SLOTS, faults_of

    rows = []
    for slot in SLOTS:
        every = {fault.kind: fault for fault in faults_of(slot)}.values()
        fitted = sum(1 for fault in every if fault.change.neutral)
        components = "x, y, heading" if slot.is_motion else "x, y"
        rows.append((slot.words, components, len(every) - fitted, fitted))
    return rows


def changes_in_words() -> list[str]:
    """Return what the grammar may say of a part of a slot, each change once."""
    from comparisons.faults.grammar import F, H, Q, compositions
    from comparisons.faults.planting import has

    said: dict[str, str] = {}
    for slot in (H, F, Q):
        for composition in compositions(slot, has(slot)):
            said.setdefault(
                composition.change,
                composition.said(*(number + 0.5 for number in composition.start)),
            )
    return [
        words for change, words in said.items() if "negated" not in change or change == "negated"
    ]


def composed_faults_in_words() -> str:
    """Return the grammar of faults: slots, formulas, changes, and who can name what."""
    from comparisons.faults.recipes import formulas_in_words

    rows = grammar_rows()
    lines = [
        _wrapped(
            f"A fault is a slot of a filter, a part of it and a change: {sum(r[3] for r in rows):,}"
            " are composed so. One is named only where it reproduces the records, or the estimate, "
            "to rounding.",
            0,
        ),
        "",
        "Slots, with the number of their faults, and who names them:",
    ]
    for name, of_rows, columns, count, who in rows:
        by = f" by {columns}" if columns else ""
        lines.append(_wrapped(f"  {name} ({of_rows}{by}): {count}; {who}", 4))
    lines += [
        "",
        _wrapped(
            "Formulas of events (audit, and check of a trace with snapshots). Each matrix is a "
            "slot, everywhere or in one place, and what a formula gives is one; a formula may lack "
            "a factor or a term, or have another sign, transpose, inverse, order of brackets or "
            "matrix:",
            0,
        ),
    ]
    lines += [_wrapped(f"  {name}: {text}", 4) for name, text in formulas_in_words().items()]
    lines += [
        "",
        _wrapped(
            "Edges of a pose graph (solve): what they measure, their ends, or what stands for "
            "their information. One is named where its optimum leaves the stated noise and is "
            "likelier by e^20 and more; with the number of changes, and of those that are fitted:",
            0,
        ),
    ]
    lines += [
        _wrapped(f"  {name} ({components}): {plain + fitted}; {fitted}", 4)
        for name, components, plain, fitted in edge_rows()
    ]
    lines += ["", "Who names them:"]
    lines += [_wrapped(f"  {who:<10}{words}", 12) for who, words in SEEN_BY.items()]
    lines += ["", "Changes, each of a part: all, a row, a column, a block, a term:"]
    return "\n".join((*lines, *(_wrapped(f"  {words}", 4) for words in changes_in_words())))


def _of_check(one: type[Question[Any]]) -> Iterator[str]:
    yield f"{_spoken(one.name)} ({one.of})"
    yield _wrapped(f"  asks:   {_question(one)}", 10)
    yield _wrapped(f"  needs:  {one.needs}", 10)
    yield _wrapped(f"  errs:   {one.errs}", 10)
    for _, kind in one.figures:
        text = meanings(kind)
        yield "  finds:"
        for field in kept_fields(kind):
            yield _wrapped(f"    {field}: {text[field]}", 6)


def _of_cause(name: str, found: Explanation) -> Iterator[str]:
    yield f"{cause_name(name)} (a cause): {found.title}"
    yield _wrapped(f"  {found.meaning}", 2)
    yield _wrapped(f"  {found.check}", 2)
    yield _wrapped(f"  decides: {DECIDES[found.decides].replace('`', '')}", 11)


def _spoken(key: str) -> str:
    return key.replace("_", " ").replace("-", " ")


def _question(one: type[Question[Any]]) -> str:
    return inspect.cleandoc(one.__doc__ or "").splitlines()[0]


def _wrapped(text: str, indent: int) -> str:
    return textwrap.fill(text, _WIDTH, subsequent_indent=" " * indent)
