"""Simulated logs that several tests share, made once each."""

from functools import cache

from comparisons.logs.bundled import SimulationChoices, open_log
from comparisons.logs.log import Log
from tests.helpers import first_seconds


@cache
def scenario(name: str, seed: int = 0, seconds: float | None = None) -> Log:
    """A simulated log by its bundled name, or its first seconds."""
    log = open_log(name, choices=SimulationChoices(seed))
    return log if seconds is None else first_seconds(log, seconds)
