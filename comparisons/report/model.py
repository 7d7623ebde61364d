"""What all models of result files have in common."""

from __future__ import annotations

import math
import re
from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator

_FORMER = {
    "sighting": "measurement",
    "begun": "initialised",
    "retired": "deactivated",
    "surer": "overconfident",
    "closures": "loop_closures",
}
_WORDS = re.compile(rf"(?<![a-z])(?<!loop_)({'|'.join(_FORMER)})")


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _current(cls, data: Any) -> Any:
        return {current(str(k)): v for k, v in data.items()} if isinstance(data, dict) else data


def current(name: str) -> str:
    """Return a figure's name, which version 0.1 spelt with another word."""
    return _WORDS.sub(lambda found: _FORMER[found[0]], name)


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None
