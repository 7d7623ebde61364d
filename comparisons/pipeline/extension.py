"""What an extension is: it may change the log, stand beside the filter, and find something.

One object serves one comparison. `start` comes between the estimators, and `find` after both, once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from comparisons.checks.check import Check
from comparisons.checks.finding import Absent, Finding
from comparisons.pipeline.prepared import Preparation, Prepared

if TYPE_CHECKING:
    from comparisons.adapters.ekf_run import EkfRun
    from comparisons.config import Configured
    from comparisons.pipeline.beside import BackgroundCall
    from comparisons.pipeline.known import Known


class Extension(Preparation, Check):
    """One that does nothing; an extension overrides what it needs."""

    asked = True
    """Whether it does anything."""

    def __init__(self, settings: Any, config: Configured) -> None:
        """settings: its own. config: the job's, which has them."""
        self.settings, self.config = settings, config

    def start(self, prepared: Prepared[Any], run: EkfRun) -> BackgroundCall[Any] | None:
        """Start what `find` needs and the smoother does not, in a process beside it.

        Its result is found in `known.started`, by the extension's name.
        """
        return None

    def find(self, known: Known) -> Finding | Absent | None:
        """Return what was found; None where there is nothing to report."""
        return None
