"""`slamcheck config`: every setting with its default and its meaning."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from comparisons.cli.support import guarded

if TYPE_CHECKING:
    from pydantic import BaseModel

    from comparisons.config import Section


class JobName(StrEnum):
    """The jobs that have a configuration."""

    RUN = "run"
    SOLVE = "solve"
    CHECK = "check"
    MAP = "map"
    ODOMETRY = "odometry"
    MONTECARLO = "montecarlo"


def config(
    job: Annotated[JobName, typer.Argument(help="Whose settings.")] = JobName.RUN,
    schema: Annotated[
        bool, typer.Option("--schema", help="The JSON schema of the configuration instead.")
    ] = False,
) -> None:
    """Print a job's settings with their defaults and meanings, as TOML that can be used.

    \b
    Examples:
      slamcheck config > my.toml
      slamcheck run my-log --config my.toml --set dense_maps.resolution_m=0.4
      slamcheck config --schema
    """
    with guarded():
        from comparisons.config import Configured, json_schema
        from comparisons.extensions.registry import EXTENSIONS, config_class

        kind = _kind(job)
        if schema:
            typer.echo(json.dumps(json_schema(kind), indent=2))
            return
        lines = [f'job = "{job.value}"', *_fields(kind)]
        if issubclass(kind, Configured):
            lines.append("\n# Extensions take part where their section is there.")
            for name in EXTENSIONS:
                lines += _section(f"extensions.{name}", config_class(name), aside=True)
        typer.echo("\n".join(lines))


def _kind(job: JobName) -> type[Section]:
    from comparisons.config import JOBS

    if job is JobName.MONTECARLO:
        from comparisons.cli.montecarlo import config_class

        return config_class()
    return JOBS[job.value]


def _fields(kind: type[BaseModel]) -> list[str]:
    from pydantic import BaseModel

    simple, sections = [], []
    for name, field in kind.model_fields.items():
        if name in ("job", "extensions"):
            continue
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            sections += _section(name, field.annotation)
        else:
            simple.append(_line(name, kind))
    return simple + sections


def _section(name: str, kind: type[BaseModel], *, aside: bool = False) -> list[str]:
    first = (kind.__doc__ or "").strip().splitlines()[0]
    lines = [f"[{name}]", *(_line(one, kind) for one in kind.model_fields)]
    if aside:
        lines = [f"# {line.removeprefix('# ')}" for line in lines]
    return ["", f"# {first}", *lines]


def _line(name: str, kind: type[BaseModel]) -> str:
    import tomli_w

    field = kind.model_fields[name]
    value = field.get_default(call_default_factory=True)
    meaning = field.description or ""
    choices = _choices(kind, name)
    meaning += f" ({choices})" if choices else ""
    if value is None:
        return f'# {name} = ""    # {meaning}'
    plain = list(value) if isinstance(value, tuple) else value
    return f"{tomli_w.dumps({name: plain}).strip()}    # {meaning}"


def _choices(kind: type[BaseModel], name: str) -> str:
    from comparisons.config import choices_of

    return " | ".join(choices_of(kind.model_fields[name].annotation))
