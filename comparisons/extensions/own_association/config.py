"""Settings of the smoother's own association."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.choices import When
from comparisons.config import Configured, ExtensionConfig

if TYPE_CHECKING:
    from comparisons.extensions.own_association.extension import OwnAssociation


class OwnAssociationConfig(ExtensionConfig):
    """Solve for a second time, with the smoother's own association."""

    when: When = Field(
        "always", description="never: not even where a run would ask for it by itself"
    )

    def build(self, config: Configured) -> OwnAssociation:
        """Return the extension."""
        from comparisons.extensions.own_association.extension import OwnAssociation

        return OwnAssociation(self.when)
