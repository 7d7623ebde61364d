"""Settings of the smoother's own association."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.choices import When
from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.own_association.extension import OwnAssociation


class OwnAssociationConfig(ExtensionConfig):
    """Second solution, with an association found by the smoother itself."""

    when: When = Field(
        "always",
        description="When to solve. never: not even where a run would do it by default, for a "
        "log without labels and truth of at most 5 million pairs of measurement and landmark",
    )

    def build(self, config: Configured) -> OwnAssociation:
        """Return the extension."""
        from comparisons.extensions.own_association.extension import OwnAssociation

        return OwnAssociation(self.when)
