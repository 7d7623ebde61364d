"""Which returns of a scan become landmarks."""

from dataclasses import replace

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.scan import ScanSensor
from ekf_reference.scan_landmarks.template_extraction import (
    JoinedSegments,
    LandmarkInView,
    SingleSegments,
)
from ekf_reference.scan_landmarks.templates import SensorView, Template
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians

LASER = ScanSensor(0.02, 1e-3, np.deg2rad(0.5), np.deg2rad(8.0))
BEAMS = np.deg2rad(np.arange(-90.0, 90.25, 0.5))
VIEW = SensorView(40.0, float(BEAMS[0]), float(BEAMS[-1]), 0.9)
AHEAD = np.array((1.0, 0.0))


def scan() -> SumOfGaussians:
    """A wall on the left from 2 to 30 m ahead, and an arc of 21 beams on the right 20 m ahead."""
    way = np.full(len(BEAMS), np.nan)
    side = (np.arctan2(4.0, 30.0) < BEAMS) & (np.arctan2(4.0, 2.0) > BEAMS)
    way[side] = 4.0 / np.sin(BEAMS[side])
    way[(BEAMS > -0.6) & (BEAMS < -0.42)] = 20.0
    return of_scan(BEAMS, way, LASER)


def none() -> list[LandmarkInView]:
    return []


def found(
    extraction: JoinedSegments | SingleSegments, known: list[LandmarkInView] | None = None
) -> list[Index]:
    return list(extraction.found(scan(), VIEW, AHEAD, lambda: known or []))


def test_joined_segments_are_one_piece_of_what_stays_in_view() -> None:
    seen = scan()
    (rows,) = found(JoinedSegments(least=40))
    left = seen.mean[rows]
    assert {side > 0.0 for side in left[:, 1].tolist()} == {True, False}  # of both objects
    assert left[:, 0].min() > 10.0  # what is passed within ten metres is left out
    assert len(rows) == np.count_nonzero(seen.mean[:, 0] > 10.0)
    nearer = found(JoinedSegments(least=len(rows) + 1))[0]
    assert seen.mean[nearer][:, 0].min() > 5.0
    assert len(nearer) > len(rows)
    assert not found(JoinedSegments(least=1000))


def test_what_lies_ahead_is_where_the_vehicle_goes() -> None:
    """A scanner that looks to the left passes what is on its right."""
    aside = np.array((0.0, -1.0))
    (rows,) = JoinedSegments().found(scan(), VIEW, aside, none)
    assert len(rows) == len(scan())  # all of it stays in view: the way leads along the scanner


def test_a_new_one_is_due_when_too_few_are_seen() -> None:
    extraction = JoinedSegments(every=5, enough=3)
    assert extraction.due(scans=7, initialised=6, used=0)
    assert not extraction.due(scans=7, initialised=6, used=1)
    assert extraction.due(scans=11, initialised=6, used=2)
    assert not extraction.due(scans=11, initialised=6, used=3)
    single = SingleSegments(every=2)
    assert [single.due(n, 0, 9) for n in (1, 2, 3)] == [True, False, True]


def test_single_segments_are_the_objects_but_those_about_to_be_passed() -> None:
    seen = scan()
    ours = found(SingleSegments())
    assert [bool((seen.mean[rows][:, 1] < 0.0).all()) for rows in ours] == [True]  # the arc
    both = found(SingleSegments(ahead_m=0.0))
    assert [len(rows) for rows in both] == sorted((len(rows) for rows in both), reverse=True)
    assert len(both) == 2
    assert len(found(SingleSegments(ahead_m=0.0, tried=1))) == 1
    assert len(found(SingleSegments(ahead_m=0.0, tried=0))) == 2  # 0: all


def test_a_template_has_the_returns_that_are_asked_for() -> None:
    for extraction in (JoinedSegments(), SingleSegments(ahead_m=0.0)):
        some = max(len(rows) for rows in found(extraction))
        assert [len(rows) for rows in found(extraction.asking_for(some))] == [some]
        assert all(len(rows) > some for rows in found(extraction.asking_for(some + 1)))
        assert extraction.asking_for(some).least_returns == some


def test_a_known_segment_is_no_new_landmark_and_an_unknown_one_is() -> None:
    seen = scan()
    (rows,) = found(SingleSegments())
    template, spread = Template.of_segment(seen, rows), np.diag((0.05, 0.05, 0.01)) ** 2

    def again(by: Array, covariance: Array = spread) -> int:
        return len(
            found(SingleSegments(), [LandmarkInView(template, template.pose + by, covariance)])
        )

    assert again(np.zeros(3)) == 0
    assert again(np.array((0.0, 12.0, 0.0))) == 1
    assert again(np.array((0.0, 12.0, 0.0)), spread + np.diag((40.0, 40.0, 0.0))) == 0
    shifted = replace(template.shape, mean=template.shape.mean + (6.0, 0.0))
    axis = LandmarkInView(Template(shifted, template.pose), template.pose - (6.0, 0.0, 0.0), spread)
    assert not found(SingleSegments(), [axis])  # its points lie there, though not its axis
