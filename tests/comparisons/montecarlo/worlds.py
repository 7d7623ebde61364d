"""Small worlds for the tests."""

from pathlib import Path

from comparisons.experiments import scenarios
from comparisons.experiments.montecarlo.config import MonteCarloConfig
from comparisons.experiments.montecarlo.study import Study
from comparisons.experiments.scenarios.scenario import Scenario, read_scenario
from comparisons.experiments.scenarios.world import ScenarioWorld, build_world

SCENARIOS = Path(scenarios.__path__[0])


def shortened(folder: Path, steps: int, name: str = "circle") -> Path:
    """A bundled scenario in a file, `short.toml`, with fewer steps."""
    path = folder / "short.toml"
    text = (SCENARIOS / f"{name}.toml").read_text()
    assert "steps = 2500" in text
    path.write_text(text.replace("steps = 2500", f"steps = {steps}"))
    return path


def short(name: str, steps: int) -> Scenario:
    """The beginning of a bundled scenario."""
    return read_scenario(name).model_copy(update={"steps": steps})


def short_world(name: str, steps: int) -> ScenarioWorld:
    """Its truth."""
    return build_world(short(name, steps))


def study_of(scenario: Scenario, runs: int, *filters: str) -> Study:
    """A study of a scenario that has no file; of all filters if none is named."""
    chosen = {"filters": filters} if filters else {}
    return Study(MonteCarloConfig.of(runs=runs, **chosen), scenario)
