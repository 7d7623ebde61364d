"""Open3D, loaded where it is first used: it takes half a second and needs system libraries."""

from __future__ import annotations

import ctypes
import re
from functools import cache
from types import ModuleType

PACKAGES = {
    "libGL": "libgl1",
    "libEGL": "libegl1",
    "libX11": "libx11-6",
    "libgomp": "libgomp1",
    "libusb-1.0": "libusb-1.0-0",
    "libudev": "libudev1",
    "libidn2": "libidn2-0",
    "libstdc++": "libstdc++6",
}
"""The Debian package of every system library that Open3D's wheels link to."""


class Open3dMissingError(RuntimeError):
    """Open3D cannot be loaded. The message, one line, says what to install."""


@cache
def open3d() -> ModuleType:
    """The module: its first use loads it, silences it and keeps it to one thread.

    More threads add up in the order in which they finish, so results would differ from run to
    run. Versions before 0.20 cannot be told and obey OMP_NUM_THREADS only. Raises
    Open3dMissingError.
    """
    _load_libusb()
    try:
        import open3d as module
    except (ImportError, OSError) as error:
        raise Open3dMissingError(explained(error)) from None
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    limit = getattr(module.utility, "set_max_threads", None)
    if limit is not None:
        limit(1)
    found: ModuleType = module
    return found


def explained(error: ImportError | OSError) -> str:
    """One line on why the import failed, with the packages that would help.

    The loader stops at the first library that is missing, and a bare image lacks several: all
    packages are named, so that one installation is enough.
    """
    if isinstance(error, ModuleNotFoundError) and error.name in {"open3d", None}:
        return "Open3D is not installed: pip install open3d-cpu (open3d where that does not exist)"
    reason = " ".join(str(error).split())
    missing = re.match(r"(lib[^:\s/]+?)\.(?:so|dylib)[\d.]*: cannot open shared object", reason)
    if missing is None:
        return f"Open3D cannot be loaded: {reason}"
    package = PACKAGES.get(missing[1])
    if package is None:
        return f"Open3D cannot be loaded: it lacks {missing[1]}, a library of the system"
    others = [other for other in ("libgl1", "libegl1", "libx11-6", "libgomp1") if other != package]
    return (
        f"Open3D lacks {missing[1]}: apt-get install {package}, "
        f"and where the system is bare {' '.join(others)} as well"
    )


def _load_libusb() -> None:
    """Load the packaged libusb: the import then finds it where the system has none."""
    try:
        import libusb_package

        path = libusb_package.get_library_path()
        if path is not None:
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        return  # The system may have its own; if not, the import of Open3D says so.
