"""Tests that need KISS-ICP or Open3D skip where the extra `scans` is not installed."""

from collections.abc import Generator

import pytest

from graphslam.scan.libraries import MissingLibraryError


def _skipping() -> Generator[None, object, object]:
    """Make a library that cannot be loaded a skip, with what would mend it as its reason."""
    try:
        return (yield)
    except MissingLibraryError as error:
        pytest.skip(str(error))


def pass_on(said: str) -> None:
    """Raise MissingLibraryError where another process, which said this, lacked a library."""
    if "pip install 'slamcheck[scans]'" in said:
        raise MissingLibraryError(said)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    """Look at what fixtures need."""
    return (yield from _skipping())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Look at what a test needs."""
    return (yield from _skipping())
