"""Numbers for JSON, which has none that are not finite."""

from __future__ import annotations

import math


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None
