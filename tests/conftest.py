import os
from collections.abc import Generator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import Phase, settings
from packaging.version import Version

from comparisons.jobs.run import Comparison, compare
from comparisons.logs.bundled import open_log
from graphslam.scan.libraries import open3d
from tests.fresh_environment import ROOT, fresh_environment
from tests.graphslam.skips import pytest_runtest_call as pytest_runtest_call
from tests.graphslam.skips import pytest_runtest_setup as pytest_runtest_setup
from tests.processes import built
from tests.shelves import changed_files, due, shelf_of

# What is drawn in continuous integration is always the same; at night it is new, and more.
COMMON = settings(
    deadline=None, print_blob=True, phases=set(Phase) - {Phase.explain}, database=None
)
settings.register_profile("ci", COMMON, max_examples=20, derandomize=True)
settings.register_profile("nightly", COMMON, max_examples=200)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def _required(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Make a skip a failure where everything is expected to be there."""
    if report.skipped and os.environ.get("SLAMCHECK_REQUIRE_ALL") == "1":
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome = "failed"
        report.longrepr = f"SLAMCHECK_REQUIRE_ALL is set, but: {reason}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Look at what became of a test."""
    report = yield
    _required(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Look at what became of a module."""
    report = yield
    _required(report)
    return report


@cache
def _asked() -> set[str]:
    """Return the shelves that a change asks for."""
    return due(changed_files())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that read the real logs, and those of shelves that no change asks for."""
    asked = _asked()
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.data)
        shelf = shelf_of(item.nodeid, {mark.name for mark in item.iter_markers()})
        if shelf is not None and shelf not in asked:
            item.add_marker(pytest.mark.nightly)


def pytest_report_header() -> str:
    """Name the shelves that a change asks for."""
    return f"shelves with changes: {', '.join(sorted(_asked())) or 'none'}"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real logs beside the project; they are not part of it."""
    if not SHARED.is_dir():
        pytest.skip("the real logs (../shared/data) are not on this machine")
    return SHARED


@pytest.fixture(scope="session")
def victoria_park() -> Comparison:
    """The main job, run once."""
    return compare(open_log("victoria-park"))


@pytest.fixture(scope="session")
def open3d_library() -> ModuleType:
    """Open3D, for tests that need it."""
    return open3d()


@pytest.fixture(scope="session")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment with slamcheck's wheel, and no extra."""
    if Version(version("setuptools")) < Version("77"):
        pytest.skip("setuptools is older than 77, which builds the wheel")
    return fresh_environment(tmp_path_factory.mktemp("fresh"))


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built pages."""
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    done = built(ROOT, folder)
    assert done.returncode == 0, done.stderr
    return folder
