"""Loading Open3D and KISS-ICP, and what is taken from Open3D."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from graphslam.scan.libraries import (
    PACKAGES,
    MissingLibraryError,
    _load_kiss_icp,
    _load_open3d,
    kiss_icp,
    open3d,
    remedy,
    require,
)
from tests.graphslam.scan.shapes import box, seen_from

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize(("library", "package"), PACKAGES.items())
def test_a_missing_library_is_named_with_its_package(library: str, package: str) -> None:
    error = ImportError(
        f"{library}.so.1: cannot open shared object file: No such file or directory"
    )
    message = remedy("open3d", error)
    assert message.startswith(f"it lacks {library}: apt-get install {package},")
    assert "\n" not in message


def test_other_failures_are_one_line() -> None:
    assert "pip install" in remedy("open3d", ModuleNotFoundError("No module", name="open3d"))
    dash = ModuleNotFoundError("No module named 'dash'", name="dash")
    assert remedy("open3d", dash) == "it cannot be loaded (No module named 'dash')"
    assert remedy("open3d", ImportError("bad\nsymbol")) == "it cannot be loaded (bad symbol)"
    strange = remedy("open3d", OSError("libodd.so.3: cannot open shared object file: No such file"))
    assert strange == "it lacks libodd, a library of the system"


@pytest.mark.parametrize(
    ("module", "name", "load"),
    [("open3d", "Open3D", open3d), ("kiss_icp.mapping", "KISS-ICP", kiss_icp)],
)
def test_what_needs_a_library_that_is_not_there_says_so(
    module: str, name: str, load: Callable[[], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, module.split(".")[0], None)
    _load_open3d.cache_clear()
    _load_kiss_icp.cache_clear()
    try:
        with pytest.raises(MissingLibraryError, match=f"needs {name}: pip install"):
            load()
        line = rf"^--this needs {name}: pip install 'slamcheck\[scans\]'$"
        with pytest.raises(MissingLibraryError, match=line):
            require({module.split(".")[0]: "--this"})
    finally:
        _load_open3d.cache_clear()
        _load_kiss_icp.cache_clear()


def test_nothing_loads_them_before_they_are_used() -> None:
    code = (
        "import sys, graphslam.scan.matchers as m, graphslam.scan.open3d_matchers, "
        "graphslam.scan.clouds, graphslam.scan.odometry; m.MATCHERS['surface'](); "
        "assert not {'open3d', 'kiss_icp'} & set(sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_it_keeps_to_one_thread_and_says_nothing(open3d_library: ModuleType) -> None:
    utility = open3d_library.utility
    assert utility.get_verbosity_level() == utility.VerbosityLevel.Error
    if hasattr(utility, "get_max_threads"):
        assert utility.get_max_threads() == 1


def test_normals_of_a_planar_cloud_lie_in_the_plane(open3d_library: ModuleType) -> None:
    from graphslam.scan.open3d_matchers import as_open3d, surface_normals

    rng = np.random.default_rng(0)
    along = np.linspace(-5.0, 5.0, 80)
    wall = np.column_stack((along, np.full(80, 2.0), np.zeros(80)))
    turned = seen_from(np.array((0.0, 0.0, -0.3)), wall)
    normal, flat = surface_normals(turned)
    assert flat.all()
    expected = np.array((-np.sin(0.3), np.cos(0.3), 0.0))
    np.testing.assert_allclose(np.abs(normal @ expected), 1.0, atol=1e-9)
    noisy = turned + 0.02 * rng.standard_normal((80, 1)) * expected
    own = as_open3d(noisy)
    own.estimate_normals(open3d_library.geometry.KDTreeSearchParamHybrid(0.5, 10))
    assert np.abs(np.asarray(own.normals) @ expected).max() < 0.1, "Open3D's are no use here"
    assert np.abs(surface_normals(noisy)[0] @ expected).min() > 0.9


def test_a_box_is_found_within_a_box(open3d_library: ModuleType) -> None:
    """A planar scan may be laid into a cloud in space."""
    from graphslam.scan.open3d_matchers import PointToPointMatcher

    rng = np.random.default_rng(0)
    side = box(0.0, 0.0, 8.0, 5.0)
    part = rng.random((4, 200, 1))
    level = (side[:, None, :2] + part * (side[:, None, 2:] - side[:, None, :2])).reshape(-1, 2)
    source = np.column_stack((level, np.zeros(len(level))))
    space = np.vstack([source + (0.0, 0.0, height) for height in (-0.2, -0.1, 0.0, 0.1, 0.2)])
    true = np.array((0.2, 0.1, 0.05))
    found = PointToPointMatcher().match(seen_from(true, source), space, np.zeros(3))
    np.testing.assert_allclose(found.motion, true, atol=1e-6)
