"""Regions that come up as the filter drives a loop (Nieto 2005, section 2.9's environment)."""

from functools import cache

import numpy as np

from ekf_reference.core.geometry import Array
from ekf_reference.dense.conditions import Conditions, overlap
from ekf_reference.dense.regions import LocalRegions
from tests.ekf_reference.dense.scenes import flipped
from tests.ekf_reference.worlds import circuit, follow


@cache
def driven(conditions: Conditions) -> tuple[LocalRegions, list[int], Array]:
    """Regions, their number after every scan, and the filter's last landmarks (L, 2)."""
    regions, count = LocalRegions(conditions=conditions), []
    for _, ekf in follow(circuit(0, range_m=25.0)):
        near = ekf.state.local_map(30.0)
        regions.extend(ekf.state.landmarks, near.landmark_index, near.covariance[3:, 3:])
        count.append(len(regions.base))
    return regions, count, ekf.state.landmarks.copy()


def test_regions_survive_the_closing_of_the_loop() -> None:
    regions, count, landmark = driven(Conditions())
    assert len(regions.base) > 30
    assert not len(flipped(regions, landmark))
    triangle = landmark[regions.base]
    assert not np.triu(overlap(triangle[:, None], triangle), 1).any()
    assert (np.diff(count) >= 0).all()


def test_near_a_known_start_correlation_is_low_and_regions_would_not_deform() -> None:
    """Taken literally, the first condition leaves the beginning of a drive without regions."""
    _, literal, _ = driven(Conditions())
    _, known, _ = driven(Conditions(known_apart_m=0.3))
    eleven_seconds = 55
    assert literal[eleven_seconds] == 0
    assert known[eleven_seconds] > 5
    assert known[-1] > literal[-1]
