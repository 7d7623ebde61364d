"""Files and folders that appear whole or not at all.

What is not finished lies in a hidden folder beside its place. Where a process was killed, the next
one that writes there removes it: see `_sweep`.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import json
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from comparisons.errors import InputError, check_regular

_OLD_S = 3600.0
_PREFIX = f".slamcheck-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"
_NAME = re.compile(r"\.slamcheck-[0-9a-f]{8}-[0-9a-f]{16}")
_RESULTS = ("result", "solution", "check", "odometry", "map", "audit")
_NEW, _OLD = "new", "old"


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Have a file written beside its place, then move it there: it appears whole or not at all.

    write: given the path to write. Folders above are made. Raises InputError.
    """
    check_file(path)
    with _workplace(path) as place:
        part = place / _NEW / path.name
        write(part)
        os.replace(part, path)


@contextmanager
def fresh_folder(target: Path, replaceable: frozenset[str] = frozenset()) -> Iterator[Path]:
    """Yield a folder beside `target` to fill; it takes the target's place when all went well.

    replaceable: files that an earlier output of ours holds, as paths within it; see
    check_replaceable. On any exception the target is as it was and nothing else is left behind.
    """
    target = check_replaceable(target, replaceable)
    with _workplace(target) as place:
        yield place / _NEW
        if target.exists():
            os.replace(target, place / _OLD / target.name)
        os.replace(place / _NEW, target)


def check_file(path: Path) -> None:
    """Raises InputError where a file must not be written, before the work."""
    try:
        if path.is_dir() or path.name in ("", ".."):
            raise InputError(f"{path}: is a folder, expected a file to write")
        check_regular(path)
        check_above(path)
    except (OSError, ValueError) as error:
        raise _unwritable(path, error) from None


def check_replaceable(target: Path, replaceable: frozenset[str] = frozenset()) -> Path:
    """The target's full path, links followed. Raises InputError where it must not be written.

    It may be missing, or a folder that holds no other files, at any depth, than `replaceable`.
    """
    try:
        full = Path(os.path.realpath(target))
        current = Path.cwd()
        if full == current or full in current.parents:
            raise InputError(f"{target}: is the current folder or holds it; give another one")
        check_above(full)
        if full.exists() and not full.is_dir():
            raise InputError(f"{target}: is a file, expected a folder to write")
        files = {p.relative_to(full).as_posix() for p in full.rglob("*") if not _is_folder(p)}
        strange = sorted(files - replaceable)
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from None
    if strange:
        raise InputError(
            f"{target}: already holds {strange[0]}; give a new folder or empty this one"
        )
    return full


def known_files(folder: Path) -> frozenset[str]:
    """What an earlier job left in a folder, by its own account; empty where there is none."""
    for name in _RESULTS:
        try:
            found = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
            return frozenset(str(file) for file in found["files"])
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            continue
    return frozenset()


def check_above(path: Path) -> None:
    """Raises InputError where nothing can be written at a path, as far as can be known before."""
    try:
        with suppress(FileNotFoundError, NotADirectoryError):
            os.lstat(path)  # refuses names that are none, or too long
        above = next(p for p in path.absolute().parents if os.path.lexists(p))
        if not (above.is_dir() and os.access(above, os.W_OK | os.X_OK)):
            raise InputError(f"{path}: cannot be written into {above}")
    except (OSError, ValueError) as error:
        raise _unwritable(path, error) from None


def folder_name(name: str) -> str:
    """A log's name as a folder's: letters, digits, dots and dashes only, not too long."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in name)
    return kept.strip(".-")[:80] or "log"


def is_unfinished(name: str) -> bool:
    """Whether a file or folder of this name is a process's that writes, or was killed."""
    return _NAME.fullmatch(name) is not None


@contextmanager
def _workplace(target: Path) -> Iterator[Path]:
    """Yield a hidden folder beside a target, locked, with two empty folders: new and old.

    Folders above are made. What was moved to `old` goes back on an exception. Raises InputError.
    """
    above = target.absolute().parent
    made = [p for p in (above, *above.parents) if not p.exists()]
    place = above / f"{_PREFIX}{secrets.token_hex(8)}"  # known before it is made: a signal may come
    try:
        above.mkdir(parents=True, exist_ok=True)
        _sweep(above)
        place.mkdir(0o700)
        with _locked(place):
            for name in (_NEW, _OLD):
                (place / name).mkdir()
            yield place
            _discard(place)
    except BaseException as error:
        _discard(place)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise _unwritable(target, error) from None
        raise


@functools.cache
def _sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder more than an hour ago; once per process.

    A process holds a lock on what it writes, which ends with it, whichever way, so that nobody
    else's number is taken for its own. On a shared file system another machine may not see that
    lock: only what was made on this one is judged, its name says so. The hour is for the moment
    between the folder and its lock.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(_PREFIX) and _is_left(entry):
                place = Path(entry.path)
                with suppress(OSError), _locked(place, needed=True):
                    _discard(place)


def _is_left(entry: os.DirEntry[str]) -> bool:
    """Whether it is old, and a folder of this user, nobody else's to write, with what is ours."""
    with suppress(OSError):
        about = entry.stat(follow_symlinks=False)
        return (
            is_unfinished(entry.name)
            and entry.is_dir(follow_symlinks=False)
            and about.st_uid == os.getuid()
            and about.st_mode & 0o077 == 0
            and time.time() - about.st_mtime > _OLD_S
            and set(os.listdir(entry.path)) <= {_NEW, _OLD}
        )
    return False


@contextmanager
def _locked(folder: Path, *, needed: bool = False) -> Iterator[None]:
    """Hold the lock of a folder. Raises OSError where it is needed and cannot be had."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        with suppress(*(() if needed else (OSError,))):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(file)


def _discard(place: Path) -> None:
    """Remove a workplace; what it took the place of goes back where that is free."""
    with suppress(OSError):
        for kept in (place / _OLD).glob("*"):
            if not os.path.lexists(place.parent / kept.name):
                os.replace(kept, place.parent / kept.name)
        shutil.rmtree(place, ignore_errors=True)


def _unwritable(path: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
    reason = error.strerror if isinstance(error, OSError) else None
    return InputError(f"{path}: cannot be written ({reason or error})")


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()
