"""Programs in processes of their own: Python, and what a C++ compiler makes."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def ran(
    *command: str | Path, cwd: Path | str | None = None, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end."""
    return subprocess.run(
        command, cwd=cwd, env=env, capture_output=True, text=True, check=False, timeout=600
    )


def works(*command: str | Path, cwd: Path | str | None = None) -> str:
    """Return what a program prints that ends well."""
    done = ran(*command, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def python(
    *words: str | Path, cwd: Path | str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run Python with this code and no other program. environment: variables beside, or instead."""
    env = {"PYTHONPATH": str(ROOT), "PATH": "", "COLUMNS": "100", **environment}
    return ran(sys.executable, *words, cwd=cwd, env=env)


def printed(code: str) -> str:
    """Return what a Python program prints that ends well."""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def run_pytest(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder, with the plugin of this code in place of an installed one."""
    plugins = ("no:slamcheck", "no:cacheprovider", "no:dash", "slamcheck.pytest_plugin")
    given = [word for plugin in plugins for word in ("-p", plugin)]
    return python("-m", "pytest", *given, *words, cwd=cwd, **environment)


def compiled(
    folder: Path, source: str, header: Path, *flags: str, old: str = "", new: str = ""
) -> Path:
    """Compile C++ beside a header with a piece replaced; skips without a compiler."""
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler (c++ or g++)")
    text = header.read_text()
    assert old in text
    (folder / header.name).write_text(text.replace(old, new) if old else text)
    (folder / "main.cpp").write_text(source)
    strict = ("-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
    works(compiler, *strict, "main.cpp", "-o", "main", *flags, cwd=folder)
    return folder / "main"


def built(project: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Build the documentation of a project into a folder."""
    words = ("-m", "mkdocs", "build", "-f", project / "mkdocs.yml", "-d", site)
    return python(*words, NO_MKDOCS_2_WARNING="1")
