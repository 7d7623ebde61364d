"""The one door for outputs: files and folders that appear whole or not at all.

A file is written where none is, or over an earlier output of its kind; a folder where none is, or
over an earlier output, of which every file is as it was written: `files.sha256` tells. All is on
the disk before it takes its place. What is not finished lies in a hidden folder beside its place.
Where a process was killed, the next one that writes there removes it: see `_sweep`.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import os
import platform
import re
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from comparisons.errors import InputError, check_regular

_OLD_S = 3600.0
_PREFIX = f".slamcheck-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"
_NAME = re.compile(r"\.slamcheck-[0-9a-f]{8}-[0-9a-f]{16}")
_NEW, _OLD = "new", "old"
LIST = "files.sha256"
"""Of an output folder: its other files with their hashes, as `sha256sum` writes them."""
_LISTED = re.compile(r"([0-9a-f]{64})  (.+)")
_LIST_BYTES = 1 << 24
_SUFFIXES = frozenset(
    {
        *(".csv", ".dot", ".g2o", ".html", ".json", ".npz", ".pcd", ".pdf"),
        *(".pgm", ".pgw", ".ply", ".png", ".toml", ".trace", ".tum", ".yaml"),
    }
)
"""Of what jobs write: whatever a list says, a file of another kind is nobody's output."""
_HEAD_BYTES = 1 << 12


class Kind(NamedTuple):
    """A kind of output file. name: with its article. earlier: whether a file is one."""

    name: str
    earlier: Callable[[Path], bool]


NEW = Kind("new", lambda path: False)
"""What takes no file's place."""
OWN = Kind("ours", lambda path: True)
"""A file of a folder that was checked before."""


def begins(pattern: bytes) -> Callable[[Path], bool]:
    """Return whether a file begins so, as a regular expression, or is empty."""

    def earlier(path: Path) -> bool:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        return not head or re.match(pattern, head) is not None

    return earlier


def write_whole(path: Path, write: Callable[[Path], object], kind: Kind = NEW) -> None:
    """Have a file written beside its place, then move it there: it appears whole or not at all.

    write: given the path to write. Folders above are made. Raises InputError.
    """
    check_file(path, kind)
    with _workplace(path) as place:
        part = place / _NEW / path.name
        write(part)
        _sync(place / _NEW)
        os.replace(part, path)
        _sync_one(place.parent)


@contextmanager
def fresh_folder(target: Path, mark: str | None = None) -> Iterator[Path]:
    """Yield a folder beside `target` to fill; it takes the target's place when all went well.

    See check_replaceable for what it may replace. Where there is a mark, all files are listed with
    their hashes. On any exception the target is as it was and nothing else is left behind.
    """
    full = check_replaceable(target, mark)
    with _workplace(full) as place:
        new, old = place / _NEW, place / _OLD / full.name
        yield new
        if mark is not None:
            _write_list(new)
        _sync(new)
        if full.exists():
            os.replace(full, old)
            _check_earlier(target, old, mark)  # where nobody adds to it any more
        os.replace(new, full)
        _sync_one(place.parent)


def check_file(path: Path, kind: Kind) -> None:
    """Raises InputError where a file must not be written, before the work."""
    try:
        if path.is_dir() or path.name in ("", ".."):
            raise InputError(f"{path}: is a folder, expected a file to write")
        check_regular(path)
        check_above(path)
        if kind is NEW and os.path.lexists(path):
            raise InputError(f"{path}: exists already, expected a new name")
        if path.is_symlink() and not path.exists():
            raise InputError(f"{path}: is a link to nothing, expected a new name")
        if path.exists() and not kind.earlier(path):
            raise InputError(f"{path}: exists and is not {kind.name}, expected a new name")
    except (OSError, ValueError) as error:
        raise _unwritable(path, error) from None


def check_replaceable(target: Path, mark: str | None = None) -> Path:
    """The target's full path, links followed. Raises InputError where it must not be written.

    It may be missing, or a folder without files, or an earlier output that holds the mark, a file
    by which outputs of a kind are told from others.
    """
    try:
        full = Path(os.path.realpath(target))
        current = Path.cwd()
        if full == current or full in current.parents:
            raise InputError(f"{target}: is the current folder or holds it; give another one")
        check_above(full)
        if full.exists() and not full.is_dir():
            raise InputError(f"{target}: is a file, expected a folder to write")
        _check_earlier(target, full, mark)
    except (OSError, ValueError) as error:
        raise _unwritable(target, error) from None
    return full


def check_apart(target: Path, inputs: Iterable[Path]) -> None:
    """Raises InputError where an output folder is or holds an input of the same command."""
    full = Path(os.path.realpath(target))
    for path in inputs:
        path = Path(os.path.realpath(path))
        if path == full or full in path.parents:
            raise InputError(f"{target}: holds {path}, which this command reads; give another one")


def listed_files(folder: Path) -> dict[str, str]:
    """Hashes of what an earlier job left in a folder, by path; empty where there is no list."""
    path = folder / LIST
    try:
        if not path.is_file() or path.stat().st_size > _LIST_BYTES:
            return {}
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return {}
    matches = [_LISTED.fullmatch(line) for line in lines]
    return {match[2]: match[1] for match in matches if match is not None}


def _check_earlier(target: Path, folder: Path, mark: str | None) -> None:
    """Raise InputError where a folder, called target, holds what may not be removed."""
    listed = {} if mark is None else listed_files(folder)
    if listed and mark not in listed:
        raise InputError(f"{target}: holds the output of another command; give another folder")
    for path in _files(folder):
        name = path.relative_to(folder).as_posix()
        if name == LIST and listed:
            continue
        if not _is_as_listed(path, listed.get(name)):
            ours = name in listed and path.suffix in _SUFFIXES
            changed = ", which is not as it was written" if ours else ""
            raise InputError(
                f"{target}: already holds {name}{changed}; give a new folder or empty this one"
            )


def _is_as_listed(path: Path, sha256: str | None) -> bool:
    """Whether a file is a regular one with this hash, of a kind that jobs write."""
    if sha256 is None or path.suffix not in _SUFFIXES or path.is_symlink():
        return False
    return path.is_file() and _hash(path) == sha256


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _files(folder: Path) -> Iterator[Path]:
    """Yield whatever is no folder, in order of names; links are not followed."""
    for place, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted((*files, *(f for f in folders if Path(place, f).is_symlink()))):
            yield Path(place, name)


def _write_list(folder: Path) -> None:
    lines = [f"{_hash(path)}  {path.relative_to(folder).as_posix()}\n" for path in _files(folder)]
    (folder / LIST).write_text("".join(lines), encoding="utf-8")


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


def free_beside(folder: Path) -> Path:
    """Return a folder beside another that is not there yet."""
    number = 2
    while (path := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    return path


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
    _remove(place)


def _remove(folder: Path) -> None:
    """Remove a folder as far as it can be.

    shutil.rmtree turns an exit that comes between its two closings of a folder into an OSError.
    """
    for place, folders, files in os.walk(folder, topdown=False):
        for name in (*files, *folders):
            path = os.path.join(place, name)
            with suppress(OSError):
                if name in files or os.path.islink(path):
                    os.unlink(path)
                else:
                    os.rmdir(path)
    with suppress(OSError):
        os.rmdir(folder)


def _sync(folder: Path) -> None:
    """Have a folder and all in it on the disk, so that a power cut leaves no name without content.

    Raises OSError.
    """
    for place, _, files in os.walk(folder, topdown=False):
        for name in files:
            _sync_one(Path(place, name))
        _sync_one(Path(place))


def _sync_one(path: Path) -> None:
    """Raises OSError, but not where a file system cannot do it for folders."""
    file = os.open(path, os.O_RDONLY)
    try:
        with suppress(*((OSError,) if path.is_dir() else ())):
            os.fsync(file)
    finally:
        os.close(file)


def _unwritable(path: Path, error: Exception) -> InputError:
    if isinstance(error, InputError):
        return error
    reason = error.strerror if isinstance(error, OSError) else None
    return InputError(f"{path}: cannot be written ({reason or error})")
