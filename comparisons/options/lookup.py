"""Options of a job, by name, and what was given by them laid over a configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from comparisons.errors import InputError, note
from comparisons.options import Flag, below
from comparisons.options.earlier import RENAMED
from comparisons.options.table import FLAGS


def of_job(job: str) -> tuple[Flag, ...]:
    """Return the options of a job."""
    return tuple(flag for flag in FLAGS if job in flag.jobs)


def by_name(table: Iterable[Flag], values: Mapping[str, Any]) -> list[tuple[Flag, Any]]:
    """Return flags with values by their options' names, as `filter` or `smoother_association`.

    Earlier names and values are read, with a note. Raises InputError for a name that no flag of
    the table has.
    """
    known = {flag.name.rstrip("_"): flag for flag in table}
    found = []
    for name, value in values.items():
        option = f"--{name.replace('_', '-')}"
        now, new = option, value
        for one in RENAMED:
            if option == (one.was_option or one.option):
                now = one.option
                new = one.values.get(value, value) if isinstance(value, str) else value
        flag = known.get(now[2:].replace("-", "_"))
        if flag is None:
            raise InputError(f"option {name}: is unknown, expected some of {', '.join(known)}")
        if (now, new) != (option, value):
            note(f"{name}={value!r} is now {flag.name.rstrip('_')}={new!r}")
        found.append((flag, new))
    return found


def lay_over(config: dict[str, Any], flags: Sequence[tuple[Flag, Any]]) -> None:
    """Put flags that were given over nested mappings, sections before what lies within them.

    Only flags that are given count, so that a flag can also take a file's value back.
    """
    for flag, value in sorted(flags, key=lambda one: bool(one[0].within)):
        flag.lay_over(config, value)


def check_applies(config: Mapping[str, Any], usual: Mapping[str, Any]) -> None:
    """Raise InputError for a setting that is not the usual one and has no effect beside the rest.

    config, usual: whole configurations of one job as nested mappings, the latter all defaults.
    """
    for flag in FLAGS:
        value = below(config, flag.field)
        if flag.where is None or value == below(usual, flag.field):
            continue
        if below(config, flag.where.field) != flag.where.value:
            raise InputError(f"{flag.option} {value} goes with {flag.where.words}")
