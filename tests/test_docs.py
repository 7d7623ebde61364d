"""The documentation builds without network, has no dead link, and covers what is public."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import slamcheck
from comparisons.cli.app import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow


def built(project: Path, site: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-f", project / "mkdocs.yml", "-d", site],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": "", "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
    )


def test_every_page_is_built(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    done = built(ROOT, tmp_path)
    assert done.returncode == 0, done.stderr
    for page in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / f"{page.stem}.html").exists(), page
        assert f"{page.name}" in (ROOT / "mkdocs.yml").read_text(), f"{page}: not in the menu"
    api = (tmp_path / "api.html").read_text()
    assert [name for name in slamcheck.__all__ if f"slamcheck.{name}" not in api] == []
    commands = (tmp_path / "command-line.html").read_text()
    assert [name for name in COMMANDS if f"slamcheck {name}" not in commands] == []
    assert "--min-coverage" in commands
    equations = (tmp_path / "equations.html").read_text()
    assert equations.count("<math") > 200
    assert "arithmatex" not in equations
    assert "dense_maps" in (tmp_path / "configuration.html").read_text()
    loaded = [p for p in tmp_path.glob("*.html") if '<script src="http' in p.read_text()]
    assert loaded == []


def test_a_dead_link_fails_the_build(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    for name in ("README.md", "CHANGELOG.md", "mkdocs.yml"):
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    page = tmp_path / "docs" / "scale.md"
    page.write_text(page.read_text() + "\nSee [this](no-such-page.md).\n")
    done = built(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert "no-such-page.md" in done.stderr
