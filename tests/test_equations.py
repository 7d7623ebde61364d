"""docs/equations.md has one row for every numbered equation, and its rows say what is so.

Each check takes the file's text or rows and returns complaints, so that a broken text can show
that the check rejects it.
"""

import ast
import io
import os
import re
import shlex
import subprocess
import sys
import tokenize
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.graphslam.skips import pass_on

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "equations.md").read_text()

NUMBERS = {
    "G ": 23,
    "M ": 17,
    "N 2.": 62,
    "N 3.": 30,
    "N 4.": 20,
    "N 5.": 17,
    "N 6.": 4,
    "N A.": 20,
    "N B.": 11,
    "N C.": 22,
}
"""How many numbered equations each document or chapter has; they count from 1 without gaps."""
BLANK = ("N A.12",)
"""Numbers that stand alone in print."""
AUTHOR = {"G": "Guivant", "M": "Misono", "N": "Nieto"}
NOT_HERE = "not here, because "
NOT_IMPLEMENTED = "not implemented"
PROGRAMS = ("slamcheck ", "python -m research.documents ")
"""How the commands begin by which functions are reached; DATA in them is the real logs' folder."""
WATCHER = """
import atexit, sys, threading
codes = set()
def watch(frame, event, _):
    if event == "call":
        codes.add(frame.f_code)
def leave():
    sys.setprofile(None)
    with open(listed, "w") as file:
        file.write("\\n".join(f"{code.co_filename}:{code.co_qualname}" for code in codes))
listed, *words = sys.argv[1:]
if words[0] == "slamcheck":
    from comparisons.cli.app import main
    sys.argv = words
else:
    from research.documents.__main__ import main
    sys.argv = words[2:]
atexit.register(leave)
threading.setprofile(watch)
sys.setprofile(watch)
main()
"""
SECTIONS = "Sections without numbered equations"


class Row(NamedTuple):
    """A line of a table. computed_by, checked_by: places `path:name` or `path::name`."""

    label: str
    formula: str
    computed: str
    checked: str
    reached: str
    note: str

    @property
    def computed_by(self) -> list[tuple[str, str]]:
        return re.findall(r"`([\w/]+\.py):(\w[\w.]*)`", self.computed)

    @property
    def checked_by(self) -> list[tuple[str, str]]:
        return re.findall(r"`([\w/]+\.py)::(\w+)`", self.checked)

    @property
    def commands(self) -> list[str]:
        return re.findall(r"`([^`]+)`", self.reached)

    @property
    def oracle(self) -> bool:
        """A function of the tests computes it."""
        return bool(self.computed_by) and all(
            path.startswith("tests/") for path, _ in self.computed_by
        )

    @property
    def not_here(self) -> bool:
        return self.computed.startswith(NOT_HERE)


def tables(text: str) -> dict[str, list[Row]]:
    """Rows by the heading of their table."""
    found: dict[str, list[Row]] = {}
    for part in text.split("\n## ")[1:]:
        heading, *lines = part.splitlines()
        table = [line for line in lines if line.startswith("|")][2:]
        cells = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in table]
        found[heading] = [Row(*row) for row in cells]
    return found


def equations(text: str) -> list[Row]:
    return [row for heading, rows in tables(text).items() if heading != SECTIONS for row in rows]


def wanted() -> list[str]:
    return [f"{stem}{n}" for stem, most in NUMBERS.items() for n in range(1, most + 1)]


def miscounted(text: str) -> list[str]:
    """Numbers without exactly one row, rows without a number, rows in the wrong table."""
    labels = [row.label for row in equations(text)]
    wrong = [n for n in wanted() if labels.count(n) != 1]
    wrong += [label for label in labels if label not in wanted()]
    for heading, rows in tables(text).items():
        chapter = heading.split(":")[0]
        known = {row.label for row in rows if re.match(rf"{chapter}[ .]\w+$", row.label)}
        known |= {row.label for row in rows if heading == SECTIONS}
        wrong += [row.label for row in rows if row.label not in known]
    return wrong


@cache
def source(path: str) -> str:
    return (ROOT / path).read_text()


@cache
def chain(path: str, name: str) -> tuple[ast.AST, ...]:
    """The module and the classes that a name lies in, and itself; empty where there is none."""
    if not (ROOT / path).is_file():
        return ()
    nodes: list[ast.AST] = [ast.parse(source(path))]
    for part in name.split("."):
        inner = ast.iter_child_nodes(nodes[-1])
        kinds = (ast.FunctionDef, ast.ClassDef)
        named = [node for node in inner if isinstance(node, kinds) and node.name == part]
        if not named:
            return ()
        nodes.append(named[-1])
    return tuple(nodes)


def pointing_nowhere(text: str) -> list[str]:
    """Functions, classes and tests that do not exist."""
    rows = [row for table in tables(text).values() for row in table]
    named = [place for row in rows for place in (*row.computed_by, *row.checked_by)]
    wrong = [f"{path}:{name}" for path, name in named if not chain(path, name)]
    tests = [place for row in rows for place in row.checked_by]
    return wrong + [name for _, name in tests if not name.startswith("test_")]


def incomplete(text: str) -> list[str]:
    """Rows without a formula, or that name too much or too little."""
    wrong = []
    for row in [row for table in tables(text).values() for row in table]:
        names = row.computed.count("`"), row.checked.count("`")
        places = 2 * len(row.computed_by), 2 * len(row.checked_by)
        good = names == (0, 0) and not row.checked if row.not_here else min(places) > 0
        if not good or names != places:
            wrong.append(row.label)
    return wrong + [
        row.label
        for row in equations(text)
        if not re.fullmatch(r"\$[^$]+\$", row.formula) and row.label not in BLANK
    ]


def comments(path: str, node: ast.AST) -> list[str]:
    """Comments in the lines of a function or class."""
    assert isinstance(node, ast.FunctionDef | ast.ClassDef)
    tokens = tokenize.generate_tokens(io.StringIO(source(path)).readline)
    last = node.end_lineno or node.lineno
    return [
        token.string
        for token in tokens
        if token.type == tokenize.COMMENT and node.lineno <= token.start[0] <= last
    ]


_PLACES = r"[\dA-C][\w.]*(?: \([a-z]\))?"
_NO_EQUATION = re.compile(
    rf"\b(?:sections?|chapters?|figs?\.|tables?|examples?|appendix)\s+{_PLACES}"
    rf"(?:(?:, and | and |, | to )(?!eq){_PLACES})*",
    re.IGNORECASE,
)
_DOTTED = re.compile(r"(?<![\w.])([2-6A-C])\.(\d+)(?!\.?\d)(?: to \1\.(\d+))?")
_LIST = r"(\d+(?!\.?\d)(?:(?:, and |, | and | to )\d+(?!\.?\d))*)"
_PLAIN = re.compile(rf"\b(?:eqs?\.|equations?) {_LIST}|^# {_LIST}(?:,|$)", re.IGNORECASE)


def spanned(first: str, last: str | None) -> range:
    return range(int(first), int(last or first) + 1)


def named_numbers(texts: list[str]) -> set[str]:
    """Numbers of equations in docstrings and comments, as the tables have them.

    Nieto's have a dot, "eqs. 3.7, C.2 to C.4"; plain ones are of whoever is named, "eqs. 10 and 11"
    or "# 4" beside a line.
    """
    found: set[str] = set()
    flat = [_NO_EQUATION.sub("", " ".join(text.split())) for text in texts]
    for text in flat:
        for chapter, first, last in _DOTTED.findall(text):
            found |= {f"N {chapter}.{n}" for n in spanned(first, last)}
        for numbers in map("".join, _PLAIN.findall(text)):
            for document in "GM":
                if any(AUTHOR[document] in one for one in flat):
                    for first, last in re.findall(r"(\d+)(?: to (\d+))?", numbers):
                        found |= {f"{document} {n}" for n in spanned(first, last)}
    return found


def texts_of(path: str, name: str) -> list[str]:
    """Docstrings of a function, of its classes and its module, and the comments in its body."""
    nodes = chain(path, name)
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = [ast.get_docstring(node) for node in nodes if isinstance(node, kinds)]
    return [text for text in docstrings if text] + comments(path, nodes[-1])


def unmentioned(text: str) -> list[str]:
    """Functions that do not say which equation they compute."""
    return [
        f"{row.label}: {path}:{name}"
        for row in equations(text)
        for path, name in row.computed_by
        if row.label not in named_numbers(texts_of(path, name))
    ]


def called_by(command: str, folder: Path) -> set[str]:
    """Run a command; return the functions of the project that it called, as `path:name`."""
    words = shlex.split(command)
    script = (*words, "--out", str(folder / "out"))
    done = subprocess.run(
        [sys.executable, "-c", WATCHER, str(folder / "called"), *script],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    pass_on(done.stderr)
    assert done.returncode in (0, 1, 3), f"{command}: {done.stderr}"
    start = f"{ROOT}/"
    lines = (folder / "called").read_text().splitlines()
    return {line.removeprefix(start) for line in lines if line.startswith(start)}


def misnamed(text: str) -> list[str]:
    """Rows that say nothing of what reaches them, or what the column does not allow."""
    wrong = []
    for row in [row for table in tables(text).values() for row in table]:
        known = [command for command in row.commands if command.startswith(PROGRAMS)]
        by_commands = bool(known) and known == row.commands
        reason = row.reached.startswith(f"{NOT_IMPLEMENTED}: ")
        good = row.reached == NOT_IMPLEMENTED if row.not_here else by_commands != reason
        if not good or (row.oracle and not reason):
            wrong.append(row.label)
    return wrong


def unreached(rows: Iterable[Row], called: Mapping[str, set[str]]) -> list[str]:
    """Functions of rows that none of the row's commands calls. called: by command."""
    wrong = []
    for row in rows:
        names = set[str]().union(*(called[command] for command in row.commands))
        for path, name in row.computed_by:
            if not any(f"{call}.".startswith(f"{path}:{name}.") for call in names):
                wrong.append(f"{row.label}: {path}:{name}")
    return wrong


def test_every_number_has_one_row() -> None:
    assert len(wanted()) == 226
    assert not miscounted(TEXT)


@pytest.mark.slow
def test_functions_and_tests_exist() -> None:
    assert not pointing_nowhere(TEXT)


def test_rows_name_a_function_and_a_test_or_say_why_not() -> None:
    assert not incomplete(TEXT)


@pytest.mark.slow
def test_functions_name_their_equations() -> None:
    assert not unmentioned(TEXT)


def by_command() -> dict[str, list[Row]]:
    """Rows by the commands that they name, all of them together."""
    grouped: dict[str, list[Row]] = {}
    for row in [row for table in tables(TEXT).values() for row in table]:
        if row.commands:
            grouped.setdefault("; ".join(row.commands), []).append(row)
    return grouped


def test_each_row_names_a_command_or_says_why_not() -> None:
    assert not misnamed(TEXT)


@pytest.mark.slow
@pytest.mark.parametrize("commands", by_command())
def test_commands_reach_their_equations(commands: str, tmp_path: Path, data: Path) -> None:
    called = {}
    for number, command in enumerate(commands.split("; ")):
        folder = tmp_path / str(number)
        folder.mkdir()
        called[command] = called_by(command.replace("DATA", str(data)), folder)
    rows = by_command()[commands]
    assert not unreached(rows, called)
    nothing = {command: set[str]() for command in called}  # broken: none is called
    assert len(unreached(rows, nothing)) == sum(len(row.computed_by) for row in rows)


@pytest.fixture
def data(request: pytest.FixtureRequest) -> Path:
    """The folder of the real logs, for commands that name DATA."""
    commands: str = request.node.callspec.params["commands"]
    if "DATA" not in commands:
        return ROOT
    folder: Path = request.getfixturevalue("shared_data")
    return folder


@pytest.mark.parametrize(
    ("label", "right", "wrong"),
    [
        ("M 3", "`slamcheck run", "`slam run"),
        ("M 3", "`slamcheck run simulated-loop --filter misono`", "not implemented"),
        ("M 3", "`slamcheck run simulated-loop --filter misono`", ""),
        ("N 3.3", "not implemented", "`slamcheck run`"),
        ("N 3.2", "not implemented: an oracle of the tests", "not implemented"),
    ],
)
def test_a_row_that_says_nothing_of_what_reaches_it_is_rejected(
    label: str, right: str, wrong: str
) -> None:
    row = row_of(label)
    assert right in row
    assert misnamed(TEXT.replace(row, row.replace(right, wrong))) == [label]


def row_of(label: str) -> str:
    (line,) = (line for line in TEXT.splitlines() if line.startswith(f"| {label} |"))
    return line


@pytest.mark.parametrize("label", ["G 10", "N 2.59", "N A.12", "N C.22"])
def test_a_number_without_a_row_or_with_two_is_rejected(label: str) -> None:
    row = row_of(label)
    assert miscounted(TEXT.replace(row + "\n", "")) == [label]
    assert label in miscounted(TEXT.replace(row, f"{row}\n{row}"))
    assert miscounted(TEXT.replace(f"| {label} |", f"| {label}, {label[:-1]}9 |"))


def test_a_row_in_the_table_of_another_chapter_is_rejected() -> None:
    row, other = row_of("N 4.7"), row_of("N 5.7")
    moved = TEXT.replace(row + "\n", "").replace(other, f"{other}\n{row}")
    assert miscounted(moved) == ["N 4.7"]


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("tree_detection.py:cluster`", "tree_detection.py:clusters`"),
        ("scan.py:Scan.point`", "scan.py:Scan.points`"),
        ("scan.py:Scan.point`", "scans.py:Scan.point`"),
        ("test_sog.py::test_value_is_equation_4_14`", "test_sog.py::test_value_is_equation_4_15`"),
        ("test_sog.py::test_value_is_equation_4_14`", "test_sog.py::random_sum`"),
    ],
)
def test_a_name_that_is_not_there_is_rejected(right: str, wrong: str) -> None:
    assert right in TEXT
    assert pointing_nowhere(TEXT.replace(right, wrong))


def test_rows_that_name_too_much_or_too_little_are_rejected() -> None:
    here, absent = tables(TEXT)["M: Misono et al. (2007)"][0], row_of("N 2.59")
    line = row_of(here.label)
    function, check = "`a.py:b`", "`tests/a.py::test_b`"
    for broken in (
        line.replace(here.computed, ""),
        line.replace(here.checked, ""),
        line.replace(here.computed, "KalmanState"),
        line.replace(here.computed, f"{here.computed}, `KalmanState`"),
        line.replace(here.formula, "linear"),
    ):
        assert incomplete(TEXT.replace(line, broken)) == [here.label]
    for broken in (
        absent.replace("association compares", f"{function} compares"),
        absent.replace("| |", f"| {check} |", 1),
    ):
        assert broken != absent
        assert incomplete(TEXT.replace(absent, broken)) == ["N 2.59"]


@pytest.mark.slow
def test_a_function_that_does_not_name_its_equation_is_rejected() -> None:
    row = row_of("N 4.15")
    other = row.replace("Scan.point`", "Scan.box`")
    (found,) = unmentioned(TEXT.replace(row, other))
    assert found == "N 4.15: ekf_reference/dense/scan.py:Scan.box"
    anywhere = unmentioned(TEXT.replace(row, row.replace("Scan.point`", "ScanSensor`")))
    assert "N 4.15: ekf_reference/dense/scan.py:ScanSensor" in anywhere


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("Nieto 2005, eqs. 3.7, C.2 to C.4.", {"N 3.7", "N C.2", "N C.3", "N C.4"}),
        ("Nieto 2005, section 3.4.1, eq. 3.6", {"N 3.6"}),
        ("Nieto 2005, sections 4.1, 4.2 and 4.3.2, Fig. 4.12 (b), Table 5.1", set[str]()),
        ("# A.9 and so on", {"N A.9"}),
        ("Guivant 2002, eqs. 10, 12 to 14 and 16", {"G 10", "G 12", "G 13", "G 14", "G 16"}),
        ("Guivant 2002, sections 4 and 4.1, 3 of them", set[str]()),
        ("Misono 2007, equation 4", {"M 4"}),
        ("eq. 4", set[str]()),
    ],
)
def test_numbers_are_read_from_docstrings(text: str, numbers: set[str]) -> None:
    assert named_numbers([text]) == numbers


def test_plain_numbers_beside_lines_are_of_the_named_author() -> None:
    assert named_numbers(["Misono 2007", "# 5, the turn's part", "# 7 metres"]) == {"M 5"}
