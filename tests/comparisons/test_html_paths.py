"""East, north and heading of the paths against time, with 3 sigma where there are covariances."""

import numpy as np

from comparisons.logs.log import Poses, Truth
from comparisons.report.html.map import MapContent, Track
from comparisons.report.html.paths import path_panels
from tests.helpers import altered, simulated

TIME_S = np.linspace(0.0, 9.0, 10)


def track(name: str, turn: float = 0.0, sigma: float | None = None) -> Track:
    """A path that turns for several rounds, its headings wrapped. turn: added to them."""
    heading = np.linspace(0.0, 15.0, len(TIME_S)) + turn
    pose = np.column_stack((TIME_S, -TIME_S, np.angle(np.exp(1j * heading))))
    covariance = None
    if sigma is not None:
        covariance = np.tile(sigma**2 * np.eye(3), (len(TIME_S), 1, 1))
    return Track(
        name=name, colour="#000", time_s=TIME_S.copy(), pose=pose, pose_covariance=covariance
    )


def content(*tracks: Track) -> MapContent:
    return MapContent(log=None, tracks=tracks, view=())


def test_both_paths_and_their_bands() -> None:
    east, north, heading = path_panels(content(track("a", sigma=0.5), track("b")))
    assert [panel.title for panel in (east, north, heading)] == [
        "x, east [m]", "y, north [m]", "heading [deg]",
    ]  # fmt: skip
    assert [curve.name for curve in east.curves] == ["a", "b"]
    assert np.allclose(north.curves[1].y, -TIME_S)
    (band,) = east.bands
    assert (band.name, band.about) == ("a, 3 sigma", "a")
    assert np.allclose(band.high - east.curves[0].y, 1.5)
    assert np.allclose(heading.bands[0].high - heading.curves[0].y, np.degrees(1.5))
    assert east.lacking == ["no 3 sigma of b: no covariances of poses"]
    assert east.curves[0].x is east.curves[1].x  # equal times are on the page once


def test_headings_go_on_and_count_the_same_turns() -> None:
    heading = path_panels(content(track("a"), track("b", turn=0.1 - 4.0 * np.pi)))[2]
    assert np.allclose(heading.curves[0].y, np.degrees(np.linspace(0.0, 15.0, 10)))
    assert np.allclose(heading.curves[1].y - heading.curves[0].y, np.degrees(0.1))


def test_a_negative_variance_leaves_a_gap() -> None:
    broken = track("a", sigma=1.0)
    broken.pose_covariance[3, 0, 0] = -1.0  # type: ignore[index]
    east = path_panels(content(broken))[0]
    assert east.lacking == ["no a, 3 sigma at 1 of 10 instants: a variance is negative"]
    assert np.isnan(east.bands[0].high).tolist() == [k == 3 for k in range(10)]


def test_truth_is_there_while_it_is_known() -> None:
    pose = track("truth").pose
    truth = Truth(poses=Poses(TIME_S[2:8], pose[2:8]))
    log = altered(simulated(loop_s=2.0), "truth", truth)
    east, _, heading = path_panels(MapContent(log=log, tracks=[track("a", sigma=0.1)], view=()))
    assert [curve.name for curve in east.curves] == ["truth", "a"]
    known = np.isfinite(east.curves[0].y)
    assert known.tolist() == [2 <= k <= 7 for k in range(10)]
    assert np.allclose(heading.curves[0].y[known], heading.curves[1].y[known])
    assert east.lacking == []


def test_of_what_is_no_path_there_is_no_panel() -> None:
    aside = Track(name="a", colour="#000", time_s=TIME_S, pose=track("a").pose, against_time=False)
    flat = Track(name="a", colour="#000", time_s=TIME_S, pose=track("a").pose[:, :2])
    assert path_panels(content(aside, flat)) == path_panels(content()) == ()
