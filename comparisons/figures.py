"""What all results have in common: how figures are kept in files and said in words."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import platform
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, TypeAdapter
from pydantic_core import CoreSchema, PydanticUndefined, core_schema

from comparisons.errors import InputError
from comparisons.words import Row

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
        return core_schema.with_default_schema(core_schema.any_schema(), default=None)


Aside = Annotated[T, Field(exclude=True), _Unread()]
"""What a finding holds and result files leave out: of any type, None of what a file holds."""

Side = Literal["less", "more", "nominal", "same", "count", "left out"]
"""Which change of a figure is for the better: less, more, nearer to its nominal value, or none. A
count is the same as none where it is zero. Figures that are left out are in no baseline."""


@dataclass(frozen=True)
class Mark:
    """What a field declares of its figure, or of all figures below it that declare nothing.

    nominal: value that is best, or the field beside it that has it. within: the field beside it
    with what rounding explains. exact: no change is small. key: the name of its row in a list.
    name: in place of the field's own. together: what is read of a list.
    """

    side: Side | None = None
    nominal: float | str = 1.0
    _: KW_ONLY
    within: str = ""
    exact: bool = False
    key: bool = False
    name: str | None = None
    together: Callable[[Any], object] | None = None


METRES = "{:.3f} m"


def percent(share: float, digits: int = 1) -> str:
    """Return a share in hundredths."""
    return f"{100.0 * share:.{digits}f} %"


@dataclass(frozen=True)
class Named:
    """What tables call the figure of a field, and how they write it, with its unit.

    form: of the value, and of what the field is of.
    """

    name: str
    form: str | Callable[[Any], str] = "{:,}"

    def row(self, group: str, value: Any, of: Any, before: str) -> Row:
        """Return the row of a table."""
        text = self.form.format(value, of) if isinstance(self.form, str) else self.form(value)
        return Row(group, f"{before}{self.name}", text)


_UNMARKED = Mark()
Less = Annotated[T, Mark("less")]
More = Annotated[T, Mark("more")]
Nominal = Annotated[T, Mark("nominal")]
Same = Annotated[T, Mark("same")]
Count = Annotated[T, Mark("count")]
Exact = Annotated[T, Mark("count", exact=True)]
OfDof = Annotated[T, Mark("nominal", "dof")]
Share95 = Annotated[T, Mark("nominal", 0.95)]
LeftOut = Annotated[T, Mark("left out")]
Key = Annotated[T, Mark(key=True)]


class Number(NamedTuple):
    """A figure, and how it is judged, see Mark. side: None where nothing says it."""

    value: float | None
    side: Side | None = "same"
    nominal: float = 1.0
    rounding: float | None = None
    exact: bool = False


def stored(found: object, kind: type | None = None) -> Any:
    """Return what a result file keeps of a dataclass, or of the one above it that is named."""
    adapter: TypeAdapter[Any] = TypeAdapter(kind or type(found))
    return adapter.dump_python(found, mode="json")


class Declared(NamedTuple):
    """A field that result files keep. hint: its type. named: None where tables leave it out."""

    hint: Any
    mark: Mark
    named: Named | None


@cache
def kept_fields(kind: Any) -> Mapping[str, Declared]:
    """Return the fields that result files keep of a model or a dataclass, by name; none of others.

    What is computed is a field as well.
    """
    found: dict[str, tuple[Any, Sequence[Any]]] = {}
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        found = {
            name: (field.annotation, (field, *field.metadata))
            for name, field in kind.model_fields.items()
        }
    elif isinstance(kind, type) and dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        hints = {field.name: hints[field.name] for field in dataclasses.fields(kind)} | {
            name: get_type_hints(value.wrapped.fget, include_extras=True)["return"]
            for name, value in vars(kind).items()
            if hasattr(value, "decorator_info")
        }
        found = {name: (hint, getattr(hint, "__metadata__", ())) for name, hint in hints.items()}
    return {
        name: Declared(
            next((one for one in map(_type_in_files, extra) if one is not None), hint),
            next((mark for mark in extra if isinstance(mark, Mark)), _UNMARKED),
            next((one for one in extra if isinstance(one, Named)), None),
        )
        for name, (hint, extra) in found.items()
        if not any(getattr(one, "exclude", None) for one in extra)
    }


def _type_in_files(serializer: Any) -> Any:
    """Return the type that a field's mark says files have, None where it says none."""
    kind: Any = serializer.return_type if isinstance(serializer, PlainSerializer) else None
    return None if kind is PydanticUndefined else kind


def rows_of(group: str, found: Any, only: Iterable[str] = (), before: str = "") -> list[Row]:
    """Return a row for each field that has a name in tables, and is not None.

    Args:
        group: Of the rows.
        found: A model, or a dataclass.
        only: Names of the fields, in this order; all without.
        before: Stands before each name.
    """
    kind: Any = type(found)
    fields = kept_fields(kind)
    return [
        named.row(group, value, found, before)
        for name in only or fields
        if (named := fields[name].named) and (value := getattr(found, name)) is not None
    ]


def numbers(
    found: Any, hint: Any, above: str = "", side: Side | None = None
) -> Iterator[tuple[str, Number]]:
    """Yield each number of a result by its dotted name, and how it is judged.

    Of lists only those whose rows have a name, or that are read together, and no truth values.

    Args:
        found: A model, a dataclass, or what a file holds of it.
        hint: Its type; None where that is unknown.
        above: Its name.
        side: Of numbers that do not declare any, and of all below what is left out; else whole
            ones are `same`.
    """
    for name, value, inner, mark in _parts(found, hint):
        whole = ".".join(filter(None, (above, name)))
        judged = side if side == "left out" else mark.side or side
        if mark.together is not None and isinstance(value, list | tuple):
            together = mark.together(value)
            yield from numbers(together, type(together), whole, judged)
        elif _plain(value):
            nominal = at(found, mark.nominal) if isinstance(mark.nominal, str) else mark.nominal
            rounding = at(found, mark.within) if mark.within else None
            judged = judged or ("same" if isinstance(value, int) else None)
            yield whole, Number(number(value), judged, nominal, rounding, mark.exact)
        else:
            yield from numbers(value, inner, whole, judged)


def _parts(found: Any, hint: Any) -> Iterator[tuple[str, Any, Any, Mark]]:
    """Yield name, value, type and mark of each field, entry, or row with a name."""
    while get_origin(hint) in (Annotated, Union, UnionType):
        hint = get_args(hint)[0]
    within = get_args(hint)
    if isinstance(found, list | tuple):
        row = within[0] if within else hint
        keys = [name for name, one in kept_fields(row).items() if one.mark.key]
        for one in found if keys else ():
            yield ".".join(str(at(one, key)) for key in keys), one, row, _UNMARKED
    elif fields := kept_fields(hint):
        for name, field in fields.items():
            instead = field.mark.name
            yield name if instead is None else instead, at(found, name), field.hint, field.mark
    elif isinstance(found, Mapping):
        for name, value in found.items():
            yield str(name), value, within[-1] if within else None, _UNMARKED


def number(value: Any) -> float | None:
    """Return what is a number, neither infinite nor as good as that; None for anything else."""
    return value if _plain(value) and abs(value) < 1e300 else None


def _plain(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def at(found: Any, name: str) -> Any:
    """Return a part of a model or dataclass, or of what a file holds of it; None without."""
    return found.get(name) if isinstance(found, Mapping) else getattr(found, name, None)


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


def degrees(angle_rad: float) -> str:
    """Return an angle: one decimal, below a degree two digits, never 0.0 of one that is there."""
    angle = math.degrees(angle_rad)
    return f"{angle:.1f} degrees" if abs(angle) >= 1.0 else f"{angle:.2g} degrees"


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
