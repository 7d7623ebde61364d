"""These tests also run without the rest of the project, beside nothing but the package."""

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks that these tests use."""
    config.addinivalue_line("markers", "slow: more than a few seconds")
