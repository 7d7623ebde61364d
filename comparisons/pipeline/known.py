"""What a job knows once its estimators have run: what its checks read, and what they have found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from comparisons.adapters.ekf_run import EkfRun
from comparisons.adapters.filter_setup import FilterSetup
from comparisons.arrays import Array
from comparisons.checks.finding import Finding, Of, V, value_of
from comparisons.pipeline.beside import Beside
from comparisons.pipeline.gaps import Gaps
from comparisons.pipeline.prepared import Prepared
from graphslam.increments import dead_reckoned


@dataclass(frozen=True, kw_only=True)
class Known:
    """What a run knows once both estimators have run, for its checks.

    setup: what stood beside the filter, with what extensions offered. started: what extensions have
    started beside the smoother, by name. findings: of the checks that came before, by name.
    """

    prepared: Prepared[Any]
    setup: FilterSetup
    ekf: EkfRun
    gaps: Gaps
    started: Mapping[str, Beside[Any]] = field(default_factory=dict)
    findings: dict[str, Finding] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)

    @cached_property
    def dead_reckoned(self) -> Array:
        """(K, 3) poses where the odometry alone leads."""
        return dead_reckoned(self.gaps.problem.prior_pose, self.gaps.problem.increment)

    def value(self, kind: type[Of[V]]) -> V | None:
        """Return the value of a finding of a kind, None where no check has it."""
        return value_of(self.findings, kind)
