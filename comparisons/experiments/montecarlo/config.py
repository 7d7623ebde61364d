"""Everything that decides a Monte Carlo study, as data."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from pydantic import Field, field_validator

from comparisons.config import SettingsGroup
from comparisons.logs.table import read_toml

FilterName = Literal["ekf", "fej", "oc", "riekf", "ideal"]
FILTER_NAMES: tuple[str, ...] = get_args(FilterName)


class MonteCarloConfig(SettingsGroup):
    """`slamcheck montecarlo`: variants of the EKF, many times in simulation.

    Neither the workers nor a scheduler are here, for they change no result.
    """

    job: Literal["montecarlo"] = "montecarlo"
    scenario: str = Field(
        "circle",
        description="Scenario: circle, circle-range-bearing, bailey-loop, nieto-loop, or a "
        "scenario file; the argument SCENARIO",
    )
    runs: int = Field(
        50, ge=1, le=1_000_000, description="Number of runs; run n has seed n. Option: --runs"
    )
    filters: tuple[FilterName, ...] = Field(
        get_args(FilterName),
        description="EKF variants: ekf (standard), fej (first-estimates Jacobian), oc "
        "(observability constrained), riekf (right-invariant), ideal (linearised at the truth). "
        "Option: --filters",
    )
    sha256: str | None = Field(
        None,
        description="SHA-256 of the scenario. A scenario with another hash is refused without "
        "--allow-changed-scenario",
    )

    commands: dict[str, str] = Field(
        {},
        description="External filters by name: hash of the words and the files that these name; "
        "run only if --command gives them again",
    )

    @field_validator("filters")
    @classmethod
    def _each_once(cls, filters: tuple[FilterName, ...]) -> tuple[FilterName, ...]:
        if not filters:
            raise ValueError(f"filters: empty, expected some of {', '.join(get_args(FilterName))}")
        for name in filters:
            if filters.count(name) > 1:
                raise ValueError(f"filters: {name} is named twice, expected each once")
        return filters


def is_config(name: str) -> bool:
    """Whether this is the file of a job's configuration, and not a scenario, by its keys.

    Raises InputError for a file that not valid TOML.
    """
    path = Path(name)
    return path.is_file() and not {"job", "scenario"}.isdisjoint(read_toml(path))
