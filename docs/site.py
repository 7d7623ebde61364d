"""Hooks of the documentation's build: pages made from files above `docs`, links to code, formulas.

The README is the first page, the changelog one of its own. Links to files of the project that are
no page become their path as code. Formulas become MathML, so that no script and no network is
needed.
"""

from __future__ import annotations

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import slamcheck

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"(?<!!)\[([^\]\[]*)\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")
_FORMULA = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)


def _api() -> str:
    """Return the page of `import slamcheck`: each public name where it is defined."""
    parts = ["# Python\n\n::: slamcheck\n    options: {members: false}\n"]
    for name in slamcheck.__all__:
        module, _, attribute = slamcheck._PLACES.get(name, "slamcheck").partition(":")
        parts.append(f"## slamcheck.{name}\n\n::: {module}.{attribute or name}\n")
    return "\n".join(parts)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from other files."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8").replace("](docs/", "](")
    made = {
        "index.md": readme.replace("](CHANGELOG.md)", "](changes.md)"),
        "changes.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "api.md": _api(),
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
