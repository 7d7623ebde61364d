"""The extensions by name. A name's module is imported only where a configuration names it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from comparisons.errors import InputError

if TYPE_CHECKING:
    from comparisons.config import ExtensionConfig

EXTENSIONS = {
    "own_association": "comparisons.extensions.own_association.config:OwnAssociationConfig",
    "own_matching": "comparisons.extensions.own_matching.config:OwnMatchingConfig",
    "posterior": "comparisons.extensions.posterior.config:PosteriorConfig",
    "scan_motion": "comparisons.extensions.scan_motion.config:ScanMotionConfig",
    "scan_landmarks": "comparisons.extensions.scan_landmarks.config:ScanLandmarksConfig",
    "dense_maps": "comparisons.extensions.dense_maps.config:DenseMapsConfig",
    "dynamic": "comparisons.extensions.dynamic.config:DynamicConfig",
    "high_level": "comparisons.extensions.high_level.config:HighLevelConfig",
    "fastslam": "comparisons.extensions.fastslam.config:FastSlamConfig",
}
"""Name to the class of its settings. The order is that in which extensions prepare, attach, check
and report; one that uses what another offers comes after it."""


def config_class(name: str) -> type[ExtensionConfig]:
    """Return the class of an extension's settings. Raises InputError for an unknown name."""
    if name not in EXTENSIONS:
        known = ", ".join(EXTENSIONS)
        raise InputError(f"extensions.{name[:80]}: is unknown, expected one of {known}")
    found: type[ExtensionConfig] = named(EXTENSIONS[name])
    return found


def named(place: str) -> Any:
    """Return what `module:name` stands for."""
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)
