"""What all models of result files have in common."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None
