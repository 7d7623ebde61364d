"""From the table of options to parameters that typer reads, and to what was given."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from comparisons.cli.support import Output, chosen_output
from comparisons.options import JOB, Flag


class DenseHelpCommand(typer.core.TyperCommand):
    """A command whose help is dense: narrow columns, and `--help` beside the job's options."""

    def get_help_option(self, ctx: Any) -> Any:
        """Return it, in the panel of the job's own options."""
        option: Any = super().get_help_option(ctx)
        option.metavar = " "
        if any(getattr(one, "rich_help_panel", None) == JOB for one in self.params):
            option.rich_help_panel = JOB
        return option

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        from typer import rich_utils

        rich_utils.STYLE_OPTIONS_TABLE_PADDING = (0, 1, 0, 0)  # type: ignore[assignment]
        super().format_help(ctx, formatter)


class Arguments(NamedTuple):
    """What a command was given. log: a name or a path. extra: the command's own options."""

    log: str | None
    flags: Sequence[tuple[Flag, Any]]
    config: Path | None
    settings: Sequence[str]
    allow_changed_log: bool
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
    flags: Iterable[Flag], shown: str, *, prints: bool = True, **extra: Any
) -> Callable[[Callable[[Arguments], None]], Callable[..., None]]:
    """Make a function of what was given into one whose parameters typer reads.

    shown: options that `--help` lists, in this order; all others are valid and stand in
    `slamcheck config`. prints: the command prints a result, as one of OUTPUT asks. extra:
    annotation and default, if any, of further parameters, which set nothing in the configuration.
    """
    listed = {option: place for place, option in enumerate(shown.split())}
    table = sorted(flags, key=lambda flag: listed.get(flag.option, len(listed)))

    def decorate(job: Callable[[Arguments], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            given = [
                (flag, _plain(value))
                for flag in table
                if (value := values[flag.name]) is not None and value != []
            ]
            common = {one.name: values[one.name] for one in (_LOG, *_COMMON)}
            printed = {name: values[name] for name in OUTPUT if prints}
            own = {name: values[name] for name in extra}
            job(Arguments(**common, flags=given, shown=printed, extra=own))

        parameters = [_LOG, *(of_flag(flag, hidden=flag.option not in listed) for flag in table)]
        parameters += [
            parameter(name, annotation, *default) for name, (annotation, *default) in extra.items()
        ]
        parameters += (*_COMMON, *(OUTPUT.values() if prints else ()))
        set_parameters(command, *parameters)
        command.__doc__ = (job.__doc__ or "").replace("\n    \b", f"    {_LOG_HELP}\n\n    \b", 1)
        command.__name__ = job.__name__
        return command

    return decorate


def set_parameters(command: Callable[..., None], *parameters: inspect.Parameter) -> None:
    """Have typer read these parameters of a command."""
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}


def argument(
    name: str,
    kind: Any,
    metavar: str,
    text: str,
    complete: Callable[[str], list[str]] | None = None,
) -> inspect.Parameter:
    """Return an argument as typer reads it, one that may be None for a kind that allows it.

    complete: what the shell offers for it.
    """
    option = typer.Argument(metavar=metavar, help=text, autocompletion=complete, show_default=False)
    if isinstance(None, kind):
        return parameter(name, Annotated[kind, option], None)
    return parameter(name, Annotated[kind, option])


def of_flag(flag: Flag, *, hidden: bool = False) -> inspect.Parameter:
    """Return an option as typer reads it; the help of one with choices names them."""
    words = {word: word for word in flag.words}
    kind: Any = Enum(flag.option, words, type=str) if words else flag.kind
    names = f"{flag.option}/--no-{flag.option[2:]}" if flag.off else flag.option
    option = typer.Option(
        names,
        help=flag.help,
        metavar=" " if flag.words else flag.metavar,
        show_default=False,
        rich_help_panel=flag.panel or None,
        hidden=hidden,
    )
    if flag.many:
        return parameter(flag.name, Annotated[list[kind], option], [])
    return parameter(flag.name, Annotated[kind | None, option], None)


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return value.value if isinstance(value, Enum) else value


def parameter(
    name: str, annotation: Any, default: Any = inspect.Parameter.empty
) -> inspect.Parameter:
    """Return a parameter as typer reads it."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def log_names(incomplete: str) -> list[str]:
    """Return the logs by name that what was typed may become; the shell adds files."""
    from comparisons.logs.bundled import NAMED

    return [name for name in NAMED if name.startswith(incomplete)]


_LOG_HELP = "LOG: a name in `slamcheck logs`, a path, or the config.toml of an earlier run."
_LOG = parameter(
    "log",
    Annotated[
        str | None,
        typer.Argument(
            metavar="LOG",
            help=_LOG_HELP.replace("LOG: a", "A"),
            hidden=True,
            show_default=False,
            autocompletion=log_names,
        ),
    ],
    None,
)


def _common(
    name: str, kind: Any, default: Any, *names: str, hidden: bool = False, **words: str
) -> inspect.Parameter:
    option = typer.Option(*names, rich_help_panel=JOB, hidden=hidden, **words)  # type: ignore[arg-type]
    return parameter(name, Annotated[kind, option], default)


_COMMON = (
    _common(
        "config",
        Path | None,
        None,
        "--config",
        metavar="FILE",
        help="Configuration file; options override it.",
    ),
    _common(
        "settings",
        list[str],
        [],
        "--set",
        metavar="KEY=VALUE",
        help="Setting of `slamcheck config`, as ekf.nn_gate=9.2.",
    ),
    _common(
        "allow_changed_log",
        bool,
        False,
        "--allow-changed-log",
        hidden=True,
        help="Use a log whose content has changed since the configuration file was written.",
    ),
    _common(
        "out",
        Path | None,
        None,
        "--out",
        metavar="DIR",
        help="Output folder. [slamcheck-COMMAND-LOG-SETTINGS]",
    ),
    _common(
        "replace",
        bool,
        False,
        "--replace",
        hidden=True,
        help="Replace an output folder that holds a run of other settings or another log.",
    ),
    _common(
        "log_file",
        Path | None,
        None,
        "--log",
        metavar="FILE",
        hidden=True,
        help="Write warnings of libraries to a file.",
    ),
)
_OUTPUT_HELP = {
    "verbose": ("--verbose", "-v", "Print all figures, causes and notes as well."),
    "json": ("--json", "", "Print the result as JSON and nothing else."),
    "quiet": ("--quiet", "-q", "Print nothing; the exit code tells the outcome."),
}
OUTPUT = {
    name: _common(name, bool, False, *filter(None, names), help=text)
    for name, (*names, text) in _OUTPUT_HELP.items()
}
"""Options of every command that prints a result, which set nothing in the configuration."""
