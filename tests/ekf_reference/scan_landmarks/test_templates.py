"""Segments, templates, and observations of them."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_landmarks.segmentation import (
    Quality,
    SegmentationOptions,
    quality,
    segments,
)
from ekf_reference.scan_landmarks.templates import (
    AMBIGUOUS,
    APART,
    BLANK,
    OUT_OF_VIEW,
    UNDETERMINED,
    SensorView,
    Template,
    TemplateMatching,
    observe,
    share_in_view,
)
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.scan_shape import of_scan
from ekf_reference.scan_matching.sog import SumOfGaussians
from tests.ekf_reference.scan_matching.scenes import (
    BEAMS,
    ELL,
    LASER,
    WALL,
    YARD,
    box,
    outline,
    ranges,
    solids,
)

STILL = np.zeros(3)
NEAR = np.diag((0.3, 0.3, 0.05)) ** 2
VIEW = SensorView(40.0, float(BEAMS[0]), float(BEAMS[-1]))
MATCHING = TemplateMatching(VIEW)
STAR = solids(outline((6, -2), (9, -3), (8, -0.5), (11, 1), (8, 1.5), (8.5, 4), (6.5, 2), (5, 3)))
"""Has all directions fixed by itself."""


def seen(scene: object, pose: Array = STILL, seed: int = 0) -> SumOfGaussians:
    rng = np.random.default_rng(seed)
    return of_scan(BEAMS, ranges(rng, scene, pose, LASER), LASER)  # type: ignore[arg-type]


def template_of(scan: SumOfGaussians) -> Template:
    return Template.of_segment(scan, max(segments(scan), key=len))


def test_segments_are_cut_where_neighbours_are_far() -> None:
    scan = seen(YARD)
    options = SegmentationOptions(range_m=1.0, least_points=5)
    found = segments(scan, options)
    assert len(found) >= 4
    way, bearing = np.hypot(*scan.mean.T), np.arctan2(scan.mean[:, 1], scan.mean[:, 0])
    for run in found:
        assert len(run) >= 5
        assert (np.abs(np.diff(way[run])) < 1.0).all()
        assert (np.diff(bearing[run]) < options.bearing_rad).all()
    assert len(segments(scan, SegmentationOptions(range_m=1.0, least_points=60))) < len(found)


def test_blank_scans_and_single_points_make_no_segments() -> None:
    blank = of_scan(BEAMS, np.full(len(BEAMS), np.nan), LASER)
    assert segments(blank) == []
    way = np.full(len(BEAMS), np.nan)
    way[100] = 5.0
    one = of_scan(BEAMS, way, LASER)
    assert segments(one) == []
    assert len(segments(one, SegmentationOptions(least_points=1))) == 1
    assert not quality(one, LASER, np.random.default_rng(0)).accepted
    with pytest.raises(ValueError, match="template of 1 points"):
        Template.of_segment(one, np.array([0]))


def tried(scene: object) -> Quality:
    scan = seen(scene)
    rows = max(segments(scan), key=len)
    return quality(scan.take(rows), LASER, np.random.default_rng(1))


def test_segments_with_shape_are_accepted_and_walls_are_not() -> None:
    shaped, wall = tried(ELL), tried(WALL)
    assert shaped.accepted
    assert shaped.residual < 0.1
    assert shaped.open_directions == 0
    assert not wall.accepted
    assert wall.residual > 0.1
    assert wall.open_directions == 1
    assert shaped.saliency > 100.0 * wall.saliency


def test_the_axis_is_the_centroid_with_the_vehicles_heading() -> None:
    scan = seen(STAR)
    rows = max(segments(scan), key=len)
    template = Template.of_segment(scan, rows)
    np.testing.assert_allclose(template.pose, [*scan.mean[rows].mean(axis=0), 0.0])
    np.testing.assert_allclose(template.shape.centroid, 0.0, atol=1e-12)
    np.testing.assert_allclose(template.shape.transformed(template.pose).mean, scan.mean[rows])


def test_an_observation_is_the_axis_pose_from_the_new_place() -> None:
    template, moved = template_of(seen(STAR)), np.array((0.6, -0.4, 0.15))
    cos, sin = np.cos(moved[2]), np.sin(moved[2])
    apart = template.pose[:2] - moved[:2]
    true = np.array((cos * apart[0] + sin * apart[1], -sin * apart[0] + cos * apart[1], -moved[2]))
    found = observe(template, seen(STAR, moved, 1), true + (0.2, -0.2, 0.05), NEAR, MATCHING)
    assert found.usable
    assert found.alignment is not None
    error = found.alignment.pose - true
    assert np.abs(error).max() < 0.03
    assert error @ np.linalg.solve(found.alignment.covariance, error) < 20.0


def test_less_than_nine_tenths_in_view_is_no_observation() -> None:
    scan = seen(STAR)
    template = template_of(scan)
    assert share_in_view(template, scan, template.pose, VIEW) == 1.0
    behind, aside = np.array((-8.0, 0.0, 0.0)), np.array((0.0, 30.0, 0.0))
    beyond = np.array((60.0, 0.0, 0.0))
    for pose in (behind, beyond):
        found = observe(template, scan, pose, NEAR, MATCHING)
        assert found.alignment is None
        assert found.reason == OUT_OF_VIEW
    assert 0.0 < share_in_view(template, scan, aside, VIEW) < 1.0


def test_what_something_nearer_hides_is_not_in_view() -> None:
    template = template_of(seen(STAR))
    screen = solids(box(3.0, 0.0, 0.2, 12.0, 0.0))
    found = observe(template, seen(screen), template.pose, NEAR, MATCHING)
    assert found.alignment is None


def test_blank_scans_and_other_shapes_are_refused_with_a_reason() -> None:
    template = template_of(seen(STAR))
    blank = of_scan(BEAMS, np.full(len(BEAMS), np.nan), LASER)
    assert observe(template, blank, template.pose, NEAR, MATCHING).reason == BLANK
    other = solids(box(20.0, 0.0, 1.0, 30.0, 0.0))
    gone = observe(template, seen(other), template.pose, NEAR, MATCHING)
    assert gone.reason == APART
    assert not gone.usable


def test_identical_templates_see_the_same_and_twins_nothing() -> None:
    scan = seen(STAR)
    one, same = template_of(scan), template_of(scan)
    first, second = (
        observe(t, seen(STAR, seed=2), t.pose + (0.1, 0.1, 0.02), NEAR, MATCHING)
        for t in (one, same)
    )
    assert first.alignment is not None
    assert second.alignment is not None
    np.testing.assert_array_equal(first.alignment.pose, second.alignment.pose)
    duplicates = solids(box(8, 1.2, 1.2, 0.8, 20), box(8, -1.2, 1.2, 0.8, 20))
    lone = seen(solids(box(8, 1.2, 1.2, 0.8, 20)))
    template = Template.of_segment(lone, np.arange(len(lone)))
    wide = np.diag((1.5, 1.5, 0.2)) ** 2
    assert observe(template, seen(duplicates), template.pose, wide, MATCHING).reason == AMBIGUOUS


def test_an_alignment_that_fixes_no_direction_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would pass any gate, and a scan that saw a landmark starts no other."""
    scan = seen(STAR)
    template = template_of(scan)
    assert observe(template, scan, template.pose, NEAR, MATCHING).usable
    for free in (2, 3):
        monkeypatch.setattr(
            "ekf_reference.scan_landmarks.templates.scan_align",
            lambda *given, free=free: replace(scan_align(*given), open_directions=free),
        )
        what = observe(template, scan, template.pose, NEAR, MATCHING)
        assert what.reason == (UNDETERMINED if free == 3 else "")
