"""What an extension is: it may change the log, stand beside the filter, and find something.

One object serves one comparison. `prepare` comes first, once. `attach` comes before every run of
the filter, which may be more than one: what it puts beside the filter is made anew each time.
`start` comes between the estimators, and `check` after both, once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from comparisons.words import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.adapters.ekf_run import EkfRun
    from comparisons.adapters.filter_setup import FilterSetup
    from comparisons.checks.causes import Cause
    from comparisons.estimates.estimate import Estimate
    from comparisons.pipeline.beside import Beside
    from comparisons.pipeline.gaps import Compared
    from comparisons.pipeline.prepare import Prepared
    from comparisons.report.html.drawing import Drawing
    from comparisons.report.models import LandmarkResult


class Extension:
    """One that does nothing; an extension overrides what it needs."""

    name = ""
    """Key in the configuration, in the result and in the report."""
    brings_landmarks = False
    """The estimators need no measurements of the log's."""
    brings_motion = False
    """The estimators need no odometry of the log's."""

    def prepare(self, prepared: Prepared[Any]) -> Prepared[Any]:
        """Return what the estimators are given, changed. Raises InputError."""
        return prepared

    def attach(self, setup: FilterSetup, prepared: Prepared[Any]) -> None:
        """Put sources, observers or guards beside a filter that is about to run."""

    def start(self, prepared: Prepared[Any], run: EkfRun) -> Beside[Any] | None:
        """Start what `check` needs and the smoother does not, in a process beside it.

        Its result is found in `compared.started`, by the extension's name.
        """
        return None

    def check(self, compared: Compared) -> Finding | None:
        """Return what was found; None where there is nothing to report."""
        return None


class Finding:
    """What an extension found. This one is empty; an extension's own overrides what it needs."""

    entries: Mapping[str, BaseModel] = {}
    """Entries of `result.json`, by key."""
    causes: Sequence[Cause] = ()
    """Reasons to disagree. They count where the algebra and the models agree, and the smoother's
    optimum was verified."""
    remarks: Sequence[str] = ()
    """Sentences that change no verdict."""
    line: tuple[str, str] | None = None
    """Its line of what the command prints: a name of at most 12 letters, and words."""
    estimates: Mapping[str, Estimate] = {}
    """Further estimates, by the folder that they are written to; the page draws each."""
    titles: Mapping[str, str] = {}
    """What the page calls them, where the folder's name does not say it."""

    def rows(self) -> Sequence[Row]:
        """Return rows of the table."""
        return ()

    def draw(self, axis: Axes) -> None:
        """Draw on the map."""

    def figures(self) -> Mapping[str, Figure]:
        """Return pictures of its own, by file name without suffix."""
        return {}

    def layers(self, drawing: Drawing) -> None:
        """Add layers to the page's map."""

    def landmarks(self) -> Sequence[LandmarkResult]:
        """Return rows of the page's table of landmarks, of those that have a direction."""
        return ()

    def sections(self) -> Sequence[str]:
        """Return sections of the page, as HTML."""
        return ()
