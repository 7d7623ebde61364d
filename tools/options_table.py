"""`comparisons/options/table.py`, generated: `python -m tools.options_table > FILE`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo

from comparisons.config import JOBS, ExtensionConfig, SettingsGroup, choices_of, config_class
from comparisons.extension_names import EXTENSIONS
from comparisons.options import Flag, Option

_FIRST = (
    *("ekf", "log.features", "extensions.scan_landmarks", "extensions.scan_motion", "extensions"),
    *("smoother", "preset", "log", "fail_on", "report"),
)
"""Settings in the order of their options, as in names of folders; all others follow."""
_HEAD = '''\
"""The options of all jobs, generated from their settings by `make settings`."""

# fmt: off
# ruff: noqa

from comparisons.options import Flag, Where

FLAGS: tuple[Flag, ...] = (
'''
_TAIL = '''\
)


def of_job(job: str) -> tuple[Flag, ...]:
    """Return the options of a job."""
    return tuple(flag for flag in FLAGS if job in flag.jobs)
'''


def source() -> str:
    """Return the text of the module."""
    return _HEAD + "".join(f"    {_literal(flag)},\n" for flag in flags()) + _TAIL


def flags() -> list[Flag]:
    """Return the options of all jobs' settings, each with the jobs that have it."""
    found: dict[tuple[str, str], Flag] = {}
    for job, kind in JOBS.items():
        for flag in _of_section(kind):
            if job in (flag.jobs or JOBS):
                key = flag.option, flag.field
                jobs = (*(found[key].jobs if key in found else ()), job)
                found[key] = dataclasses.replace(flag, jobs=jobs)
    return sorted(found.values(), key=_place)


def _place(flag: Flag) -> int:
    """Return where a flag stands among others: by the longest path that it lies under."""
    under = [i for i, path in enumerate(_FIRST) if f"{flag.field}.".startswith(f"{path}.")]
    return max(under, key=lambda i: len(_FIRST[i]), default=len(_FIRST))


def _of_section(kind: type[SettingsGroup], above: str = "") -> Iterator[Flag]:
    for name, field in kind.model_fields.items():
        if name == "extensions":
            for one in EXTENSIONS:
                yield from _of_extension(config_class(one), f"extensions.{one}")
        elif isinstance(field.annotation, type) and issubclass(field.annotation, SettingsGroup):
            yield from _of_section(field.annotation, f"{above}{name}.")
        else:
            for option in field.metadata:
                if isinstance(option, Option):
                    yield _of_field(option, f"{above}{name}", field)


def _of_extension(kind: type[ExtensionConfig], path: str) -> Iterator[Flag]:
    if (option := kind.switch) is not None:
        words = tuple(option.settings or ())
        switch = bool in map(type, words)
        yield Flag(
            **vars(option), field=path, kind=bool if switch else str, words=() if switch else words
        )
    yield from _of_section(kind, f"{path}.")


def _of_field(option: Option, path: str, field: FieldInfo) -> Flag:
    kind: Any = field.annotation
    if type(None) in (parts := get_args(kind)):
        (kind,) = (one for one in parts if one is not type(None))
    many = get_origin(kind) is tuple and not option.text
    plain = get_args(kind)[0] if many else kind
    usual = field.get_default(call_default_factory=True)
    if option.panel and not option.help:
        about, _, words = (field.description or "").partition(". Default: ")
        option = dataclasses.replace(option, help=f"{about}. [{words or usual}]")
    return Flag(
        **vars(option),
        field=path,
        kind=plain if plain in (bool, int, float) else str,
        words=() if option.text else choices_of(kind),
        many=many,
        neutral=usual if option.within else None,
    )


def _literal(value: Any) -> str:
    """Return an expression for a value; of a flag what is not usual."""
    if isinstance(value, type):
        return value.__name__
    if not isinstance(value, Flag):
        return repr(value)
    words = {one.name: getattr(value, one.name) for one in dataclasses.fields(value)}
    usual = {one.name: one.default for one in dataclasses.fields(value)}
    given = [f"{name}={_literal(one)}" for name, one in words.items() if one != usual[name]]
    return f"Flag({', '.join(given)})"


if __name__ == "__main__":
    sys.stdout.write(source())
