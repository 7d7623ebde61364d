from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest
from hypothesis import Phase, settings

from comparisons.logs.bundled import open_log
from comparisons.pipeline.compare import Comparison, compare_estimators
from graphslam.scan.open3d_library import Open3dMissingError, open3d

# What is drawn in continuous integration is always the same; at night it is new, and more.
COMMON = settings(
    deadline=None, print_blob=True, phases=set(Phase) - {Phase.explain}, database=None
)
settings.register_profile("ci", COMMON, max_examples=20, derandomize=True)
settings.register_profile("nightly", COMMON, max_examples=200)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


def missing(what: str) -> NoReturn:
    """Skip a test for want of something, or fail it where everything is expected to be there."""
    if os.environ.get("SLAMCHECK_REQUIRE_ALL") == "1":
        pytest.fail(f"SLAMCHECK_REQUIRE_ALL is set, but {what}")
    pytest.skip(what)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real logs beside the project; they are not part of it."""
    if not SHARED.is_dir():
        pytest.skip("the real logs (../shared/data) are not on this machine")
    return SHARED


@pytest.fixture(scope="session")
def victoria_park() -> Comparison:
    """The main job, run once."""
    return compare_estimators(open_log("victoria-park"))


@pytest.fixture(scope="session")
def open3d_library() -> ModuleType:
    """Open3D, for tests that need it."""
    try:
        return open3d()
    except Open3dMissingError as error:
        missing(str(error))
