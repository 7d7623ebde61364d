"""Other people's distributions have packages of the same names: one line says so.

The site of each test is made of slamcheck's own files and fakes; nothing of it is installed.
"""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from slamcheck._packages import PACKAGES
from tests.processes import python, run_pytest
from tests.release_check import ROOT

CHECK = "from slamcheck._packages import check_packages; check_packages(); print('ours')"


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Where slamcheck is installed from `/src/my slamcheck`: the first file of each package."""
    site = tmp_path / "site"
    shutil.copytree(ROOT / "slamcheck", site / "slamcheck")
    for name in PACKAGES:
        (site / name).mkdir()
        shutil.copy(ROOT / name / "__init__.py", site / name)
    distribution(site, "slamcheck", "0.2.0", *PACKAGES)
    url = json.dumps({"url": "file:///src/my%20slamcheck", "dir_info": {}})
    (site / "slamcheck-0.2.0.dist-info/direct_url.json").write_text(url)
    return site


def distribution(site: Path, name: str, version: str, *packages: str) -> None:
    """Say that a distribution has installed packages."""
    info = site / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "RECORD").write_text("".join(f"{one}/__init__.py,,\n" for one in packages))


def foreign(folder: Path, name: str) -> Path:
    (folder / name).mkdir(parents=True, exist_ok=True)
    path = folder / name / "__init__.py"
    path.write_text("raise RuntimeError('it was run')\n")
    return path


def bare(*words: str, path: list[Path]) -> subprocess.CompletedProcess[str]:
    """Run Python with a path and the standard library alone."""
    return python("-S", *words, cwd="/", PYTHONPATH=":".join(map(str, path)))


def fault(*path: Path) -> str:
    """Return the line that the command line ends with; the interface from Python has the same."""
    shown = bare("-m", "slamcheck", "--version", path=list(path))
    raised = bare("-c", CHECK, path=list(path))
    assert shown.returncode == 2
    assert shown.stdout == ""
    line = shown.stderr.removesuffix("\n").removeprefix("slamcheck: ")
    assert "\n" not in line
    assert raised.stderr.splitlines()[-1] == f"ImportError: {line}"
    return line


AGAIN = "pip install --force-reinstall --no-deps '/src/my slamcheck'"


def test_own_packages_pass(site: Path) -> None:
    assert bare("-c", CHECK, path=[site]).stdout == "ours\n"


def test_a_package_that_another_distribution_wrote_over_is_named(site: Path) -> None:
    """As after `pip install graphslam`."""
    path = foreign(site, "graphslam")
    distribution(site, "graphslam", "0.0.17", "graphslam")
    assert fault(site) == (
        f"{path} is of graphslam 0.0.17 and hides slamcheck's package graphslam; "
        f"run: pip uninstall --yes graphslam && {AGAIN}"
    )


def test_a_package_that_another_distributions_removal_took_along_is_named(site: Path) -> None:
    (site / "comparisons/__init__.py").unlink()
    assert fault(site) == (
        f"{site}/comparisons/__init__.py is missing: another distribution with a package "
        f"comparisons was removed and took it along; run: {AGAIN}"
    )


def test_a_distribution_earlier_on_the_path_is_named(site: Path, tmp_path: Path) -> None:
    """As beside an editable installation, which site-packages precede."""
    path = foreign(tmp_path / "first", "comparisons")
    distribution(tmp_path / "first", "comparisons", "0.4", "comparisons")
    assert fault(tmp_path / "first", site) == (
        f"{path} is of comparisons 0.4 and hides slamcheck's package comparisons; "
        "run: pip uninstall --yes comparisons"
    )


@pytest.mark.parametrize("name", ["comparisons/__init__.py", "comparisons.py"])
def test_a_users_own_module_is_named(name: str, site: Path, tmp_path: Path) -> None:
    path = tmp_path / "mine" / name
    path.parent.mkdir(parents=True)
    path.write_text("raise RuntimeError('it was run')\n")
    assert fault(path.parents[1] if "/" in name else path.parent, site) == (
        f"{path} is another program's and hides slamcheck's package comparisons; "
        "rename it, or take its folder off Python's path (PYTHONPATH, sys.path)"
    )


def test_a_folder_without_code_hides_nothing(site: Path, tmp_path: Path) -> None:
    (tmp_path / "mine/comparisons").mkdir(parents=True)
    assert bare("-c", CHECK, path=[tmp_path / "mine", site]).stdout == "ours\n"


def test_the_public_interface_says_so_at_its_first_use(tmp_path: Path) -> None:
    foreign(tmp_path, "comparisons")
    for use in ("load_log('simulated-loop')", "check(None, 'mine')", "RunConfig"):
        code = f"import slamcheck\nslamcheck.{use}\n"
        shown = bare("-c", code, path=[tmp_path, ROOT]).stderr
        assert "hides slamcheck's package comparisons" in shown.splitlines()[-1]


@pytest.mark.slow
def test_pytest_runs_others_tests_and_fails_those_of_slamcheck(tmp_path: Path) -> None:
    """A plugin that cannot be loaded would end every test run of the environment."""
    foreign(tmp_path / "first", "comparisons")
    (tmp_path / "test_both.py").write_text(
        "def test_other():\n    pass\n"
        "def test_filter(slam_check):\n    slam_check('simulated-loop')\n"
    )
    path = f"{tmp_path / 'first'}:{ROOT}"
    ran = run_pytest("-q", cwd=tmp_path, PYTHONPATH=path, COLUMNS="300")
    assert "1 failed, 1 passed" in ran.stdout, ran.stdout + ran.stderr
    assert "is another program's and hides slamcheck's package comparisons" in ran.stdout
    assert "Traceback" not in ran.stdout
