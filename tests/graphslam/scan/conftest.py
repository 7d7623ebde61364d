from types import ModuleType

import pytest

from graphslam.scan.libraries import open3d
from graphslam.scan.matchers import MATCHERS
from graphslam.scan.registration import Matcher


@pytest.fixture(scope="session")
def open3d_library() -> ModuleType:
    """Open3D, for tests that need it."""
    return open3d()


@pytest.fixture(params=MATCHERS)
def name(request: pytest.FixtureRequest) -> str:
    """Of every matcher in turn."""
    return str(request.param)


@pytest.fixture
def matcher(name: str) -> Matcher:
    return MATCHERS[name]()
