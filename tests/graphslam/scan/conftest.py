from __future__ import annotations

from types import ModuleType

import pytest

from graphslam.scan.matchers import MATCHERS
from graphslam.scan.open3d_library import Open3dMissingError, open3d
from graphslam.scan.registration import Matcher

IN_OPEN3D = {"point-to-point", "point-to-plane", "generalised"}


@pytest.fixture(scope="session")
def open3d_library() -> ModuleType:
    """Open3D, for tests that need it."""
    try:
        return open3d()
    except Open3dMissingError as error:
        pytest.skip(str(error))


@pytest.fixture(params=MATCHERS)
def name(request: pytest.FixtureRequest) -> str:
    """Of every matcher in turn, if what it needs is there."""
    chosen: str = request.param
    if chosen in IN_OPEN3D:
        request.getfixturevalue("open3d_library")
    return chosen


@pytest.fixture
def matcher(name: str) -> Matcher:
    return MATCHERS[name]()
