"""A sensor's noise is named where the residuals tell it surely, and it leaves nothing else over."""

from types import SimpleNamespace
from typing import Any

import pytest

from comparisons.checks.diagnosis import other_noise
from comparisons.checks.diagnosis.other_noise import other_noises
from graphslam.variance_components import Component


def named(monkeypatch: pytest.MonkeyPatch, component: Component, *, sound: bool = True) -> bool:
    """Whether it is, of a problem that is sound, or not, with that noise."""
    monkeypatch.setattr(other_noise, "rescaled", lambda *_: SimpleNamespace(sound=sound, test=None))
    result: Any = SimpleNamespace(problem=None, graph=None, values=None)
    return bool(other_noises(result, [component]))


def test_a_noise_that_is_told_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Broken variants: odometry of few degrees of freedom takes up a slow clock, slip, a delay."""
    assert named(monkeypatch, Component("bearing", 3.0, 400.0, True))
    for component in (
        Component("odometry", 10.0, 40.0, True),  # 7.4 to 16 times the stated
        Component("odometry", 1.7, 20.0, True),
        Component("bearing", 3.0, 400.0, False),  # on its way
        Component("bearing", 1.05, 400.0, True),  # the stated one
    ):
        assert not named(monkeypatch, component)
    assert not named(monkeypatch, Component("bearing", 3.0, 400.0, True), sound=False)
