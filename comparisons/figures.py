"""What all results have in common: how figures are kept in files and said in words."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, TypeAdapter
from pydantic_core import CoreSchema, core_schema

from comparisons.errors import InputError

T = TypeVar("T")
_PACKAGES = ("slamcheck", "gtsam", "numpy", "scipy", "kiss-icp", "open3d-cpu", "open3d")
"""Those that the results depend on."""
_MEANING = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def finite(value: float | None) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if value is not None and math.isfinite(value) else None


def json_text(found: Any, indent: int | None = None) -> str:
    """Return JSON. Raises InputError that names the first number that JSON cannot hold."""
    separators = (",", ":") if indent is None else None
    try:
        return json.dumps(found, indent=indent, separators=separators, allow_nan=False)
    except ValueError:
        name, value = next(_not_finite(found))
        raise InputError(
            f"{name} is {value}: numbers of the input are so large that it overflows"
        ) from None


def _not_finite(found: Any, name: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(found, float) and not math.isfinite(found):
        yield name.removeprefix("."), found
    elif isinstance(found, dict | list | tuple):
        for key, value in found.items() if isinstance(found, dict) else enumerate(found):
            yield from _not_finite(value, f"{name}.{key}")


def _read(value: Any) -> Any:
    return math.nan if value is None else value


Figure = Annotated[float, BeforeValidator(_read), PlainSerializer(finite, float | None)]
"""A number that result files hold as null where it is infinite or no number."""


class _Unread:
    """Of a field whose type is nobody's business but its owner's."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.any_schema()


Aside = Annotated[T, Field(exclude=True), _Unread()]
"""What a finding holds and result files leave out: of any type."""


def stored(found: object, kind: type | None = None) -> Any:
    """Return what a result file keeps of a dataclass, or of the one above it that is named."""
    adapter: TypeAdapter[Any] = TypeAdapter(kind or type(found))
    return adapter.dump_python(found, mode="json")


def kept_fields(kind: type) -> Mapping[str, Any]:
    """Return the types of the fields that result files keep of a model or a dataclass, by name."""
    if issubclass(kind, BaseModel):
        return {
            name: field.annotation for name, field in kind.model_fields.items() if not field.exclude
        }
    if not dataclasses.is_dataclass(kind):
        return {}
    computed = {
        name: value.wrapped.fget
        for name, value in vars(kind).items()
        if hasattr(value, "decorator_info")
    }
    plain, marked = (
        get_type_hints(kind, include_extras=extras)
        | {
            name: get_type_hints(get, include_extras=extras)["return"]
            for name, get in computed.items()
        }
        for extras in (False, True)
    )
    return {
        name: float | None if marked[name] == Figure else plain[name]
        for name in (*(one.name for one in dataclasses.fields(kind)), *computed)
        if not any(getattr(m, "exclude", None) for m in getattr(marked[name], "__metadata__", ()))
    }


def meanings(kind: type) -> dict[str, str]:
    """Return the meaning of each field, from the `Attributes:` of the model and those above it."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        listed = inspect.cleandoc(one.__doc__ or "").partition("\n\nAttributes:\n")[2]
        found |= {name: " ".join(text.split()) for name, text in _MEANING.findall(listed)}
    return found


def band(low: object, high: object) -> str:
    """Return limits in words."""
    return f"{low} to {high}"


def in_sigma(value: float | None) -> str:
    """Return a distance; `infinite` where there is none."""
    return "infinite" if value is None or not math.isfinite(value) else f"{value:.2g} sigma"


def shown(value: float | None, form: str) -> str:
    """Return a number in a format; `infinite` where the result keeps none."""
    return "infinite" if value is None or not math.isfinite(value) else format(value, form)


def package_versions() -> dict[str, str]:
    """Of Python and of what the results depend on."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


def rounded(number: float) -> str:
    """Without decimals, below 10 to two digits: a small graph's chi-square is not 0."""
    return f"{number:.2g}" if abs(number) < 10.0 else f"{number:.0f}"
