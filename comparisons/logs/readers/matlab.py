"""Numeric variables of MATLAB files, with errors that name file and variable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.errors import InputError

Array = NDArray[np.float64]


def load_matlab(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    """The named variables as float64, in the shapes that they have in the file.

    Raises InputError for a missing or damaged file, and for a variable that is missing, not
    numeric, or not finite throughout.
    """
    from scipy.io import loadmat

    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        content: dict[str, Any] = loadmat(path, variable_names=names)
    except Exception as error:  # a damaged file fails in as many ways as zlib and scipy know
        cause = " ".join(str(error).split())
        raise InputError(f"{path}: not a MATLAB file of version 5 ({cause})") from None
    result: dict[str, Array] = {}
    for name in names:
        if name not in content:
            raise InputError(f"{path}: no variable {name}, expected {', '.join(names)}")
        value: NDArray[Any] = content[name]
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            raise InputError(f"{path}: {name} is not numeric")
        if not np.isfinite(value).all():
            raise InputError(f"{path}: {name} holds a value that is not a finite number")
        result[name] = value.astype(float)
    return result
