"""What the records of a filter's run say of it, beside the gaps between the estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from comparisons.checks.diagnosis.data_usage import DataFault
from comparisons.pipeline.gaps import Gaps
from comparisons.rounding import Allowed
from comparisons.shown import Brief

if TYPE_CHECKING:
    from comparisons.checks.diagnosis.model_differences import ModelDifference


@dataclass(frozen=True, repr=False)
class FilterRecords(Brief):
    """Those of a filter that anybody has; each kind says besides what it keeps.

    What explains a gap is looked for only where there is one.
    """

    MOST_HIDDEN: ClassVar[float] = 0.05
    """Share of sigma from which a difference counts: what rounding hides up to there is no
    verdict."""
    _TOLD: ClassVar[float] = 1e-4
    """Rounding up to which nothing is said of it."""

    gaps: Gaps
    unnamed: ClassVar[str] = ""
    """What to check where no event is named; empty for what is usual."""

    @cached_property
    def algebra(self) -> Allowed:
        """The algebra gap that rounding explains."""
        return self.gaps.algebra_rounding

    @cached_property
    def model(self) -> Allowed:
        """The model gap that rounding explains."""
        return self.gaps.model_rounding

    @cached_property
    def single(self) -> str:
        """How the algebra gap grows, if computing in single precision explains it."""
        return ""

    @property
    def _hidden(self) -> float:
        """What double precision hides of either gap; 0 where that is what storing does."""
        return 0.0 if self.algebra.stored else max(self.algebra.largest, self.model.largest)

    @property
    def untold(self) -> bool:
        """Double precision cannot tell whether the filter is right."""
        return self._hidden > self.MOST_HIDDEN

    @property
    def precision(self) -> str:
        """How well double precision tells the gaps; empty where well enough."""
        found = self._hidden
        if not found > self._TOLD:
            return ""
        digits = f"to {found:.1g} (relative) only" if np.isfinite(found) else "not at all"
        return (
            "variances or coordinates of the log lie so many powers of ten apart that double "
            f"precision resolves the algebra and model gaps {digits}"
        )

    @cached_property
    def differences(self) -> Sequence[ModelDifference]:
        """Where the models differ."""
        return self.gaps.model_differences()

    def known_model_errors(self) -> Sequence[str]:
        """Return known mistakes that reproduce the records."""
        from comparisons.checks.diagnosis.known_model_errors import explain

        return explain(self.gaps.log, self.gaps.run)

    def operations(self) -> Sequence[str]:
        """Return which events make the filter's algebra wrong, and how."""
        return ()

    def untimely(self) -> Sequence[DataFault]:
        """Return observations that are used at another instant than their own."""
        return ()

    def left_out(self) -> Sequence[str]:
        """Return why the filter did not use all measurements, in sentences."""
        return ()
