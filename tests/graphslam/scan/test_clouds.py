from pathlib import Path

import numpy as np
import pytest

from graphslam.scan.clouds import CloudError, write_cloud
from graphslam.scan.libraries import open3d
from tests.graphslam.numerics import Array

pytestmark = pytest.mark.usefixtures("open3d_library")


def read_cloud(path: Path) -> Array:
    return np.array(open3d().io.read_point_cloud(str(path)).points)


@pytest.fixture
def points() -> Array:
    return np.random.default_rng(0).normal(scale=30.0, size=(1000, 3))


@pytest.mark.parametrize(("suffix", "stored"), [(".ply", np.float64), (".pcd", np.float32)])
def test_a_cloud_comes_back_as_it_is_stored(
    tmp_path: Path, points: Array, suffix: str, stored: type
) -> None:
    write_cloud(tmp_path / f"a{suffix}", points)
    np.testing.assert_array_equal(read_cloud(tmp_path / f"a{suffix}"), points.astype(stored))


@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_a_new_cloud_takes_the_old_ones_place(tmp_path: Path, points: Array, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_cloud(path, points)
    write_cloud(path, points[:7])
    assert len(read_cloud(path)) == 7
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("bad", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)])
def test_a_cloud_that_cannot_be_written_leaves_the_old_one(
    tmp_path: Path, points: Array, bad: Array
) -> None:
    path = tmp_path / "a.ply"
    write_cloud(path, points)
    with pytest.raises(CloudError, match="points"):
        write_cloud(path, bad)
    assert len(read_cloud(path)) == len(points)


def test_paths_that_cannot_be_written(tmp_path: Path, points: Array) -> None:
    (tmp_path / "folder.ply").mkdir()
    for name, message in (
        ("a.xyz", "ending in"),
        ("none/a.ply", "No such file"),
        ("folder.ply", "folder"),
    ):
        with pytest.raises(CloudError, match=message) as raised:
            write_cloud(tmp_path / name, points)
        assert "\n" not in str(raised.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.ply"]
    with pytest.raises(CloudError, match="single precision"):
        write_cloud(tmp_path / "far.pcd", 1e300 * points)
