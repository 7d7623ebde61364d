"""Figures as results keep and show them: what every floor that finds some may use."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BaseModel, BeforeValidator, Field, PlainSerializer, SkipValidation

T = TypeVar("T")


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None


def _read(value: Any) -> Any:
    return math.nan if value is None else value


Figure = Annotated[float, BeforeValidator(_read), PlainSerializer(finite, float | None)]
"""A number that result files hold as null where it is infinite or no number."""
Aside = Annotated[T, Field(exclude=True), SkipValidation()]
"""What a finding holds and result files leave out."""


def kept_fields(kind: type) -> Mapping[str, Any]:
    """Return the types of the fields that result files keep of a model or a dataclass, by name."""
    if issubclass(kind, BaseModel):
        return {
            name: field.annotation for name, field in kind.model_fields.items() if not field.exclude
        }
    if not dataclasses.is_dataclass(kind):
        return {}
    marked = get_type_hints(kind, include_extras=True)
    return {
        name: float | None if hint == Figure else hint
        for name, hint in marked.items()
        if not any(getattr(one, "exclude", None) for one in getattr(hint, "__metadata__", ()))
    }


def band(low: object, high: object) -> str:
    """Return limits in words."""
    return f"{low} to {high}"


def in_sigma(value: float | None) -> str:
    """Return a distance; `infinite` where there is none."""
    return "infinite" if value is None or not math.isfinite(value) else f"{value:.2g} sigma"


def shown(value: float | None, form: str) -> str:
    """Return a number in a format; `infinite` where the result keeps none."""
    return "infinite" if value is None or not math.isfinite(value) else format(value, form)
