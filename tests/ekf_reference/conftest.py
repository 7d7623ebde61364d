"""These tests also run without the rest of the project, beside nothing but the package."""

from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Register the marks that these tests use."""
    config.addinivalue_line("markers", "slow: more than a few seconds")
