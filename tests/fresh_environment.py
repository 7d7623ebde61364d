"""An environment with slamcheck's wheel and what it depends on, and nothing else."""

import os
import subprocess
import sys
import tomllib
import venv
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

from tests.processes import ran
from tests.release_check import ROOT as ROOT
from tests.release_check import copy_source


def depends(requirements: list[str]) -> Iterator[str]:
    """Names of all distributions that requirements lead to, as installed here."""
    seen: set[str] = set()
    while requirements:
        one = Requirement(requirements.pop())
        wanted = one.marker is None or one.marker.evaluate({"extra": ""})
        if wanted and one.name.lower() not in seen:
            seen.add(one.name.lower())
            requirements += distribution(one.name).requires or []
            yield one.name.lower()


def link(name: str, folder: Path) -> None:
    """Link all that a distribution has installed beside itself into a folder."""
    found = distribution(name)
    for top in {file.parts[0] for file in found.files or []} - {"..", "__pycache__"}:
        if not (folder / top).exists():
            (folder / top).symlink_to(Path(str(found.locate_file(top))).resolve())


def fresh_environment(work: Path) -> Path:
    """Return the folder of programs of an environment with slamcheck's wheel, and no extra.

    It is made in a folder `work`, without a network: what slamcheck needs is linked.
    """
    source, home = copy_source(work / "source"), work / "environment"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    build = ["wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(work)]
    subprocess.run([*pip, *build, str(source)], check=True)
    venv.create(home, with_pip=False, symlinks=True)
    (site,) = home.glob("lib/python*/site-packages")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name in depends([*project["dependencies"], "pytest"]):
        link(name, site)
    (wheel,) = work.glob("slamcheck-*.whl")
    install = ["install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([*pip, "--python", str(home / "bin/python"), *install], check=True)
    return home / "bin"


def done(
    scripts: Path, cwd: Path, *command: str, path: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """A program of the environment. path: a folder with further modules."""
    program, *arguments = command
    environment = {"PATH": os.defpath, "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "100"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    return ran(scripts / program, *arguments, cwd=cwd, env=environment)
