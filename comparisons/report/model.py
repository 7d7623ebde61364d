"""What all models of result files have in common."""

from __future__ import annotations

import math
import platform
import re
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from pydantic import BaseModel, ConfigDict

_FORMER = {
    "sighting": "measurement",
    "begun": "initialised",
    "retired": "deactivated",
    "surer": "overconfident",
    "closures": "loop_closures",
}
_PACKAGES = ("slamcheck", "gtsam", "numpy", "scipy", "kiss-icp", "open3d-cpu", "open3d")
"""Those that the results depend on."""
_WORDS = re.compile(rf"(?<![a-z])(?<!loop_)({'|'.join(_FORMER)})")


class Model(BaseModel):
    """Nothing but the fields that are written down."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def current(stored: Any) -> Any:
    """Return what a file holds, its names at any depth in today's words, not those of 0.1."""
    if isinstance(stored, dict):
        return {
            _WORDS.sub(lambda found: _FORMER[found[0]], name): current(value)
            for name, value in stored.items()
        }
    return [current(one) for one in stored] if isinstance(stored, list) else stored


def finite(value: float) -> float | None:
    """JSON has no NaN or infinity: such a figure is absent, never passed on."""
    return value if math.isfinite(value) else None


def package_versions() -> dict[str, str]:
    """Of Python and of what the results depend on."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions
