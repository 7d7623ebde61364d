"""Arrays in `.npz` files, never unpickled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError
from comparisons.files import check_regular

_MOST_BYTES = 2**32


def read_archive(path: Path, names: tuple[str, ...]) -> list[NDArray[np.float64]]:
    """The named arrays as float64. Raises InputError for anything but an archive of numbers."""
    found = read_arrays(path, names)
    if len(found) < len(names):
        raise InputError(f"{path}: not an archive of {', '.join(names)}")
    return [found[name] for name in names]


def read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    """Those of the named arrays that an archive holds. Raises InputError like read_archive."""
    check_regular(path)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            sizes = {info.filename: info.file_size for info in archive.zip.infolist()}
            size = sum(sizes.get(f"{name}.npy", 0) for name in names)
            if size <= _MOST_BYTES:
                arrays = {name: archive[name] for name in names if name in archive}
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except Exception:  # a damaged archive fails in as many ways as zip, zlib and numpy know
        raise InputError(f"{path}: not an archive of {', '.join(names)}") from None
    if size > _MOST_BYTES:
        raise InputError(f"{path}: holds {size} bytes unpacked, expected {_MOST_BYTES} at most")
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or not array.ndim:
            raise InputError(f"{path}: {name} is not an array of numbers")
    return {name: array.astype(np.float64) for name, array in arrays.items()}
