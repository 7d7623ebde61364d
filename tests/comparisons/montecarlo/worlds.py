"""Small worlds for the tests."""

from __future__ import annotations

from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from comparisons.experiments.scenarios.world import World, build_world


def short(name: str, steps: int) -> Scenario:
    """The beginning of a bundled scenario."""
    return read_scenario(name).model_copy(update={"steps": steps})


def short_world(name: str, steps: int) -> World:
    """Its truth."""
    return build_world(short(name, steps))
