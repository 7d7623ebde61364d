"""Hooks of the documentation's build: generated pages, links to code, formulas.

The README is the first page, the changelog one of its own; the pages on the command line, the
configuration and the public interface are made from the code. Links to files of the project that
are no page become their path as code. Formulas become MathML, so that no script and no network is
needed.
"""

from __future__ import annotations

import contextlib
import html
import io
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import slamcheck
from comparisons.checks.causes import EXPLANATIONS
from comparisons.cli.app import COMMANDS, build
from comparisons.cli.config import JobName
from comparisons.cli.config import config as print_config
from comparisons.config import JOBS, Configured
from comparisons.extensions.registry import config_class
from comparisons.options import FLAGS

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"(?<!!)\[([^\]\[]*)\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")
_FLAGS = {(flag.option, flag.help): flag for flag in FLAGS}
_FORMULA = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)


def _api() -> str:
    """Return the page of `import slamcheck`: each public name where it is defined."""
    parts = ["# Python\n\n::: slamcheck\n    options: {members: false}\n"]
    for name in slamcheck.__all__:
        module, _, attribute = slamcheck._PLACES.get(name, "slamcheck").partition(":")
        parts.append(f"## slamcheck.{name}\n\n::: {module}.{attribute or name}\n")
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
    """Return the page of all settings."""
    parts = [
        "# Configuration",
        "What `slamcheck config JOB` prints: every setting and its default.",
    ]
    for job in JobName:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            print_config(job, schema=False)
        parts.append(f"## {job.value}\n\n```toml\n{printed.getvalue().strip()}\n```")
    return "\n\n".join(parts) + "\n"


def _causes() -> str:
    """Return the page of what every kind of cause means, as report.html has it."""
    parts = [
        "# Causes",
        "Every cause of an outcome is of one of these kinds. `report.html` explains each with the "
        "same sentences.",
    ]
    for kind, one in EXPLANATIONS.items():
        parts.append(f"## {kind}\n\n**{one.title}.** {one.meaning}\n\n{one.check}")
    return "\n\n".join(parts) + "\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from other files."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8").replace("](docs/", "](")
    made = {
        "index.md": readme.replace("](CHANGELOG.md)", "](changes.md)"),
        "changes.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "api.md": _api(),
        "command-line.md": _command_line(),
        "configuration.md": _configuration(),
        "causes.md": _causes(),
    }
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to what is no page into code."""

    def link(found: re.Match[str]) -> str:
        words, target = found[1], found[2]
        if files.get_file_from_path(target) is not None:
            return found[0]
        if not (ROOT / "docs" / target).exists() and not (ROOT / target).exists():
            return found[0]  # a dead link, which the build reports
        return words if words.startswith("`") else f"{words} (`{target.removeprefix('../')}`)"

    return _LINK.sub(link, markdown)


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Set formulas."""
    return _FORMULA.sub(lambda found: convert(html.unescape(found[1])), content)
