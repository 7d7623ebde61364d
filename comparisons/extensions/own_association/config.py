"""Settings of the smoother's own association."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from comparisons.config import Configured, ExtensionConfig, setting
from comparisons.options import Option

if TYPE_CHECKING:
    from comparisons.extensions.own_association.extension import OwnAssociation

When = Literal["always", "never"]


class OwnAssociationConfig(ExtensionConfig):
    """Second solution, with an association found by the smoother itself."""

    switch = Option(
        "--smoother-association",
        jobs=("run",),
        settings={"ekf": {"when": "never"}, "own": {"when": "always"}},
    )
    when: When = setting(
        "always",
        "When to solve. never: not even where a run would do it by default, for a "
        "log without labels and truth of at most 5 million pairs of measurement and landmark",
    )

    def build(self, config: Configured) -> OwnAssociation:
        """Return the extension."""
        from comparisons.extensions.own_association.extension import OwnAssociation

        return OwnAssociation(self.when)
