"""A template with what stands around it: where it is sought, and what it may not tell."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_reference.core.geometry import Array
from ekf_reference.scan_landmarks.map_aided_matching import enriched, observe_enriched
from ekf_reference.scan_landmarks.templates import (
    AMBIGUOUS,
    ObservationOptions,
    Template,
    TemplateMatching,
    observe,
)
from ekf_reference.scan_matching.alignment import align
from ekf_reference.scan_matching.alignment_covariance import scan_align
from ekf_reference.scan_matching.sog import SumOfGaussians
from tests.ekf_reference.both_kinds import relative
from tests.ekf_reference.scan_landmarks.test_templates import VIEW as WHOLE
from tests.ekf_reference.scan_landmarks.test_templates import seen
from tests.ekf_reference.scan_matching.scenes import box, solids

ALIKE = solids(
    box(12, -4, 3, 2, 25), box(12, 3, 3, 2, 25),
    disc=np.array(((9.0, -8.0, 0.6), (15.0, -0.5, 1.0))),
)  # fmt: skip
"""Two boxes alike, and what tells them apart."""
HERE, THERE = np.zeros(3), np.array((0.5, 0.3, 0.05))
WIDE = np.diag((2.0, 3.0, 0.1)) ** 2
HOW = TemplateMatching(replace(WHOLE, share=0.5), ObservationOptions(ambiguous=0.7))


def landmark() -> tuple[Template, SumOfGaussians]:
    """The southern box, as seen from HERE, and all that a map would hold around it."""
    scan = seen(ALIKE)
    near = np.flatnonzero(np.abs(scan.mean - (11.5, -4.0)).max(axis=1) < 2.5)
    template = Template.of_segment(scan, near)
    map_of = seen(ALIKE, seed=5)
    return template, replace(map_of, mean=map_of.mean - template.pose[:2])


def guess_and_truth() -> tuple[Array, Array]:
    """Of the template from THERE, the guess nearer to the other box."""
    template, _ = landmark()
    true = relative(THERE, template.pose)
    return true + (0.3, 5.8, 0.02), true


def off(pose: Array) -> float:
    return float(np.hypot(*(pose - guess_and_truth()[1])[:2]))


def test_what_is_around_tells_which_of_two_it_is() -> None:
    template, around = landmark()
    scan, (guess, _) = seen(ALIKE, THERE, 1), guess_and_truth()
    bare = observe(template, scan, guess, WIDE, HOW)
    assert bare.reason == AMBIGUOUS or (bare.alignment is not None and off(bare.alignment.pose) > 5)
    found = observe_enriched(template, around, scan, guess, WIDE, HOW)
    assert found.usable
    assert found.alignment is not None
    assert off(found.alignment.pose) < 0.1


def test_r_is_that_of_the_template_alone() -> None:
    """What the map says is no independent information; with it, R would be much smaller."""
    template, around = landmark()
    scan, (guess, true) = seen(ALIKE, THERE, 1), guess_and_truth()
    found = observe_enriched(template, around, scan, guess, WIDE, HOW).alignment
    assert found is not None
    once = replace(HOW.alignment, spacing_m=100.0)
    alone = scan_align(template.shape, scan, true, WIDE, once)
    assert np.allclose(found.pose, alone.pose, rtol=0.0, atol=1e-4)
    assert np.allclose(found.covariance, alone.covariance, rtol=1e-2)
    broken = scan_align(enriched(template, around), scan, true, WIDE, once)
    assert np.trace(broken.covariance[:2, :2]) < 0.5 * np.trace(alone.covariance[:2, :2])


def test_two_places_that_fit_the_surroundings_are_ambiguous() -> None:
    """The box alone is around: which one it is stays open."""
    template, around = landmark()
    near = around.take(np.abs(around.mean).max(axis=1) < 2.5)
    scan, (guess, _) = seen(ALIKE, THERE, 1), guess_and_truth()
    guess = guess - (0.0, 0.5, 0.0)
    found = observe_enriched(template, near, scan, guess, WIDE, HOW)
    assert found.reason == AMBIGUOUS
    assert not found.usable


def test_the_sum_has_both_in_one_axis() -> None:
    template, around = landmark()
    whole = enriched(template, around)
    assert whole.weight.sum() == pytest.approx(1.0)
    assert len(whole) < len(template.shape) + len(around)
    assert whole.weight[: len(template.shape)].sum() == pytest.approx(0.5)
    for part in (template.shape, around):
        assert whole.tree.query(part.mean)[0].max() < 0.3 * np.sqrt(2.0)
    there = align(whole, seen(ALIKE), template.pose, 1e-4 * np.eye(3)).pose
    assert np.hypot(*(there - template.pose)[:2]) < 0.05
