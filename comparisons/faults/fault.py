"""What a fault is, and the parts of a filter that one can be planted in.

A function that replaces a method is given that method first, bound to its object, then its
arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from comparisons.arrays import Array
from comparisons.logs.log import Log
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT
from ekf_reference.core.layout import Layout
from ekf_reference.core.state import KalmanState
from ekf_reference.models.motion import MotionModel, MotionStep
from ekf_reference.models.range_bearing import RangeBearing

Plant = Callable[[Ekf], None]
Feed = Callable[[Log], Log]
Method = Callable[..., Any]
T = TypeVar("T")


class Fault(NamedTuple):
    """what: in words. plant: in a filter that has not started. feed: makes its log. name: short."""

    what: str
    plant: Plant | None = None
    feed: Feed | None = None
    name: str = ""


NONE = Fault("none")


def together(*faults: Fault) -> Fault:
    """All of them at once, one after the other; of plants in the same part the last counts."""
    some = [fault for fault in faults if fault is not NONE]
    if len(some) < 2:
        return some[0] if some else NONE
    plants = [fault.plant for fault in some if fault.plant is not None]
    feeds = [fault.feed for fault in some if fault.feed is not None]

    def plant(ekf: Ekf) -> None:
        for plant_in in plants:
            plant_in(ekf)

    def feed(log: Log) -> Log:
        for feed_with in feeds:
            log = feed_with(log)
        return log

    what = ", and ".join(fault.what for fault in some)
    return Fault(what, plant if plants else None, feed if feeds else None)


class Family(NamedTuple):
    """Faults that differ by a number. what: in words, with its place. said: words of the number.

    feed: makes the log of it. plant: puts it into the filter. neutral: the number of no fault.
    factor: it multiplies, so that it is fitted as a logarithm.
    """

    what: str
    feed: Callable[[Log, float], Log] | None = None
    neutral: float = 1.0
    factor: bool = True
    plant: Callable[[float], Plant] | None = None
    said: Callable[[float], str] | None = None

    def member(self, number: float) -> Fault:
        """The fault with a number."""
        what = self.what.format(f"{number:.4g}") if self.said is None else self.said(number)
        feed = self.feed
        plant = None if self.plant is None else self.plant(number)
        return Fault(what, plant, None if feed is None else lambda log: feed(log, number))


def derived(base: type[T], **methods: Method) -> type[T]:
    """Return a class with other methods."""

    def replaced(name: str, method: Method) -> Method:
        return lambda self, *args, **more: method(getattr(base, name).__get__(self), *args, **more)

    return type(base.__name__, (base,), {name: replaced(name, m) for name, m in methods.items()})


def with_state(state: Callable[[Array, Array], KalmanState]) -> Plant:
    """Another keeper of mean and covariance, made of a pose and its covariance: of an empty map."""

    def plant(ekf: Ekf) -> None:
        ekf.state = state(ekf.state.pose, np.array(ekf.state.covariance))

    return plant


def keeping(**methods: Method) -> Plant:
    """Other methods of what keeps mean and covariance; what it keeps so far stays.

    Of surveyed landmarks the map begins with these.
    """

    def plant(ekf: Ekf) -> None:
        ekf.state.__class__ = derived(type(ekf.state), **methods)

    return plant


def with_motion(motion: Callable[[MotionModel], MotionModel]) -> Plant:
    """Another motion model, made of the filter's own."""

    def plant(ekf: Ekf) -> None:
        ekf.motion = motion(ekf.motion)

    return plant


def stepping(**methods: Method) -> Plant:
    """Other methods of the filter itself."""

    def plant(ekf: Ekf) -> None:
        ekf.__class__ = derived(type(ekf), **methods)

    return plant


def observing(**methods: Method) -> Plant:
    """Other methods of the observation model, which is new for every filter."""
    model = derived(RangeBearing, **methods)

    def plant(ekf: Ekf) -> None:
        ekf.models[POINT] = model()

    return plant


@dataclass
class _Moving:
    """A motion model whose step is another."""

    sound: MotionModel
    other: Method

    def step(self, pose: Array, control: Array, duration_s: float) -> MotionStep:
        moved: MotionStep = self.other(self.sound.step, pose, control, duration_s)
        return moved


def moving(step: Method) -> Plant:
    """Another step of the motion model."""
    return with_motion(lambda sound: _Moving(sound, step))


def remembering(other: Callable[[], Plant]) -> Plant:
    """A fault that remembers something: made anew for each filter."""
    return lambda ekf: other()(ekf)


class StateChange(NamedTuple):
    """What a method of the state has done.

    p: (n, n) covariance, to be changed. before: what it was. layout: of the state now.
    """

    p: Array
    before: Array
    layout: Layout


def after(method: str, change: Callable[..., None]) -> Plant:
    """Another covariance once a method of the state is done. It is called with a `StateChange`."""

    def replaced(original: Any, *args: Any) -> Any:
        state: KalmanState = original.__self__
        before, result = state.covariance.copy(), original(*args)
        n = state.layout.size
        change(StateChange(state._covariance[:n, :n], before, state.layout), *args)
        return result

    return keeping(**{method: replaced})
