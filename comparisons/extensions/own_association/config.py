"""Settings of the smoother's own association."""

from __future__ import annotations

from typing import Literal

from comparisons.config import ExtensionConfig, setting
from comparisons.options import Option

When = Literal["always", "never"]


class OwnAssociationConfig(ExtensionConfig):
    """Second solution, with an association found by the smoother itself."""

    extension = "comparisons.extensions.own_association.extension:OwnAssociation"
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
