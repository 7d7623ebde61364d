"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from comparisons.errors import InputError


@contextmanager
def fresh_folder(target: Path, mark: str) -> Iterator[Path]:
    """Yield a folder beside `target` to fill; it takes the target's place when all went well.

    An existing target is replaced only when it is empty or holds the file `mark`, which says
    that it is an earlier output of ours. On any exception nothing is left behind.
    """
    check_replaceable(target, mark)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror})") from None
    try:
        work.chmod(0o777 & ~_umask())
        yield work
        if target.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{target.name}-old-", dir=target.parent))
            os.replace(target, old / "old")
            os.replace(work, target)
            shutil.rmtree(old)
        else:
            os.replace(work, target)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def check_replaceable(target: Path, mark: str) -> None:
    """Raise InputError when writing `target` would destroy something that is not ours."""
    if target.is_dir():
        if any(target.iterdir()) and not (target / mark).exists():
            raise InputError(
                f"{target}: is not empty and holds no {mark}; give a new folder or empty this one"
            )
    elif target.exists():
        raise InputError(f"{target}: is a file, expected a folder to write")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
