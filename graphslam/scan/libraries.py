"""KISS-ICP and Open3D, loaded where they are first used: slamcheck's extra `scans` installs them.

Open3D takes half a second to load and needs libraries of the system.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping
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
NAMES = {"kiss_icp": "KISS-ICP", "open3d": "Open3D"}


class MissingLibraryError(RuntimeError):
    """A library of NAMES cannot be loaded. The message, one line, says what to install."""


def require(wanted: Mapping[str, str]) -> None:
    """Load libraries before the work begins. wanted: modules of NAMES, and what asks for each.

    Raises MissingLibraryError.
    """
    for library, by in wanted.items():
        _loaded(library, by)


def kiss_icp() -> ModuleType:
    """KISS-ICP with the modules that are used of it. Raises MissingLibraryError."""
    return _loaded("kiss_icp", "the alignment of scans")


def open3d() -> ModuleType:
    """Open3D, which says nothing and keeps to one thread. Raises MissingLibraryError.

    More threads add up in the order in which they finish, so results would differ from run to
    run. Versions before 0.20 have no such setting and obey OMP_NUM_THREADS only.
    """
    return _loaded("open3d", "this matcher or file of points")


def _loaded(library: str, by: str) -> ModuleType:
    try:
        return _load_kiss_icp() if library == "kiss_icp" else _load_open3d()
    except (ImportError, OSError) as error:
        raise MissingLibraryError(
            f"{by} needs {NAMES[library]}: {remedy(library, error)}"
        ) from None


@cache
def _load_kiss_icp() -> ModuleType:
    import kiss_icp.mapping
    import kiss_icp.registration
    import kiss_icp.voxelization

    found: ModuleType = kiss_icp
    return found


@cache
def _load_open3d() -> ModuleType:
    _load_libusb()
    import open3d as module

    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    limit = getattr(module.utility, "set_max_threads", None)
    if limit is not None:
        limit(1)
    return module


def remedy(library: str, error: ImportError | OSError) -> str:
    """One line on what mends a failed import.

    The loader stops at the first library of the system that is missing, and a bare image lacks
    several: all packages are named, so that one installation is enough.
    """
    if isinstance(error, ModuleNotFoundError) and str(error.name).split(".")[0] == library:
        return "pip install 'slamcheck[scans]'"
    reason = " ".join(str(error).split())
    missing = re.match(r"(lib[^:\s/]+?)\.(?:so|dylib)[\d.]*: cannot open shared object", reason)
    if missing is None:
        return f"it cannot be loaded ({reason})"
    package = PACKAGES.get(missing[1])
    if package is None:
        return f"it lacks {missing[1]}, a library of the system"
    others = [other for other in ("libgl1", "libegl1", "libx11-6", "libgomp1") if other != package]
    return (
        f"it lacks {missing[1]}: apt-get install {package}, "
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
