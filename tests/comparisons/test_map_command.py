"""slamcheck map and run --dense, as a user meets them."""

import json
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from comparisons.errors import InputError
from comparisons.extensions.dense_maps import extension
from comparisons.extensions.dense_maps.config import DenseMapsConfig
from comparisons.extensions.dense_maps.extension import Demand
from comparisons.extensions.dense_maps.report import MapResult
from comparisons.logs.bundled import open_log
from comparisons.report.map_export import Raster, rasterise, window, write_image, write_ros_map
from ekf_reference.dense.box_tree import BoxTree, boxes
from ekf_reference.dense.layers.layer import Hits
from ekf_reference.dense.layers.points import AllReturns
from ekf_reference.dense.regions_at_map import RegionsAtMap
from tests.commands import files_in, refused, works


@pytest.mark.slow
def test_the_map_leaves_a_whole_folder(tmp_path: Path) -> None:
    arguments = ("--layer", "points", "--layer", "occupancy", "--resolution", "0.4")
    printed = works("map", "occupancy-loop", *arguments, "--out", "map", cwd=tmp_path)
    assert printed.startswith("map: ")
    folder = tmp_path / "map"
    names = files_in(folder)
    each = {f"{n}.{s}" for n in ("points", "occupancy") for s in ("png", "pgw", "pgm", "yaml")}
    assert each | {"map.json", "map.png", "ekf/trajectory.tum"} <= names
    result = MapResult.model_validate_json((folder / "map.json").read_text())
    assert set(result.files) == names
    assert result.resolution_m == 0.4
    assert result.returns.fused + result.returns.late > 10_000
    assert set(result.surface_errors) == {"points", "occupancy", "classic"}
    kept = json.loads((folder / "map.json").read_text())
    assert 0.8 < kept["consistency"]["innovations"][0]["nis"][0]["mean"] / 2.0 < 1.2
    assert kept["consistency"]["smoother"] is None
    assert kept["spurious_heading"]["information"] > 0.0
    assert "no optimum" in result.not_checked["truth_gap"]
    assert "consistency: per dof, expect 1: NEES" in printed
    page = (folder / "report.html").read_text()
    assert "the job solves for no optimum" in page
    assert all(name in page for name in ("EKF - truth", "NIS of measurements", "spurious"))
    other = ("map", "occupancy-loop", "--out", "map")
    said = refused(*other, cwd=tmp_path)
    assert "map: holds a run with other settings (extensions.dense_maps.layers" in said
    works(*other, "--replace", cwd=tmp_path)
    assert not (folder / "points.png").exists()


LITERAL = ("occupancy-loop-enclosed", "--preset", "nieto-2005")


@pytest.mark.slow
def test_as_published_a_map_follows_the_thesis_rule_and_says_so(tmp_path: Path) -> None:
    """Correlation alone, nothing waits, no virtual corner (Nieto 2005, sections 3.5, 3.9)."""
    printed = works("map", *LITERAL, "-v", "--layer", "occupancy", "--out", "map", cwd=tmp_path)
    assert "pairs with correlation >= 0.9" in " ".join(printed.split())
    written = (tmp_path / "map" / "map.json").read_text()
    result = MapResult.model_validate_json(written)
    first = result.first_condition
    assert first.rule == "pairs with correlation >= 0.9 (Nieto 2005, 3.5)"
    assert first.by_correlation == first.regions == result.regions > 5
    assert first.by_relative_sigma == 0
    assert result.returns.late == result.returns.waiting == 0 < result.returns.fused
    settings = json.loads(written)["config"]["extensions"]["dense_maps"]
    assert (settings["known_apart_m"], settings["flip_test"]) == (0.0, "ellipses")
    assert (settings["p_occupied"], settings["p_free"]) == (0.9, 0.3)
    corners = (tmp_path / "map" / "regions.csv").read_text().splitlines()[1:]
    assert not any("+" in row for row in corners)


@pytest.mark.slow
def test_one_setting_off_the_thesis_is_no_longer_its_rule(tmp_path: Path) -> None:
    """What the test above rejects."""
    off = ("--set", "dense_maps.known_apart_m=0.5", "--layer", "occupancy", "--out", "map")
    works("map", *LITERAL, *off, cwd=tmp_path)
    result = MapResult.model_validate_json((tmp_path / "map" / "map.json").read_text())
    assert result.first_condition.rule == (
        "pairs with correlation >= 0.9 or relative sigma <= 0.5 m "
        "(Nieto 2005, 3.5: correlation alone)"
    )
    assert result.first_condition.by_relative_sigma > result.first_condition.by_correlation


@pytest.mark.slow
def test_a_run_takes_the_dense_maps_into_its_verdict(tmp_path: Path) -> None:
    printed = works(
        "run", "occupancy-loop", "-v", "--dense", "points", "--out", "run", cwd=tmp_path
    )
    assert "points: map to returns, median" in printed
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["dense"]["agrees"] is True
    first = result["dense"]["first_condition"]
    assert first["by_correlation"] + first["by_relative_sigma"] == first["regions"] > 20
    assert first["rule"] in unescape((tmp_path / "run" / "report.html").read_text())
    assert (tmp_path / "run" / "dense.png").stat().st_size > 10_000


def two_by_three() -> Raster:
    """South row free, occupied, unknown; north row one half, free, occupied."""
    cells = np.array([(0.1, 0.9, np.nan), (0.5, 0.0, 1.0)])
    return Raster(cells, -3.0, 7.0, 0.5)


def test_an_image_lies_where_its_world_file_says(tmp_path: Path) -> None:
    """The pixel of the occupied cell in the south, by the six numbers of the world file."""
    write_image(two_by_three(), tmp_path / "map.png")
    grey = np.round(255.0 * imread(tmp_path / "map.png")[..., 0])
    assert grey.tolist() == [[127, 254, 0], [229, 25, 205]]
    dx, _, _, dy, west, north = map(float, (tmp_path / "map.pgw").read_text().split())
    row, column = 1, 1
    assert (west + column * dx, north + row * dy) == pytest.approx((-2.25, 7.25))


def test_a_ros_map_has_three_values(tmp_path: Path) -> None:
    write_ros_map(two_by_three(), tmp_path / "map.pgm")
    header, pixels = (tmp_path / "map.pgm").read_bytes().split(b"255\n")
    assert header == b"P5\n3 2\n"
    assert list(pixels) == [205, 254, 0, 254, 0, 205]
    lines = dict(line.split(": ", 1) for line in (tmp_path / "map.yaml").read_text().splitlines())
    assert lines["image"] == "map.pgm"
    assert lines["origin"] == "[-3, 7, 0.0]"
    assert float(lines["resolution"]) == 0.5
    occupied, free = float(lines["occupied_thresh"]), float(lines["free_thresh"])
    shade = (255 - np.frombuffer(pixels, dtype=np.uint8).astype(float)) / 255  # map_server's own
    loaded = np.where(shade > occupied, 100, np.where(shade < free, 0, -1))
    assert loaded.tolist() == [-1, 0, 100, 0, 100, -1]


def one_region() -> RegionsAtMap:
    triangle = np.array([[(0.0, 0.0), (4.0, 0.0), (0.0, 4.0)]])
    return RegionsAtMap(triangle, BoxTree.pack(boxes(triangle), np.zeros(1, dtype=np.intp)))


def test_a_layer_is_read_at_the_centres_of_cells() -> None:
    placed, layer = one_region(), AllReturns(0.3)
    local = np.array([(0.375, 0.125)])
    hits = Hits(
        region=np.zeros(1, dtype=np.intp),
        local=local,
        point=4.0 * local,
        covariance=np.zeros((1, 2, 2)),
    )
    layer.fuse(hits, placed, None, np.zeros(1, dtype=np.intp))
    raster = rasterise(layer, placed, 1.0)
    assert raster.occupancy.shape == (4, 4)
    assert np.argwhere(raster.occupancy == 1.0).tolist() == [[0, 1]]
    part = rasterise(layer, placed, 1.0, (1.0, 0.0, 2.0, 1.0))
    assert part.occupancy.tolist() == [[1.0]]


def test_a_picture_without_end_is_refused() -> None:
    with pytest.raises(InputError, match="coarser"):
        rasterise(AllReturns(), one_region(), 1e-4)


def test_no_regions_no_window() -> None:
    nothing = np.empty((0, 3, 2))
    placed = RegionsAtMap(nothing, BoxTree.pack(boxes(nothing), np.zeros(0, dtype=np.intp)))
    with pytest.raises(InputError, match="no region"):
        window(placed)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dynamic-places", "occupancy-loop"])
def test_a_map_too_large_is_refused_with_a_resolution_that_fits(name: str) -> None:
    """What is suggested fits, and what lies a quarter below does not: no more is asked than it
    takes."""
    log = open_log(name)

    def demand(resolution_m: float) -> Demand:
        given = {"layers": ["occupancy"], "resolution_m": resolution_m, "detect_motion": True}
        return Demand(log, DenseMapsConfig.of(**given), points=True, mapped=True)

    with pytest.raises(InputError, match=r"GiB of memory, the limit is 2 GiB; expected") as caught:
        demand(0.01).check(name)
    fits = float(str(caught.value).partition("expected --resolution ")[2].split()[0])
    demand(fits).check(name)
    with pytest.raises(InputError):
        demand(0.75 * fits).check(name)


def test_the_command_refuses_it_before_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extension, "MOST_BYTES", 1e8)
    said = refused("map", "occupancy-loop", "--resolution", "0.8", cwd=tmp_path)
    assert said.endswith("the limit is 0.0931323 GiB; expected a shorter log")
    assert not list(tmp_path.iterdir())
