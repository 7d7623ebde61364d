"""slamcheck's wheel in an environment of its own, with what it depends on and nothing else."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.fresh_environment import ROOT, depends, done
from tests.release_check import (
    PACKAGES,
    TEST,
    copy_source,
    names_in,
    packaged,
    sdist_faults,
    wheel_faults,
)
from tests.release_check import version as release

STRICT = """
[tool.pytest.ini_options]
addopts = ["--strict-markers", "--strict-config"]
filterwarnings = ["error"]
slam_logs = ["simulated-loop"]
"""

pytestmark = pytest.mark.slow


def test_no_dependency_brings_what_only_scans_need() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = set(depends(list(project["dependencies"])))
    assert {"gtsam", "numpy", "contourpy"} <= names
    assert not {"open3d", "open3d-cpu", "kiss-icp", "dash"} & names
    scans = set(depends(list(project["optional-dependencies"]["scans"])))
    assert {"kiss-icp", "dash"} <= scans


def test_a_plugin_that_warns_would_be_found(scripts: Path, tmp_path: Path) -> None:
    """As that of dash, which Open3D brings; test_own_project is as strict, and passes."""
    path, project = tmp_path / "path", tmp_path / "project"
    (path / "loud-1.0.dist-info").mkdir(parents=True)
    project.mkdir()
    (path / "loud.py").write_text("import warnings\n\nwarnings.warn('too loud')\n")
    (path / "loud-1.0.dist-info/METADATA").write_text("Name: loud\nVersion: 1.0\n")
    (path / "loud-1.0.dist-info/entry_points.txt").write_text("[pytest11]\nloud = loud\n")
    (project / "pyproject.toml").write_text(STRICT)
    (project / "test_filter.py").write_text(TEST)
    tested = done(scripts, project, "python", "-m", "pytest", "-q", path=path)
    assert tested.returncode != 0
    assert "too loud" in tested.stdout + tested.stderr
    quiet = ("-m", "pytest", "-q", "--collect-only", "-p", "no:loud")
    assert done(scripts, project, "python", *quiet, path=path).returncode == 0


def test_a_run_leaves_its_folder(scripts: Path, tmp_path: Path) -> None:
    run = done(scripts, tmp_path, "slamcheck", "run", "simulated-loop", "--out", "out")
    assert run.returncode == 0, run.stderr
    stages = r"slamcheck: [^\n]* \d+\.\d s\n"  # of a job that takes longer than a moment
    assert re.sub(stages, "", run.stderr) == ""
    versions = json.loads((tmp_path / "out/result.json").read_text())["versions"]
    assert versions["slamcheck"] == version("slamcheck")
    assert "gtsam" in versions
    assert not {"kiss-icp", "open3d", "open3d-cpu"} & set(versions)


@pytest.mark.parametrize(
    ("arguments", "needs"),
    [
        ("odometry scan-loop", "odometry needs KISS-ICP"),
        ("run scan-loop --motion both", "--motion both needs KISS-ICP"),
        (
            "run scan-slam --landmarks scans --smoother-matcher generalised-icp",
            "--smoother-matcher generalised-icp needs Open3D",
        ),
        ("map scan-loop --cloud pcd", "--cloud needs Open3D"),
    ],
)
def test_what_needs_the_extra_says_so_before_the_work(
    arguments: str, needs: str, scripts: Path, tmp_path: Path
) -> None:
    run = done(scripts, tmp_path, "slamcheck", *arguments.split())
    assert run.returncode == 2
    assert run.stderr == f"slamcheck: {needs}: pip install 'slamcheck[scans]'\n"
    assert list(tmp_path.iterdir()) == []


def test_the_wheel_has_the_packages_and_nothing_else(scripts: Path) -> None:
    (wheel,) = scripts.parents[1].glob("slamcheck-*.whl")
    names = names_in(wheel)
    assert wheel_faults(names, packaged()) == []
    data = {f"{name}/py.typed" for name in PACKAGES} | {"comparisons/report/html/page.css"}
    assert data <= names
    assert wheel_faults(names - data, packaged()) == [
        f"the wheel lacks {name}" for name in sorted(data)
    ]
    more = names | {"tests/helpers.py"}
    assert wheel_faults(more, packaged()) == ["the wheel has tests/helpers.py"]


def test_the_source_distribution_has_what_a_build_needs(tmp_path: Path) -> None:
    code = f"from setuptools.build_meta import build_sdist; build_sdist({str(tmp_path)!r})"
    source = copy_source(tmp_path / "source")
    (source / "tests").mkdir()
    (source / "tests/test_stray.py").touch()  # setuptools takes such files unless told not to
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)
    (sdist,) = tmp_path.glob("*.tar.gz")
    names = names_in(sdist)
    assert sdist_faults(names, packaged()) == []
    top = f"slamcheck-{release()}"
    more = names - {f"{top}/LICENSE"} | {f"{top}/tests/test_stray.py"}
    assert sdist_faults(more, packaged()) == [
        "the source distribution lacks LICENSE",
        "the source distribution has tests/test_stray.py",
    ]
