"""From the table of options to parameters that typer reads, and to what was given."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from comparisons.cli.support import Output, chosen_output
from comparisons.options import LOG_PANEL, REPORT_PANEL, Flag

_WIDE = 12
"""Characters of the choices that stand beside an option's name; longer ones end its help."""


class Given(NamedTuple):
    """What a command was given. log: a name or a path. extra: the command's own options."""

    log: str | None
    flags: Sequence[tuple[Flag, Any]]
    config: Path | None
    settings: Sequence[str]
    allow_changed: bool
    out: Path | None
    replace: bool
    log_file: Path | None
    shown: Mapping[str, bool]
    extra: Mapping[str, Any]

    @property
    def output(self) -> Output:
        """What is printed. Raises InputError where two options contradict each other."""
        return chosen_output(**self.shown)


def from_flags(
    flags: Iterable[Flag], *, shown: bool = True, **extra: Any
) -> Callable[[Callable[[Given], None]], Callable[..., None]]:
    """Make a function of what was given into one whose parameters typer reads.

    shown: the command prints a result, as one of OUTPUT asks. extra: annotation and default, if
    any, of further parameters, which set nothing in the configuration.
    """
    table = tuple(flags)

    def decorate(job: Callable[[Given], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            given = [
                (flag, _plain(value))
                for flag in table
                if (value := values[flag.name]) is not None and value != []
            ]
            job(
                Given(
                    values["log"],
                    given,
                    values["config"],
                    values["settings"],
                    values["allow_changed_log"],
                    values["out"],
                    values["replace"],
                    values["log_file"],
                    {name: values[name] for name in OUTPUT if shown},
                    {name: values[name] for name in extra},
                )
            )

        parameters = [_LOG, *(of_flag(flag) for flag in table)]
        parameters += [
            _parameter(name, annotation, *default) for name, (annotation, *default) in extra.items()
        ]
        parameters += (*_COMMON, *(OUTPUT.values() if shown else ()))
        set_parameters(command, *parameters)
        command.__doc__, command.__name__ = job.__doc__, job.__name__
        return command

    return decorate


def set_parameters(command: Callable[..., None], *parameters: inspect.Parameter) -> None:
    """Have typer read these parameters of a command."""
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}


def argument(
    name: str,
    kind: type,
    metavar: str,
    text: str,
    complete: Callable[[str], list[str]] | None = None,
) -> inspect.Parameter:
    """Return a required argument as typer reads it. complete: what the shell offers for it."""
    option = typer.Argument(metavar=metavar, help=text, autocompletion=complete)
    return _parameter(name, Annotated[kind, option])


def of_flag(flag: Flag) -> inspect.Parameter:
    """Return an option as typer reads it."""
    kind: Any = _words(flag) if flag.words else flag.kind
    names = f"{flag.option}/--no-{flag.option[2:]}" if flag.off else flag.option
    short, listed = flag.metavar, "|".join(flag.words)
    text = flag.help
    if len(listed) > _WIDE:
        short, text = "WORD", f"{text} ({', '.join(flag.words)})"
    option = typer.Option(
        names, help=text, metavar=short, show_default=False, rich_help_panel=flag.panel or None
    )
    if flag.many:
        return _parameter(flag.name, Annotated[list[kind], option], [])
    return _parameter(flag.name, Annotated[kind | None, option], None)


def _words(flag: Flag) -> Any:
    return Enum(flag.option, {one: one for one in flag.words}, type=str)


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value.value if isinstance(value, Enum) else value


def _parameter(
    name: str, annotation: Any, default: Any = inspect.Parameter.empty
) -> inspect.Parameter:
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def log_names(incomplete: str) -> list[str]:
    """Return the logs by name that what was typed may become; the shell adds files."""
    from comparisons.logs.bundled import NAMED

    return [name for name in NAMED if name.startswith(incomplete)]


_LOG = _parameter(
    "log",
    Annotated[
        str | None,
        typer.Argument(
            metavar="LOG",
            help="A bundled name (see `slamcheck logs`), a path, or the config.toml of an earlier "
            "run.",
            show_default=False,
            autocompletion=log_names,
        ),
    ],
    None,
)
_COMMON = (
    _parameter(
        "config",
        Annotated[
            Path | None,
            typer.Option("--config", metavar="FILE", help="Settings; flags go over them."),
        ],
        None,
    ),
    _parameter(
        "settings",
        Annotated[
            list[str],
            typer.Option(
                "--set",
                metavar="SECTION.KEY=VALUE",
                help="Any setting, see `slamcheck config`; may be repeated.",
            ),
        ],
        [],
    ),
    _parameter(
        "allow_changed_log",
        Annotated[
            bool,
            typer.Option(
                "--allow-changed-log",
                help="Use a log that is not the configuration's.",
                rich_help_panel=LOG_PANEL,
            ),
        ],
        False,
    ),
    _parameter(
        "out",
        Annotated[
            Path | None,
            typer.Option(
                "--out",
                metavar="DIR",
                help="Folder to write. [slamcheck-COMMAND-LOG-SETTINGS, with what is not as usual]",
            ),
        ],
        None,
    ),
    _parameter(
        "replace",
        Annotated[
            bool,
            typer.Option(
                "--replace",
                help="Replace a folder that holds another run.",
                rich_help_panel=REPORT_PANEL,
            ),
        ],
        False,
    ),
    _parameter(
        "log_file",
        Annotated[
            Path | None,
            typer.Option(
                "--log",
                metavar="FILE",
                help="Write warnings of libraries to a file.",
                rich_help_panel=REPORT_PANEL,
            ),
        ],
        None,
    ),
)
_OUTPUT_HELP = {
    "verbose": ("--verbose", "-v", "Then print all figures, causes and notes."),
    "json": ("--json", "", "Print the result as JSON and nothing else."),
    "quiet": ("--quiet", "-q", "Print nothing; the exit code tells the outcome."),
}
OUTPUT = {
    name: _parameter(
        name,
        Annotated[
            bool,
            typer.Option(*filter(None, names), help=text, rich_help_panel=REPORT_PANEL),
        ],
        False,
    )
    for name, (*names, text) in _OUTPUT_HELP.items()
}
"""Options of every command that prints a result, which set nothing in the configuration."""
