"""Hooks of the documentation's build: generated pages, links to code, formulas.

The README is the first page, its doors side by side, with a list of all pages from mkdocs.yml; the
changelog and CONTRIBUTING.md are pages of their own. The pages on
the command line, the configuration, the fields of results and the public interface are made from
the code. Links to files of the project that are no page become their path as code. Formulas become
MathML, so that no script and no network is needed.
"""

from __future__ import annotations

import contextlib
import html
import inspect
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from latex2mathml.converter import convert
from markdown.extensions.toc import slugify
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import slamcheck
from comparisons.audit.audit import Audit
from comparisons.cli.app import COMMANDS, build
from comparisons.cli.config import JobName
from comparisons.cli.config import config as print_config
from comparisons.config import JOBS, Configured, config_class
from comparisons.experiments.montecarlo.study import StudyOutcome
from comparisons.extensions.dense_maps.report import MapResult
from comparisons.extensions.scan_motion.report import FrontEndResult
from comparisons.figures import kept_fields, meanings
from comparisons.options.table import FLAGS
from comparisons.report.check import CheckResult
from comparisons.report.explain import every_check
from comparisons.report.models import Result, SolutionResult
from research.documents.interface import ReproductionResult

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"(?<!!)\[([^\]\[]*)\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")
_FLAGS = {(flag.option, flag.help): flag for flag in FLAGS}
_LOOKED_UP = re.compile("results-|api|result-schema|command-line|configuration|changes|equations")
_TABLE = re.compile(r"^#?\[.*\]$", re.MULTILINE)
_NUMBER = re.compile(r"<td>(?=[-+\d.,e %]+</td>)")
_DOOR = re.compile(r'<h3 id="i-have-.*?</ol>', re.DOTALL)
_DOORS = re.compile(rf"(?:{_DOOR.pattern}\s*)+", re.DOTALL)
_FORMULA = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)

RESULTS: dict[str, tuple[type, ...]] = {
    "result.json": (Result,),
    "result.json: entries of checks": tuple(
        kind for check in every_check() for _, kind in check.figures
    ),
    "check.json": (CheckResult,),
    "audit.json": (Audit,),
    "solution.json": (SolutionResult,),
    "odometry.json": (FrontEndResult,),
    "map.json": (MapResult,),
    "montecarlo.json": (StudyOutcome,),
    "claims.json": (ReproductionResult,),
}
"""Files of results, and the models or dataclasses of their contents."""
UNITS = {"_m": "m", "_m2": "m²", "_rad": "rad", "_s": "s", "_sigma": "sigma", "seconds": "s",
         "_per_second": "1/s"}  # fmt: skip
"""Endings of fields' names, and the unit that each stands for."""
_JSON = {str: "text", float: "number", int: "integer", bool: "true, false", NoneType: "null"}


def _result_schema() -> str:
    """Return the page of all fields of result files. Raises KeyError for one without meaning."""
    parts = [
        "# Result schema",
        "Each file is one JSON object; its first table has its fields. Every figure is in SI units "
        "and radians. JSON has no NaN and no infinity: such a figure is `null`. "
        "[Formats](formats.md) describes the other files of a folder.",
    ]
    seen: dict[type, str] = {}
    for file, roots in RESULTS.items():
        new = [kind for kind in dict.fromkeys(_nested(*roots)) if kind not in seen]
        for kind in new:
            taken = kind.__name__ in seen.values()
            seen[kind] = f"{kind.__name__} of {file}" if taken else kind.__name__
        parts.append(f"## {file}")
        parts += [_model(kind, seen) for kind in new]
    return "\n\n".join(parts) + "\n"


def _nested(*kinds: Any) -> Iterator[type]:
    """Models in types and in the fields of these models, outer ones first."""
    for kind in kinds:
        if isinstance(kind, type) and kept_fields(kind):
            yield kind
            yield from _nested(*(field.hint for field in kept_fields(kind).values()))
        else:
            yield from _nested(*(one for one in get_args(kind) if not isinstance(one, str)))


def _model(kind: type, names: dict[type, str]) -> str:
    text = meanings(kind)
    rows = [
        f"| `{_key(kind, name)}` | {_cell(text[name])} | {_type(one.hint, names)} | {_unit(name)} |"
        for name, one in kept_fields(kind).items()
    ]
    prose = inspect.cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0]
    head = "| field | meaning | type | unit |\n|---|---|---|---|\n"
    return f"### {names[kind]}\n\n{prose}\n\n{head}" + "\n".join(rows)


def _key(kind: Any, name: str) -> str:
    """Return the name of a field in the file."""
    field = getattr(kind, "model_fields", {}).get(name)
    return (field and field.alias) or name


def _type(kind: Any, names: dict[type, str]) -> str:
    """A type as JSON has it; models link to their tables."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind in names:
        return f"[{names[kind]}](#{slugify(names[kind], '-')})"
    if origin is Annotated:
        return _type(parts[0], names)
    if origin is Literal:
        return ", ".join(f"`{one}`" for one in parts)
    if origin is list or (origin is tuple and parts[-1] is ...):
        return f"list of {_type(parts[0], names)}"
    if origin is tuple:
        return f"{len(parts)} of {_type(parts[0], names)}"
    if fields := getattr(kind, "_fields", ()):
        return f"{len(fields)} of {_type(get_type_hints(kind)[fields[0]], names)}"
    if origin in (dict, Mapping):
        return "object" if parts[1] is Any else f"object of {_type(parts[1], names)}"
    return " or ".join(_type(one, names) for one in parts) or _JSON.get(kind, "any")


def _unit(name: str) -> str:
    return next((UNITS[end] for end in sorted(UNITS, key=len)[::-1] if name.endswith(end)), "")


def _api() -> str:
    """Return the page of `import slamcheck`: each public name by its use, where it is defined."""
    parts = ["# Python\n\n::: slamcheck\n    options: {members: false}\n"]
    rows = [
        f"| [{use}](#{slugify(use, '-')}) | "
        + ", ".join(f"[`{name}`](#{slugify(f'slamcheck.{name}', '-')})" for name in names)
        + " |"
        for use, names in slamcheck._USES.items()
    ]
    parts.append("| to | names |\n|---|---|\n" + "\n".join(rows) + "\n")
    for use, names in slamcheck._USES.items():
        parts.append(f"## {use}\n")
        for name in names:
            module, _, attribute = slamcheck._PLACES.get(name, "slamcheck").partition(":")
            place = f"::: {module}.{attribute or name}\n    options: {{heading_level: 4}}\n"
            parts.append(f"### slamcheck.{name}\n\n{place}")
    return "\n".join(parts)


def _command_line() -> str:
    """Return the page of all commands and their options."""
    whole, parts = build(whole=True), ["# Command line"]
    for name in COMMANDS:
        command = whole.commands[name]
        parts.append(f"## slamcheck {name}")
        below = getattr(command, "commands", {})
        parts += [_command(command)] if not below else [_text(command.help)]
        for part in below.values():
            parts += [f"### slamcheck {name} {part.name}", _command(part)]
    return "\n\n".join(parts) + "\n"


def _command(command: Any) -> str:
    """Return what a command does, and its options: those of `--help`, then all others."""
    rows = ["| option | meaning |", "|---|---|"]
    for one in sorted(command.params, key=lambda param: param.hidden):
        names = one.opts + one.secondary_opts if one.param_type_name == "option" else []
        words = ", ".join(f"`{name}`" for name in names) or f"`{one.metavar or one.name.upper()}`"
        flag = _FLAGS.get((one.opts[0], (one.help or "").replace("\\[", "[")))
        value = (one.metavar or "").strip() or "\\|".join(flag.words if flag else ())
        value = value if names and not one.is_flag else ""
        meaning = one.help or (_meaning(flag.field) if flag else "")
        rows.append(f"| {words}{f' `{value}`' if value else ''} | {_cell(meaning)} |")
    return f"{_text(command.help)}\n\n" + "\n".join(rows)


def _meaning(path: str) -> str:
    """Return what the configuration says of a field, or of an extension's section."""
    for job in JOBS.values():
        kind: Any = job
        names = path.split(".")
        if names[0] == "extensions" and issubclass(job, Configured):
            kind, names = config_class(names[1]), names[2:]
        for name in names:
            field = kind.model_fields.get(name) if kind else None
            kind, about = (field.annotation, field.description) if field else (None, "")
        if kind is not None:
            return about if names else kind.__doc__.splitlines()[0]
    return ""


def _text(text: str) -> str:
    """A help text as Markdown, its examples as a block."""
    prose, _, examples = text.replace("\\[", "[").partition("\n\nExample")
    block = "\n".join(line.strip() for line in examples.splitlines()[1:])
    return prose + (f"\n\n```\n{block}\n```" if block else "")


def _cell(text: str) -> str:
    return " ".join(text.replace("\\[", "[").replace("|", "\\|").split())


def _configuration() -> str:
    """Return the page of all settings; a table that an earlier job has alike is named alone."""
    parts = [
        "# Configuration",
        "What `slamcheck config JOB` prints: every setting and its default. A table that several "
        "jobs have alike is printed once.",
    ]
    jobs = dict[str, str]()
    for job in JobName:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            print_config(job, schema=False)
        tables = list[str]()
        for table in printed.getvalue().strip().split("\n\n"):
            earlier = jobs.setdefault(table, job.value)
            name = _TABLE.search(table) if earlier != job.value else None
            tables.append(f"{name[0]}  # as of {earlier}" if name else table)
        text = "\n\n".join(tables)
        parts.append(f"## {job.value}\n\n```toml\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def _moved(text: str) -> str:
    """A page of the root as one of the site's folder."""
    text = text.replace("](docs/", "](").replace("](CHANGELOG.md)", "](changes.md)")
    return text.replace("](CONTRIBUTING.md)", "](contributing.md)")


def _page_list(config: MkDocsConfig, files: set[str]) -> str:
    """Return the list of all pages in the navigation's order: for whom each is, and what for.

    Raises PluginError for a page that mkdocs.yml does not name twice: in `nav` and `extra.pages`.
    """
    purposes: Mapping[str, tuple[str, str]] = config.extra["pages"]
    rows, listed = ["| page | for | what it has |", "|---|---|---|"], set[str]()
    for section, pages in (item for part in config.nav or () for item in part.items()):
        rows.append(f"| **{section}** | | |")
        for title, file in (item for page in pages for item in page.items()):
            listed.add(file)
            rows.append(f"| [{title}]({file}) | {' | '.join(purposes.get(file, ()))} |")
    if lacking := (files ^ listed) | (files ^ set(purposes)):
        raise PluginError(f"mkdocs.yml: not in both nav and extra.pages: {sorted(lacking)}")
    return "\n## All pages\n\n" + "\n".join(rows) + "\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from other files. Raises PluginError for a page without place."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    made = {
        "index.md": _moved(readme),
        "changes.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "contributing.md": _moved((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")),
        "result-schema.md": _result_schema(),
        "api.md": _api(),
        "command-line.md": _command_line(),
        "configuration.md": _configuration(),
    }
    names = {*made, *(file.src_uri for file in files.documentation_pages())}
    made["index.md"] += _page_list(config, names)
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to what is no page into code; let a search list pages that explain first."""
    if _LOOKED_UP.match(page.file.src_uri):
        page.meta["search"] = {"boost": 0.2}

    def link(found: re.Match[str]) -> str:
        words, target = found[1], found[2]
        if (file := files.get_file_from_path(target)) is not None:
            if words != target or file.page is None:
                return found[0]
            return f"[{file.page.title}]({target}{found[3] or ''})"  # not a file's name
        if not (ROOT / "docs" / target).exists() and not (ROOT / target).exists():
            return found[0]  # a dead link, which the build reports
        return words if words.startswith("`") else f"{words} (`{target.removeprefix('../')}`)"

    return _LINK.sub(link, markdown)


def _side_by_side(doors: re.Match[str]) -> str:
    """Return the doors of the first page as parts of one block."""
    sections = _DOOR.sub(r"<section>\g<0></section>", doors[0])
    return f'<div class="doors">{sections}</div>'


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Set formulas; keep numbers in tables unbroken; set the first page's doors side by side."""
    content = _NUMBER.sub('<td class="number">', content)
    content = _DOORS.sub(_side_by_side, content)
    return _FORMULA.sub(lambda found: convert(html.unescape(found[1])), content)
