"""What an extension is: it may change the log, stand beside the filter, and find something.

One object serves one comparison. `prepare` comes first, once. `attach` comes before every run of
the filter, which may be more than one: what it puts beside the filter is made anew each time.
`start` comes between the estimators, and `find` after both, once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from comparisons.checks.check import Absent, Check, Finding

if TYPE_CHECKING:
    from comparisons.adapters.ekf_run import EkfRun
    from comparisons.adapters.filter_setup import FilterSetup
    from comparisons.config import Configured
    from comparisons.pipeline.beside import Beside
    from comparisons.pipeline.gaps import Known
    from comparisons.pipeline.prepare import Prepared


class Extension(Check):
    """One that does nothing; an extension overrides what it needs."""

    brings_landmarks = False
    """The estimators need no measurements of the log's."""
    asked = True
    """Whether it does anything."""
    brings_motion = False
    """The estimators need no odometry of the log's."""

    def __init__(self, settings: Any, config: Configured) -> None:
        """settings: its own. config: the job's, which has them."""
        self.settings, self.config = settings, config

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Return what the estimators are given, changed. Raises InputError."""
        return prepared

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Put sources, observers or guards beside a filter that is about to run."""

    def start(self, prepared: Prepared[Any], run: EkfRun) -> Beside[Any] | None:
        """Start what `find` needs and the smoother does not, in a process beside it.

        Its result is found in `known.started`, by the extension's name.
        """
        return None

    def find(self, known: Known) -> Finding | Absent | None:
        """Return what was found; None where there is nothing to report."""
        return None
