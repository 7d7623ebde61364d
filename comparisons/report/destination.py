"""Which folder a job's results go to: its name by the settings, and whether it may be written."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from comparisons.atomic import check_apart, check_replaceable, folder_name, free_beside
from comparisons.config import Configured, JobConfig
from comparisons.errors import InputError, quoted
from comparisons.logs.table import read_toml
from comparisons.options.table import FLAGS
from comparisons.report.folder import CONFIG

_BESIDE = ("job", "report", "cloud")
"""Settings that decide what else is written, not the results."""
_LONG = 60
"""Characters of a folder's name after the log's; what is longer ends with a hash."""


def default_folder(
    config: JobConfig, log: str, base: Mapping[str, Any] = MappingProxyType({})
) -> Path:
    """Return the folder of a job that names none: command, log and what is not as usual.

    The settings stand as on the command line, `seed-7`; others by their key. log: its name. base:
    the command's own defaults.
    """
    given = config.model_dump()
    found, changed, words = dict(leaves(given)), _changed(config, base), list[str]()
    for flag in FLAGS:
        value, places = flag.read(given)
        if not changed.isdisjoint(places):
            words.append(_words(flag.option.lstrip("-"), value))
            changed -= {*places, ".".join(flag.field.split(".")[:2])}
    words += [_words(p.rpartition(".")[2], found.get(p, True)) for p in sorted(changed)]
    tail = folder_name("-".join(words)) if words else ""
    if len(tail) > _LONG:
        whole = hashlib.sha256("-".join(words).encode()).hexdigest()
        tail = f"{tail[: _LONG - 9].rstrip('.-')}-{whole[:8]}"
    command = () if config.job == "run" else (config.job,)
    return Path("-".join(("slamcheck", *command, folder_name(log), *filter(None, (tail,)))))


def check_free(folder: Path, config: JobConfig | None = None, *, replace: bool = False) -> None:
    """Raise InputError where a folder may not be written, before the work.

    config: of the job, with its log's hash. A folder that holds what the job reads is refused; one
    that holds the same job with other settings, of another log, or another job, unless replace is
    set.
    """
    check_replaceable(folder, CONFIG)
    if config is None:
        return
    check_apart(folder, config.inputs())
    if replace or not (folder / CONFIG).exists():
        return
    if other := _other_run(folder, config):
        raise InputError(f"{folder}: holds {other}; give --replace, or --out {free_beside(folder)}")


def _other_run(folder: Path, config: JobConfig) -> str:
    """What a folder holds, if it is not of the same job, settings and log; else nothing."""
    try:
        found = read_toml(folder / CONFIG)
        if (job := found.get("job")) != config.job:
            return f"a result of slamcheck {quoted(job)}"
        then = dict(leaves(type(config).of(**found).model_dump()))
    except InputError:
        return "a run of another version of slamcheck"
    now = dict(leaves(config.model_dump()))
    paths = [p for p in {**then, **now} if p.split(".")[0] not in _BESIDE]
    differ = [
        p for p in paths if then.get(p) != now.get(p) and p not in ("log.sha256", "log.format")
    ]
    if then.get("log.sha256") == now.get("log.sha256"):  # wherever it was read from
        differ = [path for path in differ if not path.startswith("log.")]
    elif not any(path.startswith("log.") for path in differ):
        if not differ:
            return "a run of an earlier version of this log"
        differ.insert(0, "log.sha256")
    if not differ:
        return ""
    reported = [_unlike(path, then.get(path), now.get(path)) for path in differ]
    more = f"; and {len(reported) - 3} more" if len(reported) > 3 else ""
    return f"a run with other settings ({'; '.join(reported[:3])}{more})"


def _changed(config: JobConfig, base: Mapping[str, Any]) -> set[str]:
    """Paths of settings that are not as usual, and of extensions that were asked for."""
    named = config.log.model_dump(include={"source", "format", "sha256"})
    usual = type(config).of(**{**base, "preset": config.preset, "log": named})
    before, now = (dict(leaves(job_config.model_dump())) for job_config in (usual, config))
    changed = {path for path, value in now.items() if (path, value) not in before.items()}
    changed |= {"preset"} if config.preset != "recommended" else set()
    if isinstance(config, Configured):
        changed |= {f"extensions.{name}" for name in config.extensions}
        changed -= _as_usual(config, base)
    return {path for path in changed if path.partition(".")[0] not in _BESIDE}


def _as_usual(config: Configured, base: Mapping[str, Any]) -> set[str]:
    """Paths of extensions that nobody asked for, and of settings that are as theirs usually are."""
    log, ekf = config.log.model_dump(), config.ekf.model_dump()
    usual = type(config).of(**{**base, "preset": config.preset, "log": log, "ekf": ekf})
    needed = [extension.needs() for extension in config.extensions.values()]
    found = {
        f"extensions.{name}" for name in {*usual.extensions, *(n for one in needed for n in one)}
    }
    for name, section in config.extensions.items():
        plain = usual.settings_of(name).model_dump()
        for one in needed:
            plain |= one.get(name, {})
        found |= {
            f"extensions.{name}.{key}"
            for key, value in section.model_dump().items()
            if value == plain[key]
        }
    return found


def leaves(values: Mapping[str, Any], below: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted path and the value of every setting in nested mappings."""
    for key, value in values.items():
        path = f"{below}.{key}" if below else str(key)
        if isinstance(value, Mapping) and value:
            yield from leaves(value, path)
        else:
            yield path, value


def _words(name: str, value: Any) -> str:
    """A setting as a part of a folder's name; a switch is its name."""
    name = name.replace("_", "-")
    if isinstance(value, bool) or value == {}:
        return f"no-{name}" if value is False else name
    several = value if isinstance(value, list | tuple) else (value,)
    return "-".join((name, *(_short(one) for one in several)))


def _unlike(path: str, then: Any, now: Any) -> str:
    """Two values of a setting, paths of the same name in full."""
    before, after = (_short(one) for one in (then, now))
    if before == after:
        before, after = str(then), str(now)
    return f"{path} {before} there, {after} here"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if value is None:
        return "unset"
    return Path(value).name if isinstance(value, str) else str(value)
