"""What jobs print: the outcome first, then why, in full, in 80 columns, whatever the log."""

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import pytest
from rich.console import Console

from comparisons.checks.accuracy import accuracy_lines
from comparisons.config import CheckConfig, SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.figures import METRES, Less, More, Named, percent, rows_of
from comparisons.jobs.check import check
from comparisons.pipeline.solve import solve
from comparisons.report.check import CheckReport
from comparisons.report.ladder import LadderStep
from comparisons.report.rows import gap_rows
from comparisons.report.run import RunReport
from comparisons.report.solution import SolutionReport
from comparisons.report.terminal import (
    DECIDING,
    MOST,
    WIDTH,
    Line,
    Summary,
    brief,
    fit,
    print_summary,
    table,
)
from comparisons.words import Cause, Row
from tests.commands import Done, slamcheck
from tests.helpers import compared, first_seconds, simulated

LONG = "a cause with many words " * 40
CAUSE = Cause(gap="linearisation", evidence=LONG, hint="look there")
FULL = Summary(
    headline="verdict: disagree, truth gap, association unchecked; filter inconsistent "
    "(fails on disagreement, consistency, truth, association)",
    look="disagree",
    causes=[CAUSE] * 7,
    remarks=[LONG] * 9,
    steps=[
        LadderStep(gap=gap, above="EKF", below="linear problem, smoother's factors",
                   sigma=-1.2e-101, covariance=-1.2e-101, fails=True)
        for gap in ("algebra", "model", "linearisation", "truth")
    ],
    lines=[(name, LONG) for name in ("agreement", "consistency", "accuracy")],
)  # fmt: skip


def faults(lines: list[Line], headline: str = "verdict: ") -> list[str]:
    """What breaks the bound; the last line holds a path, which may be longer."""
    texts = [line.text for line in lines]
    found = [f"line {i}: {one}" for i, one in enumerate(texts[:-1]) if len(one) > WIDTH]
    if not texts[0].startswith(headline):
        found.append(f"first is {texts[0]}")
    return found


def few(causes: int, remarks: int) -> Summary:
    return replace(FULL, causes=FULL.causes[:causes], remarks=FULL.remarks[:remarks])


@pytest.mark.parametrize(
    "summary",
    [FULL, *(few(i, j) for i in range(4) for j in range(3)), replace(FULL, steps=(), lines=())],
)
def test_any_summary_keeps_its_width(summary: Summary) -> None:
    lines = brief(summary, "a/" * 100)
    assert faults(lines) == []
    if summary.causes:
        assert lines[1].text.startswith("  linearisation gap: a cause")


def test_a_wider_one_is_noticed() -> None:
    lines = brief(FULL, "out")
    assert faults([*lines[:1], Line("x" * 81), *lines[2:]]) == [f"line 1: {'x' * 81}"]
    assert faults(lines[::-1])[-1] == "first is report:      out"


def joined(lines: list[Line]) -> str:
    return " ".join(line.text.strip() for line in lines)


def deciding_lines(lines: list[Line]) -> int:
    """How many lines stand between the one in which the cause begins and the hint, or the end."""
    texts = [line.text for line in lines[1:]]
    return (
        next(
            (i for i, one in enumerate(texts) if one.strip().startswith(("hint: ", "also: "))),
            len(texts),
        )
        - 1
    )


FACTS = "; ".join(f"fact {k} of many words that say what was measured" for k in range(12))


@pytest.mark.parametrize("evidence", ["short", FACTS, LONG, f"{FACTS} ({FACTS})", "x" * 900])
@pytest.mark.parametrize("reasons", [(), ("a departure at 3 s",), (LONG,), (FACTS,) * 4])
def test_the_cause_stands_in_line_two_and_six_lines_decide(
    evidence: str, reasons: tuple[str, ...]
) -> None:
    cause = replace(CAUSE, evidence=evidence)
    summary = replace(FULL, causes=[cause, CAUSE], reasons=reasons, steps=(), lines=())
    lines = brief(summary)
    assert lines[1].text.startswith("  linearisation gap: ")
    assert deciding_lines(lines) <= DECIDING
    said = joined(lines)
    assert "also: " in said
    assert "9 notes; -v lists them" in said
    assert ("the rest of the evidence" in said) == (evidence != "short" or "..." in said[80:])
    assert deciding_lines(brief(summary, whole=True)) > DECIDING or evidence == "short"
    alone = brief(replace(summary, causes=()))
    assert len(alone) < 2 or deciding_lines(alone) <= DECIDING or not reasons


def test_what_follows_is_one_line_and_no_more_is_claimed() -> None:
    """Explained is what a job says is so; all else stands beside it."""
    rows = [Row("NEES", "pose", "7", "0 to 5", inside) for inside in (False, True, None)]
    causes = [CAUSE, replace(CAUSE, gap="optimum"), replace(CAUSE, gap="optimum")]
    summary = Summary(headline="verdict: disagree", causes=causes, rows=rows)
    cause = [replace(one, evidence="an angle") for one in causes]
    last = brief(replace(summary, causes=cause))[-1].text
    assert last == "  also: optimum, 1 figure outside the band; -v lists them"
    told = replace(summary, causes=cause[:1], explained=("model gap", "first difference"))
    assert brief(told)[-2].text.startswith("  explained by it: model gap, first difference; also: ")
    assert "explained" not in joined(brief(replace(told, explained=())))


def test_hints_are_bright() -> None:
    styles = {line.style for line in brief(FULL) if "hint: " in line.text}
    assert styles == {"bold"}


def test_all_is_whole_where_it_is_asked_for() -> None:
    said = joined(brief(FULL, "out", whole=True))
    assert said.count(f"linearisation gap: {LONG.strip()} hint: look there") == 7
    assert said.count(f"note: {LONG.strip()}") == 9
    notes = brief(few(0, 9))
    assert joined(notes).count("note: ") == MOST
    assert "4 more notes; -v lists them" in joined(notes)
    plain = brief(Summary(headline="verdict: agree"), "out")
    assert [line.text for line in plain] == ["verdict: agree", "report:      out"]


def test_texts_break_at_words_and_obey_nobody() -> None:
    assert fit("one two three", 8) == ["one two", "three"]
    assert fit("one\x1b[31m\ntwo", 20) == ["one?[31m two"]
    assert max(map(len, fit("x" * 300, 80))) == 80
    assert fit("") == [""]


def test_figures_are_columns_by_group() -> None:
    rows = [
        Row("NEES", "pose, mean (expected 3)", "2.39", "0.22 to 9.35 (95 %)", True),
        Row("NEES", "heading, mean (expected 1)", "7", "0.001 to 5.02 (95 %)", False),
        Row("Log", "name", "word " * 40),
    ]
    lines = [line.text for line in table(rows)]
    assert lines[0] == "NEES"
    assert lines[1].split("  ")[-1].strip() == "in"
    assert lines[2].endswith("OUT")
    assert lines[3] == "Log"
    assert max(map(len, lines)) <= WIDTH
    assert list(table(rows))[2].style == "red"


@pytest.mark.slow
def test_real_outcomes_keep_their_width() -> None:
    log = first_seconds(simulated(seed=1), 20.0)
    named = replace(log, name="a log whose name is as long as a whole line of a terminal " * 2)
    c = compared(named)
    result = RunReport.build(c)
    agree = RunReport(c, result).summary()
    assert faults(brief(agree, "out")) == []
    assert [step.gap for step in agree.steps] == ["algebra", "model", "linearisation", "truth"]
    assert [name for name, _ in agree.lines] == ["agreement", "consistency", "accuracy"]
    far = result.model_copy(update={"verdict": "disagree", "causes": FULL.causes})
    assert faults(brief(RunReport(c, far).summary(), "out")) == []
    unverified = RunReport(c, result.model_copy(update={"verdict": "unverified"})).summary()
    assert unverified.look == "unverified"
    given = ExternalEstimate.of(c.ekf.estimate)
    for shift, outcome in (
        (0.0, "agree; grade: equal"),
        (5.0, "disagree, filter inconsistent; grade: wrong"),
    ):
        moved = replace(given, pose=given.pose + shift)
        lines = brief(CheckReport.of(check(named, moved, CheckConfig())).summary(), "out")
        assert faults(lines, f"verdict: {outcome}") == []
    solved = SolutionReport.of(solve(named, SolveConfig())).summary()
    assert faults(brief(solved, "out"), "verdict: verified") == []


def test_the_ladder_has_a_limit_for_each_gap() -> None:
    step = LadderStep(gap="linearisation", above="EKF", below="smoother", sigma=6.2, limit=1.0)
    open_end = replace(step, sigma=None, limit=None, judged=False)
    heading, passed, absent = (
        line.text.split() for line in brief(Summary(headline="", steps=[step, open_end]))[1:]
    )
    assert heading[-3:] == ["limit", "cov.,", "rel."]
    assert passed[-3:] == ["6.2", "1", "-"]
    assert absent[-3:] == ["-", "-", "-"]


def test_a_gap_is_marked_where_it_exceeds_its_limit() -> None:
    step = LadderStep(
        gap="linearisation", above="a", below="b", sigma=6.2, covariance=2.0, limit=1.0
    )
    for changed, marks in (
        (replace(step, fails=True), [False, None]),
        (replace(step, sigma=0.5), [True, None]),
        (replace(step, sigma=0.5, fails=True), [True, False]),
        (step, [None, None]),
        (replace(step, judged=False), [None, None]),
    ):
        rows = gap_rows([changed])
        assert rows[0].band == "<= 1 sigma"
        assert [row.inside for row in rows] == marks


def test_accuracy_takes_the_reference_that_there_is() -> None:
    assert accuracy_lines({"EKF": None}) == []


def test_colour_is_for_terminals() -> None:
    def printed(**more: Any) -> str:
        buffer = io.StringIO()
        console = Console(file=buffer, soft_wrap=True, no_color=False, **more)
        print_summary(FULL, console, "out", verbose=True)
        return buffer.getvalue()

    assert "\x1b[" in printed(force_terminal=True, color_system="standard")
    assert "\x1b" not in printed()


def solved(folder: Path, *arguments: str) -> Done:
    return slamcheck("solve", "simulated-loop", "--out", "out", *arguments, cwd=folder, columns=80)


@pytest.mark.slow
def test_json_quiet_and_verbose(tmp_path: Path) -> None:
    plain = solved(tmp_path)
    assert plain.stdout.splitlines()[0] == "verdict: verified"
    assert "\x1b" not in plain.stdout
    asked = solved(tmp_path, "--json")
    assert json.loads(asked.stdout) == json.loads((tmp_path / "out/solution.json").read_text())
    silent = solved(tmp_path, "-q")
    assert (silent.returncode, silent.stdout, silent.stderr) == (0, "", "")
    full = solved(tmp_path, "-v").stdout
    assert full.startswith(plain.stdout)
    assert "\nSmoother\n" in full
    both = solved(tmp_path, "-q", "-v")
    assert (both.returncode, both.stdout) == (2, "")
    assert "--verbose and --quiet exclude each other" in both.stderr


@pytest.mark.parametrize(
    ("key", "name"),
    [("truth", "truth gap"), ("oracle", "optimum not verified"), ("dropout", "dropout")],
)
def test_a_cause_has_a_name_that_readers_know(key: str, name: str) -> None:
    cause = Cause(gap=key, evidence="seen", hint="look there")
    lines = brief(Summary(headline="verdict: unverified", causes=[cause]))
    assert [line.text for line in lines[1:]] == [f"  {name}: seen", "    hint: look there"]


@dataclass(frozen=True)
class Counted:
    found: Annotated[More[int], Named("found", "{} of {.all}")]
    all: int
    error_m: Annotated[Less[float | None], Named("error", METRES)] = None
    share: Annotated[float, Named("share", percent)] = 0.0


def test_figures_stand_in_tables_as_they_are_declared() -> None:
    """In the order of the fields, or as asked; what is None, or has no name, does not."""
    some = Counted(2, 3, share=0.5)
    assert rows_of("Map", some) == [Row("Map", "found", "2 of 3"), Row("Map", "share", "50.0 %")]
    every = replace(some, error_m=0.25)
    asked = rows_of("Map", every, ("error_m", "all", "found"), before="landmarks: ")
    assert asked == [
        Row("Map", "landmarks: error", "0.250 m"),
        Row("Map", "landmarks: found", "2 of 3"),
    ]


def test_what_explains_the_first_cause_stands_below_it_where_it_has_room() -> None:
    noise = Cause(gap="noise", evidence="chi-square is too high", hint="check the sigma")
    causes = [replace(CAUSE, gap="oracle", evidence="chi-square 8 above 5"), noise]
    lines = [line.text for line in brief(Summary(headline="verdict: unverified", causes=causes))]
    assert lines[3:] == ["  noise: chi-square is too high", "    hint: check the sigma"]
    for other in (replace(noise, gap="optimum"), replace(noise, evidence=LONG)):
        lines = [line.text for line in brief(Summary(headline="", causes=[causes[0], other]))]
        assert lines[3:] == [f"  also: {other.gap}; -v lists them"]
