"""From a file, flags and single settings to a job's configuration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from comparisons.config import RunConfig, SettingsGroup, setting_default
from comparisons.errors import InputError, quoted, shorten
from comparisons.extension_names import EXTENSIONS
from comparisons.logs.table import parse_toml, read_toml
from comparisons.options import Flag, below, merge
from comparisons.options.table import FLAGS, of_job

C = TypeVar("C", bound=SettingsGroup)
_MOST_PARTS = 8
"""Of a setting's path; extensions' have four."""


def configure(
    job: type[C],
    file: Path | None = None,
    flags: Sequence[tuple[Flag, Any]] = (),
    settings: Sequence[str] = (),
    over: Mapping[str, Any] | None = None,
) -> C:
    """Return a configuration: defaults, then a file, then `over`, then flags, then settings.

    job: the class of a whole job's configuration, which has a field `job`. Raises InputError
    that names key, value and choices.
    """
    found = {} if file is None else read_toml(file)
    name = job.model_fields["job"].default
    if (other := found.get("job", name)) != name:
        words = shorten(other)
        raise InputError(f"{file}: is a configuration of slamcheck {words}, not of {name}")
    for given, source in ((found, f"{file}: "), (over or {}, "")):
        _check_sections(job, given, source)
    recorded = dict(found.get("log", {})) if "log" in job.model_fields else {}
    found = merge(found, over or {})
    named = {setting.partition("=")[0].strip() for setting in settings}
    if "preset" in named or any(
        flag.field == "preset" for flag, _ in flags
    ):  # over a file with them all
        from comparisons.documented.preset import without_documented

        found = without_documented(found, setting_default)
    _lay_over(found, flags)
    for setting in settings:
        found = merge(found, _nested(job, setting))
    if "sha256" in recorded and _other_log(found["log"], recorded):
        found["log"].pop("sha256", None)
    try:
        config = job.of(**found)
        _check_applies(config.model_dump(), job.of().model_dump())
        return config
    except InputError as error:
        raise InputError(f"{file}: {error}" if file is not None else str(error)) from None


def run_config(**values: Any) -> RunConfig:
    """Return a run's configuration from options named as the command line's.

    Args:
        values: Options of `slamcheck run` by name: `filter="compressed"`, `motion="scan"`.

    Returns:
        The configuration, all defaults filled in.

    Raises:
        InputError: There is no such option, or it has no such value.
    """
    return configure(RunConfig, flags=run_options(values))


def run_options(values: Mapping[str, Any]) -> list[tuple[Flag, Any]]:
    """Return options of a run by name, for `configure`. Raises InputError for an unknown name."""
    return by_name(of_job("run"), values)


def by_name(table: Iterable[Flag], values: Mapping[str, Any]) -> list[tuple[Flag, Any]]:
    """Return flags with values by their options' names, as `filter` or `smoother_association`.

    Raises InputError for a name that no flag of the table has.
    """
    known = {flag.name.rstrip("_"): flag for flag in table}
    found = []
    for name, given in values.items():
        flag = known.get(name.replace("-", "_"))
        if flag is None:
            raise InputError(
                f"option {shorten(name)}: is unknown, expected some of {', '.join(known)}"
            )
        found.append((flag, str(given) if isinstance(given, Path) else given))
    return found


def _lay_over(config: dict[str, Any], flags: Sequence[tuple[Flag, Any]]) -> None:
    """Put flags that were given over nested mappings, sections before what lies within them.

    Only flags that are given count, so that a flag can also take a file's value back.
    """
    for flag, value in sorted(flags, key=lambda flag: bool(flag[0].within)):
        flag.lay_over(config, value)


def _check_applies(config: Mapping[str, Any], usual: Mapping[str, Any]) -> None:
    """Raise InputError for a setting that is not the usual one and has no effect beside the rest.

    config, usual: whole configurations of one job as nested mappings, the latter all defaults.
    """
    for flag in FLAGS:
        value = below(config, flag.field)
        if flag.where is None or value == below(usual, flag.field):
            continue
        if below(config, flag.where.field) != flag.where.value:
            raise InputError(f"{flag.option} {shorten(value)} goes with {flag.where.words}")


def _check_sections(job: type[SettingsGroup], given: Mapping[str, Any], source: str) -> None:
    """Raise InputError for a value in a section's place, which nothing can be laid over."""
    kinds = {name: field.annotation for name, field in job.model_fields.items()}
    sections = {
        name: value
        for name, value in given.items()
        if name == "extensions"
        or (isinstance(kind := kinds.get(name), type) and issubclass(kind, SettingsGroup))
    }
    extensions = sections.get("extensions")
    if isinstance(extensions, Mapping):
        sections |= {f"extensions.{name}": value for name, value in extensions.items()}
    for name, value in sections.items():
        if not isinstance(value, Mapping):
            raise InputError(
                f"{source}{shorten(name, 100)} is {quoted(value)}: expected a section of keys"
            )


def _nested(job: type[SettingsGroup], setting: str) -> dict[str, Any]:
    """A setting `section.key=value` as nested mappings."""
    path, equals, text = setting.partition("=")
    parts = path.strip().split(".")
    if not equals or not all(parts):
        raise InputError(f"--set {shorten(setting)}: expected SECTION.KEY=VALUE")
    if parts[0] in EXTENSIONS:
        parts.insert(0, "extensions")
    elif parts[0] not in job.model_fields:
        known = [*(n for n in job.model_fields if n not in ("job", "extensions")), *EXTENSIONS]
        raise InputError(
            f"--set {shorten(path)}: {shorten(parts[0])} is unknown, expected one of "
            f"{', '.join(known)}"
        )
    if len(parts) > _MOST_PARTS:
        raise InputError(f"--set {shorten(path)}: {len(parts)} parts, expected SECTION.KEY=VALUE")
    try:
        value = parse_toml(f"value = {text}")["value"]
    except ValueError:
        value = text.strip()
    for part in reversed(parts):
        value = {part: value}
    return dict(value)


def _other_log(asked: Mapping[str, Any], recorded: Mapping[str, Any]) -> bool:
    """Whether anything but the hash says that another log is asked for."""
    now, then = ({**one, "sha256": None} for one in (asked, recorded))
    return now != then
