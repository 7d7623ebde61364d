"""The extensions by name. A name's module is imported only where a configuration names it."""

from __future__ import annotations

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
