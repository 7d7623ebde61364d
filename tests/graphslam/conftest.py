from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Name the marker, for these tests run without the project's configuration, too."""
    config.addinivalue_line("markers", "slow: more than a few seconds")
