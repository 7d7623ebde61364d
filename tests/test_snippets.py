"""What README, documentation and help show is what the program takes."""

import ast
import builtins
import inspect
import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from pydantic import BaseModel, ValidationError

import slamcheck.pytest_plugin
from comparisons.cli.app import build
from comparisons.config import JOBS
from comparisons.errors import InputError
from comparisons.estimates.folder import Meta, read_meta
from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.scenarios.scenario import Scenario
from comparisons.logs.log_meta import LogModel

ROOT = Path(__file__).resolve().parents[1]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS]
GENERATED = {"command-line.md", "configuration.md", "result-schema.md", "api.md", "contributing.md"}
"""Pages that the site's build makes; tests/test_docs.py follows the links to them."""
HELP = sorted((ROOT / "comparisons" / "cli").glob("*.py"))
BLOCK = re.compile(r"^( *)```([\w+-]*)[^\n]*\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"(?<!`)`([^`]+)`(?!`)")
COMMAND = re.compile(r"^\s*(?:- )?(?:run: )?(?:\$ )?(?:[A-Z_]+=\S+ )*(slamcheck( .*)?)$")
LISTS = (["logs"], ["config"], ["config", "--schema"])
"""Command lines that are run: they only list."""
MODELS: dict[str, type[BaseModel]] = {
    "log.toml": LogModel,
    "estimate.toml": Meta,
    "a scenario": Scenario,
    "a study's settings": MonteCarloConfig,
    **{f"the settings of {name}": kind for name, kind in JOBS.items()},
}
FOREIGN = {"project", "tool", "build-system"}
"""Tables of other programs' TOML files."""


class Snippet(NamedTuple):
    """A piece of a page. language: of a fenced block; `span` within a sentence, `help` of help."""

    page: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def snippets(path: Path) -> Iterator[Snippet]:
    """Fenced blocks and spans of a page, or the examples in a command's help."""
    text, page = path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix()

    def at(place: int) -> int:
        return text.count("\n", 0, place) + 1

    if path.suffix == ".py":
        for found in re.finditer(
            r"^ {6}(slamcheck (?:.*\\\\\n)*.*?)(?:  .*)?$", text, re.MULTILINE
        ):
            yield Snippet(page, at(found.start()), "help", found[1].replace("\\\\\n", "\\\n"))
        return
    for found in BLOCK.finditer(text):
        yield Snippet(page, at(found.start()), found[2], found[3])
    prose = BLOCK.sub(lambda block: re.sub(r"[^\n]", " ", block[0]), text)
    for found in SPAN.finditer(prose):
        words = " ".join(found[1].replace("\\|", "|").split())
        if words.startswith("slamcheck "):
            yield Snippet(page, at(found.start()), "span", words)


def command_lines(snippet: Snippet) -> Iterator[str]:
    """Command lines of slamcheck in a snippet, those that go on after a backslash as one."""
    if snippet.language in ("python", "toml", "json"):
        return
    for line in snippet.text.replace("\\\n", " ").splitlines():
        if found := COMMAND.match(line):
            yield found[1]


ALL = [one for path in (*PAGES, *HELP) for one in snippets(path)]
LINES = [(one, line) for one in ALL for line in command_lines(one)]
CONSOLE = build(whole=True)


def written(language: str) -> list[Snippet]:
    return [one for one in ALL if one.language == language]


def shown(line: str) -> Iterator[list[str]]:
    """The arguments of a command line; where it offers `a|b`, of each choice."""
    line = re.sub(r"[\[\]]|\.\.\.|…", "", line)
    words = shlex.split(line, comments=True)[1:]
    for stop in ("|", ">", "2>", ";", "&&", "||"):
        words = words[: words.index(stop)] if stop in words else words
    yield from (list(one) for one in product(*(word.split("|") for word in words)))


class Reached(BaseException):
    """A job has all its settings and would read its log."""


def check_arguments(arguments: list[str], *, open_ended: bool) -> None:
    """Let the command line read arguments, and do nothing. Raises its own error, or Reached.

    open_ended: a sentence may leave out what must be given, and have a WORD for a value.
    """
    command: Any = CONSOLE
    name, given = "slamcheck", [_number(word) for word in arguments]
    context = None
    try:
        while True:
            context = command.make_context(name, list(given), parent=context)
            if not hasattr(command, "resolve_command"):
                break
            rest = [*getattr(context, "_protected_args", []), *context.args]
            if not rest:
                return
            name, command, given = command.resolve_command(context, rest)
    except Exception as error:
        if not (open_ended and _unsaid(error)):
            raise
        return
    settings = context.params
    whole_job = settings.get("log") is not None or not open_ended
    if context.command_path.split()[-1] in JOBS and whole_job and settings.get("config") is None:
        command.invoke(context)


def _number(word: str) -> str:
    return "1" if re.fullmatch("[A-Z]", word) else word


def _unsaid(error: Exception) -> bool:
    if type(error).__name__ in ("MissingParameter", "BadOptionUsage"):
        return True
    return re.search(r"'[A-Z]{2,}'", str(error)) is not None


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Jobs stop where they would read: their settings are complete and valid by then."""

    def stop(*_: Any, **__: Any) -> None:
        raise Reached

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("comparisons.pipeline.read.read_for", stop)
    monkeypatch.setattr("comparisons.estimates.external.read_external", stop)
    monkeypatch.setattr("comparisons.report.viewer.check_viewer", lambda *_: None)


def check_line(line: str, *, open_ended: bool = False) -> None:
    """Raise what the program says of a command line that it does not take."""
    for arguments in shown(line):
        try:
            check_arguments(arguments, open_ended=open_ended)
        except Reached:
            continue


def test_there_are_snippets() -> None:
    """The search finds what it looks for, whatever the pages say."""
    assert len(LINES) > 50
    assert {"toml", "span", "help"} <= {one.language for one in ALL}


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("path", [*PAGES, *HELP], ids=lambda path: path.name)
def test_command_lines_are_taken(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = path.relative_to(ROOT).as_posix()
    faults = []
    for one, line in LINES:
        if one.page == page:
            try:
                check_line(line, open_ended=one.language == "span")
            except (Exception, SystemExit) as error:
                faults.append(f"{one}: {line}: {error} {capsys.readouterr().err}")
    assert not faults, "\n".join(faults)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    "line",
    [
        "slamcheck rum simulated-loop",
        "slamcheck run simulated-loop --sead 7",
        "slamcheck run simulated-loop --filter full|comprest",
        "slamcheck run simulated-loop --seed seven",
        "slamcheck run simulated-loop --set ekf.nn_gaet=3",
        "slamcheck run simulated-loop --smoother-matcher generalised-icp",
        "slamcheck baseline safe my-log my-log.json",
        "slamcheck export",
    ],
)
def test_a_wrong_command_line_is_found(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises((Exception, SystemExit)):
        check_line(line)
    if "export" not in line:
        with pytest.raises((Exception, SystemExit)):
            check_line(line, open_ended=True)
    capsys.readouterr()


@pytest.mark.parametrize("arguments", LISTS, ids=" ".join)
def test_lists_are_shown(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with suppress(SystemExit):
        CONSOLE(arguments, standalone_mode=False)
    assert capsys.readouterr().out.strip()


def check_toml(text: str) -> None:
    """Raise ValueError unless the text is some file's of ours, or of a program we do not know."""
    given = tomllib.loads(text)
    if set(given) <= FOREIGN:
        return
    said = []
    for name, kind in MODELS.items():
        try:
            kind.model_validate(given)
        except (ValidationError, InputError) as error:
            said.append(f"{name}: {' '.join(str(error).split())[:200]}")
        else:
            return
    raise ValueError("no file of ours:\n" + "\n".join(said))


def test_toml_is_a_file_of_ours() -> None:
    for one in written("toml"):
        check_toml(one.text)


def test_toml_that_is_no_file_of_ours_is_found() -> None:
    check_toml('information = "filtered"\nestimator = "ekf"\n')
    check_toml('[tool.pytest.ini_options]\nslam_logs = "logs"\n')
    check_toml('job = "run"\n[ekf]\nfilter = "compressed"\n')
    for text in (
        'information = "filtred"\n',
        'information = "filtered"\nestimater = "ekf"\n',
        'job = "run"\n[ekf]\nfilter = "comprest"\n',
    ):
        with pytest.raises(ValueError, match="no file of ours"):
            check_toml(text)


def test_the_shortest_estimate_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "estimate.toml"
    path.write_text('information = "filtered"\nestimator = "ekf"\n')
    assert read_meta(path).version == 1
    path.write_text('version = 2\ninformation = "filtered"\n')
    with pytest.raises(InputError, match="version"):
        read_meta(path)


def test_json_parses() -> None:
    for one in written("json"):
        json.loads(one.text)


def classes() -> set[str]:
    """Names of all classes of the project."""
    folders = [ROOT / name for name in ("comparisons", "ekf_reference", "graphslam")]
    paths = [path for folder in folders for path in folder.rglob("*.py")]
    return {
        name
        for path in paths
        for name in re.findall(r"^class (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }


def unknown(text: str) -> list[str]:
    """Names that a piece of Python takes from us and that are not there.

    Imports, classes that a fragment only uses, and fixtures of its tests.
    """
    tree = ast.parse(text)
    faults, bound = [], set(dir(builtins))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom | ast.Import):
            source = ast.unparse(node)
            try:
                exec(source, {})  # noqa: S102
            except ImportError as error:
                faults.append(f"{source}: {error}")
            bound |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ClassDef):
            bound.add(node.name)
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            names = {argument.arg for argument in node.args.args}
            faults += sorted(name for name in names - FIXTURES if f"def {name}(" not in text)
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - bound
    return faults + sorted(name for name in used if name[0].isupper() and name not in classes())


FIXTURES = {"tmp_path", "capsys", "monkeypatch", "request"} | {
    name for name, _ in inspect.getmembers(slamcheck.pytest_plugin) if name.startswith("slam_")
}


def test_python_names_what_there_is() -> None:
    for one in written("python"):
        assert not unknown(one.text), one


def test_python_that_names_what_is_not_there_is_found() -> None:
    sound = "from comparisons.logs.bundled import open_log\nekf = Ekf(open_log('x'))\n"
    assert unknown(sound) == []
    assert unknown(sound.replace("Ekf(", "Efk(")) == ["Efk"]
    assert unknown(sound.replace("import open_log", "import open_lok")) != []
    assert unknown("def test_it(slam_log, slam_chek):\n    pass\n") == ["slam_chek"]
    with pytest.raises(SyntaxError):
        unknown("ekf = Ekf(\n")


def whole(text: str) -> bool:
    """Whether a piece of Python defines all that it uses."""
    names = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)]
    bound = {node.id for node in names if isinstance(node.ctx, ast.Store)} | set(dir(builtins))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom | ast.Import):
            bound |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef | ast.arg):
            bound.add(node.arg if isinstance(node, ast.arg) else node.name)
    return all(node.id in bound for node in names)


@pytest.mark.slow
def test_whole_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for one in written("python"):
        if whole(one.text):
            exec(compile(one.text, str(one), "exec"), {"__name__": "snippet"})  # noqa: S102


def test_a_fragment_is_told_from_a_whole() -> None:
    assert whole("import math\ndef f(x):\n    return math.sin(x)\nprint(f(1))\n")
    assert not whole("print(y)\n")


NAMED = re.compile(r"\b((?:examples|research|docs|tests)/[\w./-]+\.(?:py|md|ipynb|cpp|toml|png))")
EXTRA = re.compile(r"slamcheck\[([\w,]+)\]")


def absent(text: str, make: str, extras: set[str]) -> list[str]:
    """Files, extras and targets of make that a page names and that are not there."""
    found = [name for name in NAMED.findall(text) if not (ROOT / name).exists()]
    given = {one for names in EXTRA.findall(text) for one in names.split(",")}
    targets = re.findall(r"(?:`|^|\$ )make ([a-z][a-z-]*)", text, re.MULTILINE)
    found += [f"make {one}" for one in targets if f"\n{one}:" not in make]
    return sorted({*found, *given - extras})


def dead_links(text: str, folder: Path) -> list[str]:
    """Relative links to files, or to headings of pages, that are not there. Formulas are none."""
    found = []
    for link in re.findall(r"\]\((?!https?:)([\w./-]*(?:#[\w-]+)?)\)", text):
        file, _, anchor = link.partition("#")
        page, is_path = folder / file, ("." in file or "/" in file) and file not in GENERATED
        if is_path and not (page.exists() and (not anchor or anchor in headings(page))):
            found.append(link)
    return found


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings."""
    lines = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in lines}


def test_relative_links_lead_somewhere() -> None:
    for path in PAGES:
        assert not dead_links(path.read_text(encoding="utf-8"), path.parent), path
    wrong = "[a](none.md) [b](formats.md#no-such) [c](formats.md#trace) [d](../README.md) x](k+1)"
    assert dead_links(wrong, ROOT / "docs") == ["none.md", "formats.md#no-such"]


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    site = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert [page.name for page in DOCS if f" {page.name}" not in site] == []


def test_pages_name_files_extras_and_targets_that_exist() -> None:
    make = (ROOT / "Makefile").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(project["optional-dependencies"])
    for path in PAGES:
        assert not absent(path.read_text(encoding="utf-8"), make, extras), path
    wrong = "`make rum` pip install 'slamcheck[scans,rso]' examples/00_none.py"
    assert absent(wrong, make, extras) == ["examples/00_none.py", "make rum", "rso"]
