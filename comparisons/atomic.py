"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from comparisons.errors import InputError

UNFINISHED = ".part-"
"""Begins the name of a file that is being written."""


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Have a file written beside its place, then move it there: it appears whole or not at all.

    write: given the path to write. Folders above are made. Raises InputError.
    """
    part = path.with_name(UNFINISHED + path.name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        os.replace(part, path)
    except BaseException as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None
        raise


@contextmanager
def fresh_folder(target: Path, replaceable: frozenset[str] = frozenset()) -> Iterator[Path]:
    """Yield a folder beside `target` to fill; it takes the target's place when all went well.

    replaceable: files that an earlier output of ours holds, as paths within it; see
    check_replaceable. On any exception the target is as it was and nothing else is left behind.
    """
    target = check_replaceable(target, replaceable)
    made = [p for p in (target.parent, *target.parent.parents) if not p.exists()]
    work = old = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}-", dir=target.parent))
        work.chmod(0o777 & ~_umask())
        yield work
        if target.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}-old-", dir=target.parent))
            os.replace(target, old / "old")
        os.replace(work, target)
    except BaseException as error:
        if old is not None and (old / "old").exists() and not target.exists():
            os.replace(old / "old", target)
        if work is not None:
            shutil.rmtree(work, ignore_errors=True)
        for folder in made:
            _remove_if_empty(folder)
        if isinstance(error, OSError):
            raise InputError(f"{target}: cannot be written ({error.strerror or error})") from None
        raise
    finally:
        if old is not None and target.exists():
            shutil.rmtree(old, ignore_errors=True)


def check_replaceable(target: Path, replaceable: frozenset[str] = frozenset()) -> Path:
    """The target's full path, links followed. Raises InputError where it must not be written.

    It may be missing, or a folder that holds no other files, at any depth, than `replaceable`.
    """
    try:
        full = Path(os.path.realpath(target))
        current = Path.cwd()
        if full == current or full in current.parents:
            raise InputError(f"{target}: is the current folder or holds it; give another one")
        if not full.exists():
            return full
        if not full.is_dir():
            raise InputError(f"{target}: is a file, expected a folder to write")
        files = {p.relative_to(full).as_posix() for p in full.rglob("*") if not _is_folder(p)}
        strange = sorted(files - replaceable)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{target}: cannot be written ({error})") from None
    if strange:
        raise InputError(
            f"{target}: already holds {strange[0]}; give a new folder or empty this one"
        )
    return full


def folder_name(name: str) -> str:
    """A log's name as a folder's: letters, digits, dots and dashes only, not too long."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in name)
    return kept.strip(".-")[:80] or "log"


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _remove_if_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:
        return


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
