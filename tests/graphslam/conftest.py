from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker of slow tests, for runs without the configuration of a project."""
    config.addinivalue_line("markers", "slow: more than a few seconds")
