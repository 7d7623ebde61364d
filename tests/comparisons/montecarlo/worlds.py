"""Small worlds for the tests."""

from __future__ import annotations

from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.montecarlo.study import Study
from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from comparisons.experiments.scenarios.world import World, build_world


def short(name: str, steps: int) -> Scenario:
    """The beginning of a bundled scenario."""
    return read_scenario(name).model_copy(update={"steps": steps})


def short_world(name: str, steps: int) -> World:
    """Its truth."""
    return build_world(short(name, steps))


def study_of(scenario: Scenario, runs: int, *filters: str) -> Study:
    """A study of a scenario that has no file; of all filters if none is named."""
    chosen = {"filters": filters} if filters else {}
    return Study(MonteCarloConfig.of(runs=runs, **chosen), scenario)
