"""Record results, and write the pages of results from the records.

    python -m research.record                       every table: its state and its time
    python -m research.record NAME ... [--data DIR] run these and record them
    python -m research.record --due [--idle]        record what is missing or stale
    python -m research.record --page                write the pages alone: docs/results*.md

`research/results.toml` names the pages and their tables: the text around them, and the commands
that make them.
A record is what those commands gave, with commit, date, seeds, machine, and a hash of each module
of the project that they loaded: docs/results/records/NAME.json. Comments and docstrings are not in
the hash, nor are modules that only print and draw (`UNHASHED`). A record is stale where a hash or
the command differs. Tables of times are made by --idle alone, on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import hashlib
import json
import os
import platform
import resource
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

from markdown.extensions.toc import slugify
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from research.documents.claims import in_words

ROOT = Path(__file__).resolve().parents[1]
REGISTRY = ROOT / "research" / "results.toml"
HASHED = ("ekf_reference/", "graphslam/", "comparisons/", "slamcheck/", "research/")
UNHASHED = (
    "comparisons/cli/",
    "comparisons/report/",
    "research/record.py",
    "research/results.toml",
)
LIBRARIES = ("numpy", "scipy", "gtsam", "kiss-icp", "open3d-cpu")
STALE = "**Stale: code that this result depends on, or its command, has changed since.**"
FRESH = "as recorded"
# Each process of a command leaves the list of the files that it loaded.
WATCHER = """
import atexit, os, sys, tempfile
def leave():
    files = {getattr(one, "__file__", None) or "" for one in list(sys.modules.values())}
    descriptor, _ = tempfile.mkstemp(dir=os.environ["RECORD_LOADED"])
    with os.fdopen(descriptor, "w") as listed:
        listed.write("\\n".join(files))
atexit.register(leave)
"""


class StoredResultError(Exception):
    """A record cannot be made or read: what, where, and what to do, in one line."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Picture(_Strict):
    """A picture of the page.

    file: in docs/. source: its name in the folder that the command writes; empty where the command
    itself names the picture.
    """

    file: str
    shows: str
    source: str = ""


class Table(_Strict):
    """What to record.

    command: one, or several by the label of their row. columns: titles with the place of a value in
    the JSON file of a run. minutes: of processor time, roughly. idle: holds times, to be measured
    on an idle machine.
    """

    name: str = Field(pattern=r"^[a-z0-9-]+$")
    title: str
    about: str = ""
    command: str | dict[str, str]
    seeds: str
    minutes: float
    idle: bool = False
    reader: Literal["printed", "runs", "claims", "montecarlo", "picture"] = "printed"
    columns: dict[str, str] = {}
    picture: Picture | None = None

    @property
    def commands(self) -> dict[str, str]:
        """Commands by label."""
        return {"": self.command} if isinstance(self.command, str) else self.command


class Section(_Strict):
    """A page of results: docs/results-NAME.md. after: what stands below its tables."""

    name: str = Field(pattern=r"^[a-z0-9-]+$")
    title: str
    about: str = ""
    after: str = ""
    table: tuple[Table, ...] = ()


class Registry(_Strict):
    """All that is or may be recorded.

    about, after: what the page that lists the others begins and ends with.
    """

    about: str
    after: str = ""
    section: tuple[Section, ...]

    @property
    def tables(self) -> dict[str, Table]:
        """All tables by name."""
        return {one.name: one for section in self.section for one in section.table}


class Machine(_Strict):
    """Where a record was made; nothing that names the machine itself."""

    cpu: str
    cores: int
    system: str
    versions: dict[str, str]

    def __str__(self) -> str:
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        return f"{self.cpu}, {self.cores} cores, {self.system}, {versions}"


class Record(_Strict):
    """One result.

    columns and rows: a table of texts. printed: what a command printed. pictures: files in docs/
    and their hashes. sources: files and their hashes (`code_hash`).
    """

    name: str
    title: str
    commands: dict[str, str]
    commit: str = Field(pattern=r"^[0-9a-f]{7,40}$")
    date: datetime.date
    seeds: str
    machine: Machine
    cpu_s: float
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    printed: tuple[str, ...]
    pictures: dict[str, str]
    sources: dict[str, str] = Field(min_length=1)


def code_hash(path: Path) -> str:
    """Return the hash of a file: of Python its syntax without comments and docstrings."""
    return _hash(path.read_bytes(), path.suffix)


@cache
def _hash(content: bytes, suffix: str) -> str:
    text = repr(_syntax(ast.parse(content))).encode() if suffix == ".py" else content
    return hashlib.sha256(text).hexdigest()[:10]


def _syntax(node: Any) -> Any:
    """A tree of plain values, the same from every version of Python (`ast.dump` is not)."""
    if isinstance(node, list):
        return [_syntax(one) for one in node if not _is_text(one)]
    if isinstance(node, ast.JoinedStr):  # 3.12.1 ends some with an empty text
        node.values = [one for one in node.values if getattr(one, "value", None) != ""]
    if isinstance(node, ast.AST):
        fields = [(k, _syntax(v)) for k, v in ast.iter_fields(node) if v is not None and v != []]
        return type(node).__name__, fields
    return node


def _is_text(node: Any) -> bool:
    """Whether a statement is a bare string, such as a docstring."""
    return isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str)


def changed(record: Record, root: Path = ROOT) -> list[str]:
    """Return the record's sources that are gone or differ, sorted."""
    return sorted(
        path
        for path, known in record.sources.items()
        if not (root / path).is_file() or code_hash(root / path) != known
    )


def state(table: Table, record: Record | None, root: Path = ROOT) -> str:
    """Return FRESH, or what makes it necessary to run the table's commands."""
    if record is None:
        return "missing"
    if record.commands != table.commands:
        return "stale (command)"
    files = changed(record, root)
    return f"stale ({len(files)} files)" if files else FRESH


def read_registry(path: Path = REGISTRY) -> Registry:
    """Read what is recorded. Raises RecordError."""
    try:
        registry = Registry.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, ValidationError) as error:
        raise StoredResultError(f"{path.name}: {_first(error)}") from error
    if len(registry.tables) != sum(len(section.table) for section in registry.section):
        raise StoredResultError(f"{path.name}: two tables have the same name")
    return registry


def read_records(registry: Registry, root: Path = ROOT) -> dict[str, Record]:
    """Read every record. Raises RecordError, also for one that the registry does not name."""
    found = {}
    for path in sorted((root / "docs/results/records").glob("*.json")):
        try:
            record = Record.model_validate_json(path.read_text(encoding="utf-8"))
        except ValidationError as error:
            raise StoredResultError(f"{path.name}: {_first(error)}; record it anew") from error
        if record.name != path.stem or record.name not in registry.tables:
            raise StoredResultError(
                f"{path.name}: no table of {REGISTRY.name}; delete it or name it"
            )
        found[record.name] = record
    return found


def _first(error: Exception) -> str:
    """The first fault of a validation, in one line."""
    if not isinstance(error, ValidationError):
        return str(error)
    fault = error.errors()[0]
    return f"{'.'.join(map(str, fault['loc']))}: {fault['msg'].lower()}"


def pages(registry: Registry, records: Mapping[str, Record], root: Path = ROOT) -> dict[str, str]:
    """Return the pages by file: docs/results.md, which lists the others, and one a section.

    A section without a record has none.
    """
    listed, found = list[str](), dict[str, str]()
    for section in registry.section:
        shown = [one for one in section.table if one.name in records]
        if not shown:
            continue
        file = f"results-{section.name}.md"
        parts = [f"# {section.title}", _MADE, section.about.strip()]
        machines = list(dict.fromkeys(str(records[table.name].machine) for table in shown))
        for table in shown:
            record = records[table.name]
            number = 1 + machines.index(str(record.machine))
            parts += _shown(table, record, root, f"machine {number}")
        found[file] = _joined([*parts, section.after.strip(), _machines(machines)])
        listed.append(f"- [{section.title}]({file})")
        listed += [f"    - [{one.title}]({file}#{slugify(one.title, '-')})" for one in shown]
    index = ["# Results", registry.about.strip(), "\n".join(listed), registry.after.strip()]
    return {"results.md": _joined(index), **found}


def _machines(machines: Sequence[str]) -> str:
    """Return what stands behind the numbers of a page's machines."""
    known = enumerate(machines, start=1)
    return "*" + " ".join(f"Machine {number}: {machine}." for number, machine in known) + "*"


_MADE = "[Results](results.md) says how the results of this page are made, and what *stale* means."


def _joined(parts: Sequence[str]) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def _shown(table: Table, record: Record, root: Path, machine: str) -> Iterator[str]:
    """One result as Markdown. machine: its name on the page."""
    yield f"## {table.title}"
    if state(table, record, root) != FRESH:
        yield STALE
    yield table.about.strip()
    if table.picture:
        yield f"![{table.picture.shows}]({table.picture.file})"
    if record.rows:
        ends = {label: (f"`{command}`",) for label, command in record.commands.items() if label}
        columns = (*record.columns, "command") if ends else record.columns
        rows = [(*row, *ends.get(row[0], ())) for row in record.rows]
        lines = [columns, ["---"] * len(columns), *rows]
        yield "\n".join("| " + " | ".join(_cell(one) for one in line) + " |" for line in lines)
    for is_table, printed in groupby(record.printed, lambda line: line.startswith("|")):
        text = "\n".join(printed)
        yield text if is_table else f"```text\n{text}\n```"
    commands = list(record.commands.values())
    command = f"`{commands[0]}`" if len(commands) == 1 else "each row's command"
    several = "seed" if record.seeds.isdigit() else "seeds"
    seeds = f"{several} {record.seeds}" if record.seeds[0].isdigit() else record.seeds
    yield (
        f"*{command} · commit {record.commit} · {record.date} · {seeds} · {machine} · "
        f"{record.cpu_s / 60.0:.1f} min of processor time · "
        f"[record](results/records/{record.name}.json)*"
    )


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


@dataclass(frozen=True)
class TableOutputs:
    """What the commands of a table left: folders by label, printed lines, loaded files."""

    folders: dict[str, Path]
    printed: list[str]
    loaded: set[str]


def run(table: Table, data: Path, work: Path) -> TableOutputs:
    """Run all commands of a table in `work`. Raises RecordError where one fails."""
    loaded = work / "loaded"
    loaded.mkdir()
    (work / "sitecustomize.py").write_text(WATCHER)
    settings = {
        "PYTHONPATH": os.pathsep.join((str(work), str(ROOT))),
        "RECORD_LOADED": str(loaded),
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = TableOutputs({}, [], set())
    for number, (label, command) in enumerate(table.commands.items()):
        done.folders[label] = work / f"out-{number}"
        words = [
            word.replace("DATA", str(data), 1) if word.startswith("DATA") else word
            for word in shlex.split(command)
        ]
        code = "from comparisons.cli.app import main; main()"
        start, fine = ([], {0}) if words[0] == "python" else (["-c", code], {0, 1, 3})
        if table.reader == "claims":
            fine = {0, 1}  # claims that do not hold are a result, too
        writes = start or table.reader != "printed"
        out = ["--out", str(done.folders[label])] if writes else []
        ended = subprocess.run(
            [sys.executable, *start, *words[1:], *out],
            cwd=ROOT,
            env=os.environ | settings,
            capture_output=True,
            text=True,
            check=False,
        )
        quiet = ended.returncode == 1 and not ended.stderr.strip()  # found what it looks for
        if not (quiet or ended.returncode in fine):
            last = (ended.stderr.strip() or "nothing printed").splitlines()[-1]
            raise StoredResultError(f"`{command}` exited with {ended.returncode}: {last}")
        done.printed.extend(line.rstrip() for line in ended.stdout.strip("\n").splitlines())
    for listed in loaded.iterdir():
        done.loaded.update(listed.read_text().splitlines())
    return done


def sources(loaded: Sequence[str]) -> dict[str, str]:
    """Hashes of those loaded files that a result depends on, by path in the project."""
    inside = {
        Path(one).relative_to(ROOT).as_posix() for one in loaded if one.startswith(f"{ROOT}/")
    }
    mine = [one for one in inside if one.startswith(HASHED) and not one.startswith(UNHASHED)]
    return {path: code_hash(ROOT / path) for path in sorted(mine)}


def make(table: Table, data: Path) -> Record:
    """Run a table's commands and return the record. Raises RecordError."""
    if _git("status", "--porcelain", "--", *HASHED, *(f":!{one}" for one in UNHASHED)):
        raise StoredResultError(
            f"a record names a commit: commit what changed in {', '.join(HASHED)}"
        )
    if any("DATA" in one for one in table.commands.values()) and not data.is_dir():
        raise StoredResultError(
            f"{table.name} needs the public logs: give their folder with --data"
        )
    commit, before = _git("rev-parse", "--short=10", "HEAD"), _processor_s()
    with tempfile.TemporaryDirectory() as folder:
        done = run(table, data, Path(folder))
        reader = READERS.get(table.reader)
        columns, rows = reader(table, done) if reader else ((), ())
        picture = table.picture
        if picture and picture.source:
            drawn = next(iter(done.folders.values())) / picture.source
            (ROOT / "docs" / picture.file).write_bytes(drawn.read_bytes())
    files = [ROOT / "docs" / picture.file] if picture else []
    return Record(
        name=table.name,
        title=table.title,
        commands=table.commands,
        commit=commit,
        date=datetime.datetime.now(datetime.UTC).date(),
        seeds=table.seeds,
        machine=_machine(),
        cpu_s=round(_processor_s() - before, 1),
        columns=columns,
        rows=rows,
        printed=tuple(done.printed) if table.reader == "printed" else (),
        pictures={file.name: code_hash(file) for file in files},
        sources=sources(sorted(done.loaded)),
    )


Cells = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]


def _runs(table: Table, done: TableOutputs) -> Cells:
    """One row per command, its values by their place in the folder's JSON file."""
    rows = []
    for label, folder in done.folders.items():
        path = next(folder / name for name in NAMES if (folder / name).exists())
        result = json.loads(path.read_text(encoding="utf-8"))
        values = [_value(result, place) for place in table.columns.values()]
        rows.append((label, *values))
    return ("log", *table.columns), tuple(rows)


NAMES = ("result.json", "solution.json")


def _value(result: Any, place: str) -> str:
    """A value as text; the words of a place are alternatives, the first that is there counts."""
    for one in place.split():
        found = result
        for key in one.split("."):
            found = found.get(key) if isinstance(found, dict) else None
        if found is not None:
            return f"{found:.3g}" if isinstance(found, float) else str(found)
    return ""


def _claims(table: Table, done: TableOutputs) -> Cells:
    """One row per claim of each figure that was reproduced."""
    rows = []
    for folder in done.folders.values():
        for figure in json.loads((folder / "claims.json").read_text(encoding="utf-8"))["figures"]:
            for claim in figure["claims"]:
                spread = claim["drives_least"], claim["drives_most"]
                measured = in_words(claim["measured"], claim["unit"], spread)
                holds = "yes" if claim["holds"] else f"**no**: {claim['cause'] or 'not explained'}"
                rows.append((figure["name"], claim["text"], measured, claim["asked"], holds))
    return ("figure", "claim", "measured", "asked", "holds"), tuple(rows)


def _montecarlo(table: Table, done: TableOutputs) -> Cells:
    """One row per filter: ANEES, bold outside of its band, and errors."""
    parts, errors = ("pose", "position", "heading", "landmarks"), ("position_m", "heading_rad")
    study = json.loads((next(iter(done.folders.values())) / "montecarlo.json").read_text())
    band: list[str] = []
    rows = []
    for name, one in study["filters"].items():
        cells = []
        for part in parts:
            found = one["consistency"][part]
            text = f"{found['anees']:.2f}"
            cells.append(text if found["place"] == "inside" else f"**{text}**")
        band = band or [
            "{:.2f} to {:.2f}".format(*one["consistency"][part]["band"]) for part in parts
        ]
        cells += [f"{one[f'rmse_{error}']:.3g}" for error in (*errors, "landmark_m")]
        rows.append((f"`{name}`", *cells))
    titles = (f"ANEES {part}" for part in parts)
    columns = ("filter", *titles, "RMSE position, m", "heading, rad", "landmarks, m")
    return columns, (("95 % band", *band, "", "", ""), *rows)


READERS = {"runs": _runs, "claims": _claims, "montecarlo": _montecarlo}
"""Of the files that commands leave."""


def dump(record: Record) -> str:
    """Return a record as JSON, one field a line."""
    fields = record.model_dump(mode="json").items()
    return "{\n" + ",\n".join(f'"{k}": {json.dumps(v)}' for k, v in fields) + "\n}\n"


def _git(*words: str) -> str:
    return subprocess.run(
        ["git", *words],  # noqa: S607
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def _processor_s() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _machine() -> Machine:
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text().splitlines() if listed.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    versions = {"Python": platform.python_version()}
    for name in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return Machine(
        cpu=next(names, platform.processor() or platform.machine()),
        cores=os.cpu_count() or 1,
        system=f"{platform.system()} {platform.machine()}",
        versions=versions,
    )


def main() -> None:
    """Record what is asked for and write the page; without a name, list all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared/data")
    parser.add_argument("--due", action="store_true", help="what is missing or stale")
    parser.add_argument("--idle", action="store_true", help="with --due: the tables of times alone")
    parser.add_argument("--page", action="store_true", help="write docs/results*.md alone")
    choices = parser.parse_args()
    try:
        _obey(choices)
    except StoredResultError as error:
        print(f"record: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def _obey(choices: argparse.Namespace) -> None:
    registry = read_registry()
    if choices.names or choices.due:
        names = choices.names or _due(registry, idle=choices.idle)
        if unknown := [name for name in names if name not in registry.tables]:
            raise StoredResultError(f"{unknown[0]}: no such table; without a name all are listed")
        failed = [name for name in names if not _record(registry.tables[name], choices.data)]
        write_pages(registry)
        if failed:
            raise StoredResultError(f"not recorded: {', '.join(failed)}")
    elif choices.page:
        write_pages(registry)
    else:
        records = read_records(registry)
        for name, table in registry.tables.items():
            when = ", on an idle machine" if table.idle else ""
            print(f"{name:32} {state(table, records.get(name)):18} {table.minutes:5g} min{when}")


def _due(registry: Registry, *, idle: bool) -> list[str]:
    records = read_records(registry)
    return [
        name
        for name, table in registry.tables.items()
        if table.idle == idle and state(table, records.get(name)) != FRESH
    ]


def _record(table: Table, data: Path) -> bool:
    """Record one table; a failure is one line, and the next table is taken."""
    try:
        record = make(table, data.resolve())
    except StoredResultError as error:
        print(f"record: {table.name}: {error}", file=sys.stderr, flush=True)
        return False
    path = ROOT / "docs/results/records" / f"{table.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dump(record), encoding="utf-8")
    print(f"{table.name}: {record.cpu_s:.0f} s, {len(record.sources)} sources", flush=True)
    return True


def write_pages(registry: Registry) -> None:
    """Write docs/results*.md, and delete those of sections that are gone. Raises RecordError."""
    made = pages(registry, read_records(registry))
    for path in (ROOT / "docs").glob("results-*.md"):
        if path.name not in made:
            path.unlink()
    for name, text in made.items():
        (ROOT / "docs" / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
