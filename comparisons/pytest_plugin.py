"""Fixtures for pytest: logs from a folder, and the verdict on each.

With `slam_logs = path/to/logs` among pytest's settings:

    def test_my_filter(slam_log, slam_check):
        assert slam_check(slam_log).outcome == "agree"
        assert slam_check(slam_log, estimate="output/mine.tum").outcome == "agree"
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from comparisons.logs.log import Log


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the logs are."""
    parser.addini("slam_logs", "folder whose entries are logs, or names of bundled logs", "args")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test per log."""
    if "slam_log" not in metafunc.fixturenames:
        return
    found = list(_logs(metafunc.config))
    metafunc.parametrize("slam_log", found, ids=[Path(n).name for n in found], indirect=True)


@pytest.fixture
def slam_log(request: pytest.FixtureRequest) -> Log:
    """A log of the folder that the setting `slam_logs` names."""
    from comparisons.logs.bundled import open_log

    return open_log(request.param)


@pytest.fixture
def slam_check() -> Callable[..., Any]:
    """Judge a log: the reference EKF's run, or the estimate of another system given as a path.

    What it returns has `outcome`, `causes` and `remarks`. Settings are named as the options of
    `slamcheck run`, as `filter="compressed"`; for an estimate `association`, `gps`, `require`
    and `robust`.
    """

    def check(log: Log, estimate: str | Path | None = None, **settings: Any) -> Any:
        if estimate is None:
            from comparisons.pipeline.compare import compare
            from comparisons.settings import run_config

            return compare(log, run_config(**settings)).verdict
        from comparisons.config import CheckConfig
        from comparisons.estimates.external import read_given
        from comparisons.options import GPS, REQUIRE, ROBUST, SOLVER_ASSOCIATION, options
        from comparisons.pipeline.check import check as check_estimate
        from comparisons.settings import configure

        given = read_given(Path(estimate))
        flags = options((SOLVER_ASSOCIATION, GPS, REQUIRE, ROBUST), settings)
        return check_estimate(log, given, configure(CheckConfig, flags=flags))

    return check


def _logs(config: pytest.Config) -> list[str]:
    names: list[str] = []
    for entry in config.getini("slam_logs"):
        folder = (config.rootpath / entry) if not Path(entry).is_absolute() else Path(entry)
        if folder.is_dir() and not (folder / "log.toml").exists():
            names += sorted(str(p) for p in folder.iterdir() if not p.name.startswith("."))
        else:
            names.append(str(folder) if folder.exists() else entry)
    return names
