from __future__ import annotations

import pytest

from graphslam.scan.matchers import MATCHERS
from graphslam.scan.registration import Matcher

IN_OPEN3D = {"point-to-point", "point-to-plane", "generalised"}


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
