"""Python in a process of its own."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def python(
    *words: str | Path, cwd: Path | str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run Python with this code and no other program. environment: variables beside, or instead."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": "", "COLUMNS": "100", **environment},
    )


def printed(code: str) -> str:
    """Return what a program prints that ends well."""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def run_pytest(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run pytest in a folder, with the plugin of this code in place of an installed one."""
    plugins = ("no:slamcheck", "no:cacheprovider", "no:dash", "slamcheck.pytest_plugin")
    given = [word for plugin in plugins for word in ("-p", plugin)]
    return python("-m", "pytest", *given, *words, cwd=cwd, **environment)
