"""What may be opened: regular files only, since a pipe or a device may never end."""

from __future__ import annotations

from pathlib import Path

from comparisons.errors import InputError


def check_regular(path: Path) -> None:
    """Raise InputError where there is something that is not a regular file, such as a folder."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is not a regular file")
