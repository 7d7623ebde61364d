"""The documentation builds without network, has no dead link, and covers what is public."""

import importlib.util
import re
import shutil
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote

import pytest
from pydantic import BaseModel

import slamcheck
from comparisons.cli.app import COMMANDS
from tests.processes import ROOT, built

pytestmark = pytest.mark.slow


def script(name: str) -> ModuleType:
    """A script of docs/, as a module."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_every_page_is_built(site: Path) -> None:
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / f"{page.stem}.html").exists(), page
    api = (site / "api.html").read_text()
    assert [name for name in slamcheck.__all__ if f"slamcheck.{name}" not in api] == []
    commands = (site / "command-line.html").read_text()
    assert [name for name in COMMANDS if f"slamcheck {name}" not in commands] == []
    assert "--min-coverage" in commands
    equations = (site / "equations.html").read_text()
    assert equations.count("<math") > 200
    assert "arithmatex" not in equations
    assert "dense_maps" in (site / "configuration.html").read_text()
    assert "Golden runs" in (site / "contributing.html").read_text()


class Links(HTMLParser):
    """What a page links to, what it loads, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif "src" in given or (tag == "link" and given.get("rel") != "canonical"):
            self.loads.append(given.get("src") or given.get("href", ""))


@cache
def read(page: Path) -> Links:
    return Links(page.read_text(encoding="utf-8"))


def dead(page: Path) -> Iterator[str]:
    """Links of a page to files or anchors that are not there; what it loads from elsewhere."""
    for link in read(page).links:
        if re.match(r"https?:|mailto:", link):
            continue
        file, _, anchor = unquote(link).partition("#")
        target = page.parent / file if file else page
        if target.is_dir():
            target /= "index.html"
        if not target.is_file() or (
            anchor and target.suffix == ".html" and anchor not in read(target).anchors
        ):
            yield link
    for load in read(page).loads:
        if (
            not load.startswith("data:")
            and not (page.parent / unquote(load.split("?")[0])).exists()
        ):
            yield load


def test_no_link_is_dead_and_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for page in site.glob("*.html"):
        if page.stem != "404":
            assert list(dead(page)) == [], page.name
    for style in site.rglob("*.css"):
        assert not re.search(r"url\([\"']?https?:|@import", style.read_text()), style


def test_dead_anchors_and_foreign_scripts_are_found(tmp_path: Path) -> None:
    page = tmp_path / "a.html"
    page.write_text(
        '<h1 id="top"></h1><a href="#top"></a><a href="a.html#none"></a><a href="b.html"></a>'
        '<img src="c.png"><script src="https://cdn.example/x.js"></script>'
    )
    assert list(dead(page)) == ["a.html#none", "b.html", "c.png", "https://cdn.example/x.js"]


def test_every_field_of_a_result_has_a_type_and_a_meaning(site: Path) -> None:
    page = (site / "result-schema.html").read_text()
    for model in ("Result", "CheckResult", "SolutionResult", "MapResult", "Claim", "StatedNoise"):
        assert f'id="{model.lower()}"' in page
    assert page.count("<tr>") > 400


def test_a_field_without_meaning_stops_the_build() -> None:
    pytest.importorskip("mkdocs")
    hooks = script("site")

    class Sound(BaseModel):
        """Summary.

        Attributes:
            size_m: length of
                the thing.
        """

        size_m: float | None

    class Silent(Sound):
        """Summary."""

        other: int

    assert "| `size_m` | length of the thing. | number or null | m |" in (
        hooks._model(Sound, {Sound: "Sound"})
    )
    with pytest.raises(KeyError, match="other"):
        hooks._model(Silent, {Silent: "Silent"})


def copied(folder: Path) -> Path:
    """Return a copy of what the documentation is built of."""
    for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "mkdocs.yml"):
        shutil.copy(ROOT / name, folder / name)
    shutil.copytree(ROOT / "docs", folder / "docs")
    return folder


def test_a_dead_link_fails_the_build(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    page = copied(tmp_path) / "docs" / "limits.md"
    page.write_text(page.read_text() + "\nSee [this](no-such-page.md).\n")
    done = built(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert "no-such-page.md" in done.stderr


def test_the_first_page_lists_all_pages(site: Path) -> None:
    _, _, listed = (site / "index.html").read_text(encoding="utf-8").partition('id="all-pages"')
    links = set(Links(listed).links)
    for page in site.glob("*.html"):
        assert page.name in links or page.stem == "404", page.name


def test_a_page_that_is_for_nobody_fails_the_build(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    (copied(tmp_path) / "docs" / "lost.md").write_text("# Lost\n")
    done = built(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert "mkdocs.yml: not in both nav and extra.pages: ['lost.md']" in done.stderr


def test_three_doors_lead_to_three_pages_each_in_the_order_of_the_navigation() -> None:
    """README and navigation have the same doors."""
    yaml = pytest.importorskip("yaml")
    sections = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    navigation = {
        name: [file for page in pages for file in page.values()]
        for section in sections
        for name, pages in section.items()
        if name.startswith("I have")
    }
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    doors = dict(re.findall(r"^### (I have.*?)\n(.*?)(?=^##)", readme, re.MULTILINE | re.DOTALL))
    shown = {
        name: re.findall(r"^\d\. \[.*?\]\(docs/(.*?)\)", text, re.MULTILINE)
        for name, text in doors.items()
    }
    assert shown == navigation
    assert [len(pages) for pages in shown.values()] == [3, 3, 3]
