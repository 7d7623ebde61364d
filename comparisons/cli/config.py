"""`slamcheck config`: every setting with its default and its meaning."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comparisons.cli.support import guarded
from comparisons.options.table import of_job

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import BaseModel

    from comparisons.config import SettingsGroup


_WIDTH = 78
"""Characters of a comment's line."""


class JobName(StrEnum):
    """The jobs that have a configuration."""

    RUN = "run"
    SOLVE = "solve"
    CHECK = "check"
    MAP = "map"
    ODOMETRY = "odometry"
    MONTECARLO = "montecarlo"


def config(
    job: Annotated[
        JobName, typer.Argument(metavar="JOB", help="Command whose settings to list.")
    ] = JobName.RUN,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of the configuration instead.")
    ] = False,
) -> None:
    """List every setting with its default, meaning and option.

    The list is a valid configuration file (TOML) that holds the defaults.

    \b
    Examples:
      slamcheck config > my.toml
      slamcheck run my-log --config my.toml --set dense_maps.resolution_m=0.4
      slamcheck config check
    """
    with guarded():
        from comparisons.cli.app import build
        from comparisons.config import Configured, config_class, json_schema
        from comparisons.extension_names import EXTENSIONS

        kind = _kind(job)
        if schema:
            typer.echo(json.dumps(json_schema(kind), indent=2))
            return
        options = _options(job.value)
        lines = [f'job = "{job.value}"', *_fields(kind, options)]
        if issubclass(kind, Configured):
            lines.append("\n# Extensions: each takes part where its section is present.")
            for name in EXTENSIONS:
                lines += _section(f"extensions.{name}", config_class(name), options, aside=True)
        lines += _others(build(job.value), job.value)
        typer.echo("\n".join(lines))


def _kind(job: JobName) -> type[SettingsGroup]:
    from comparisons.config import JOBS

    if job is JobName.MONTECARLO:
        from comparisons.cli.montecarlo import config_class

        return config_class()
    return JOBS[job.value]


def _options(job: str) -> dict[str, str]:
    """Return the options of a job by the field or section that each sets, with its values."""
    return {
        flag.field: " ".join([flag.option, "|".join(flag.words)]).strip() for flag in of_job(job)
    }


def _fields(kind: type[BaseModel], options: Mapping[str, str]) -> list[str]:
    from pydantic import BaseModel

    simple, sections = [], []
    for name, field in kind.model_fields.items():
        if name in ("job", "extensions"):
            continue
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            sections += _section(name, field.annotation, options)
        else:
            simple += _lines(name, kind, options.get(name, ""))
    return simple + sections


def _section(
    name: str, kind: type[BaseModel], options: Mapping[str, str], *, aside: bool = False
) -> list[str]:
    about = (kind.__doc__ or "").strip().splitlines()[0]
    option = [f"# {options[name]}"] if name in options else []
    lines = [f"[{name}]"]
    for one in kind.model_fields:
        lines += _lines(one, kind, options.get(f"{name}.{one}", ""))
    if aside:
        lines = [line if line.startswith("#") else f"#{line}" for line in lines]
    return ["", *_comment(about), *option, *lines]


def _lines(name: str, kind: type[BaseModel], option: str) -> list[str]:
    """Return a setting's meaning, choices and option as comments, and its default."""
    import tomli_w

    from comparisons.config import choices_of

    field = kind.model_fields[name]
    value = field.get_default(call_default_factory=True)
    if not option:
        option = " | ".join(choices_of(field.annotation))
    about = field.description or ""
    about += "" if about[-1:] in (".", ":", "") else "."
    comment = [*_comment(about), *(option and [f"# {option}"])]
    if value is None:
        return [*comment, f'#{name} = ""']
    plain = list(value) if isinstance(value, tuple) else value
    return [*comment, tomli_w.dumps({name: plain}).strip()]


def _others(command: Any, job: str) -> list[str]:
    """Return what `--help` does not list and no setting is."""
    settings = {flag.option for flag in of_job(job)}
    lines = [
        line
        for parameter in command.params
        if getattr(parameter, "hidden", False)
        and parameter.help
        and parameter.opts[0].startswith("--")
        and parameter.opts[0] not in settings
        for line in _comment(f"{parameter.opts[0]}{_metavar(parameter)}: {parameter.help}")
    ]  # fmt: skip
    return ["", "# Options of the command line that are no settings:", *lines] if lines else []


def _metavar(one: Any) -> str:
    return f" {one.metavar}" if (one.metavar or "").strip() else ""


def _comment(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(
        text.replace("\\[", "["), _WIDTH, initial_indent="# ", subsequent_indent="# ",
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
