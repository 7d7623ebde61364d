import pytest

from tests.graphslam.skips import pytest_runtest_call as pytest_runtest_call
from tests.graphslam.skips import pytest_runtest_setup as pytest_runtest_setup


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker of slow tests, for runs without the configuration of a project."""
    config.addinivalue_line("markers", "slow: more than a few seconds")
