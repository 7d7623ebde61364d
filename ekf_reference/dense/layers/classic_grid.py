"""Temporary."""

from __future__ import annotations

import numpy as np

from ekf_reference.dense.layers.layer import Samples
from ekf_reference.dense.scan import Scan


class ClassicGrid:
    """Temporary."""

    def __init__(self, resolution_m: float) -> None:
        """Temporary."""

    def fuse(self, scan: Scan) -> None:
        """Temporary."""

    def samples(self) -> Samples:
        """Temporary."""
        return Samples(np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.intp))
