"""How much of what was scanned a map holds, and what is said where that is next to nothing."""

import pytest

from comparisons.config import MapConfig
from comparisons.extensions.dense_maps.job import map_log
from comparisons.extensions.dense_maps.report import LEAST_COVERED, MapReport
from comparisons.logs.bundled import open_log

LAYERS = {"dense_maps": {"layers": ["occupancy"]}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "outcome", "said"),
    [
        ("occupancy-loop-enclosed", "agree", ""),
        ("scan-loop-enclosed", "unverified", "lie outside all regions"),
        ("scan-loop", "unverified", "lie outside all regions"),
        ("dynamic-places", "unverified", "the map is empty"),
        ("dynamic-places-enclosed", "unverified", "waited for a region that never came about"),
    ],
)
def test_a_map_of_next_to_nothing_is_no_success(name: str, outcome: str, said: str) -> None:
    """By the thesis' settings: its regions are triangles of landmarks that enclose objects."""
    config = MapConfig.of(preset="nieto-2005", log={"source": name}, extensions=LAYERS)
    report = MapReport.of(map_log(open_log(name), config))
    returns = report.result.returns
    assert sum(returns.parts().values()) == returns.returns
    assert report.outcome == outcome
    assert (returns.covered >= LEAST_COVERED) == (outcome == "agree")
    assert bool(report.result.lacks) == bool(said)
    assert said in report.result.lacks
    assert list(report.summary().reasons) == [report.result.lacks] * bool(said)


@pytest.mark.slow
def test_landmarks_among_the_objects_are_what_is_different() -> None:
    """The same drive: the world, and more landmarks in it."""
    plain, enclosed = open_log("scan-loop"), open_log("scan-loop-enclosed")
    assert (plain.odometry.time_s == enclosed.odometry.time_s).all()
    assert plain.truth.landmarks is not None
    assert enclosed.truth.landmarks is not None
    assert len(enclosed.truth.landmarks.id) > 2 * len(plain.truth.landmarks.id)
    assert "landmarks among the objects" in enclosed.provenance["source"]
