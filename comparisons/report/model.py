"""What all models of result files have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)
