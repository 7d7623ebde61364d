"""What decides how numbers are rounded: the BLAS' kernels, numpy's features, versions."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

import numpy as np
import scipy.linalg  # noqa: F401  # its BLAS, too, must be there to be looked at
from threadpoolctl import threadpool_info


def processor() -> dict[str, Any]:
    """The kernels and threads of each BLAS, numpy's features in use, and versions."""
    return {
        "machine": platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "blas": sorted(
            f"{library['internal_api']} {library['version']} {library.get('architecture')}, "
            f"threads: {library['num_threads']}"
            for library in threadpool_info()
            if library["user_api"] == "blas"
        ),
        "numpy_features": np.show_config(mode="dicts")["SIMD Extensions"]["found"],
        **{name: version(name) for name in ("numpy", "scipy", "gtsam", "kiss-icp")},
    }
