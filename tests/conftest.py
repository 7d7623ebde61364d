from __future__ import annotations

from pathlib import Path

import pytest

from comparisons.compare import Comparison, compare_estimators
from comparisons.logs.bundled import open_log

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


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
