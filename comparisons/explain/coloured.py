"""Noise of a sensor that is not white: each measurement's shares in that of the one before.

Moving: v_k = n_k + s n_(k-1), of white n, as of differences of positions (s = -1) or of means of
two measurements (s = 1). Lasting: v_k = s v_(k-1) + n_k, as of a reference that drifts, or of what
was filtered before. The likelihood of the residuals is that of a recursion in whose state this
noise is a block of its own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from comparisons.arrays import Array
from comparisons.audit.replay import BlockLayout
from comparisons.explain.noises import NoiseSlot, log_likelihoods
from comparisons.explain.recorded_steps import RecordedStep
from comparisons.trace.events import ADDITIVE, Blocks, Event, Predict, TracePrior, Update

Shape = Literal["moving", "lasting"]

_SHARES: dict[Shape, tuple[float, ...]] = {
    "moving": (-1.0, -0.5, 0.5, 1.0),
    "lasting": (0.4, 0.8, 0.95),
}
_HALVINGS = (0.15, 0.07, 0.03)
"""Steps of a share about the likeliest."""
_MOST_SHARE: dict[Shape, float] = {"moving": 1.0, "lasting": 0.999}
_LOGS = np.linspace(np.log(0.01), np.log(1e4), 9)
"""Logarithms of factors on R."""
_LEAST_UPDATES, _MOST_EVENTS, _MOST_ENTRIES, _MOST_COMPONENTS = 30, 1_500, 40, 6
"""Updates of a sensor; events by which a share is fitted; entries of a state, of a measurement."""
_LEAST_GAINED = 3.0
"""Of the likelihood's logarithm, over that of white noise with a factor, to be looked at."""
_WHITE = 1e-6
"""Share of R that stays white, so that least squares have a weight."""


class ColourSlot(NamedTuple):
    """Noise of a sensor whose values are correlated.

    Attributes:
        of: The sensor.
        shape: Of the correlation.
        matrix: R.
        since: The event from which on it is so: all.
    """

    of: str
    shape: Shape
    matrix: str = "R"
    since: int = 0

    def words(self, components: Sequence[str] = ()) -> str:
        """Return what it is called."""
        return f"noise of sensor `{self.of}`"

    def touches(self, event: Event) -> bool:
        """Whether an event has this noise."""
        return isinstance(event, Update) and event.sensor == self.of


class ColouredNoise(NamedTuple):
    """A correlated noise that residuals show.

    Attributes:
        slot: Which.
        gained: Of the likelihood's logarithm.
        share: s of the equations above.
        factor: Of its variance over the stated R.
        interval: Of the factor, 95 %.
        stated: (m, m) R of the first measurement.
    """

    slot: ColourSlot
    gained: float
    share: float
    factor: float
    interval: tuple[float, float]
    stated: Array

    @property
    def correlation(self) -> float:
        """Of the noises of two measurements that follow each other."""
        if self.slot.shape == "lasting":
            return self.share
        return self.share / (1.0 + self.share**2)

    def said(self) -> str:
        """Return it in words."""
        text = (
            f"{self.slot.words()} that is correlated from one measurement to the next "
            f"({self.correlation:.2g}) and {self.factor:.3g} times the stated one"
        )
        ends = {-1.0: "differences of independent measurements", 1.0: "means of two measurements"}
        near = [words for share, words in ends.items() if abs(self.share - share) < _HALVINGS[0]]
        return f"{text}, as of {near[0]}" if near and self.slot.shape == "moving" else text

    @property
    def block(self) -> str:
        """What the noise is called in a state."""
        return f"noise of sensor {self.slot.of}"

    @property
    def size(self) -> int:
        """Entries of the block: of the noise, and where it moves, of the one before."""
        return len(self.stated) * (2 if self.slot.shape == "moving" else 1)

    def begun(self) -> Array:
        """Return the block's covariance before the first measurement."""
        variance = self.factor * self.stated
        if self.slot.shape == "lasting":
            return variance
        white: Array = variance / (1.0 + self.share**2)
        return np.asarray(block_diag(white, white), dtype=np.float64)

    def moved(self, r: Array) -> tuple[Array, Array]:
        """Return F and Q (size, size) from one measurement to the next. r: (m, m) its stated R."""
        m, variance = len(r), self.factor * r
        if self.slot.shape == "lasting":
            return self.share * np.eye(m), (1.0 - self.share**2) * variance
        f, q = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, 2 * m))
        f[m:, :m] = np.eye(m)
        q[:m, :m] = variance / (1.0 + self.share**2)
        return f, q

    def entering(self) -> Array:
        """Return H (m, size) of the block in a measurement."""
        identity = np.eye(len(self.stated))
        if self.slot.shape == "lasting":
            return identity
        return np.hstack((identity, self.share * identity))


def with_colour(steps: Iterable[RecordedStep], noise: ColouredNoise) -> Iterator[RecordedStep]:
    """Yield events in whose state a correlated noise is the first block, without estimates."""
    nothing = np.zeros(noise.size)
    for step in steps:
        event = step.event
        applied = None if step.applied is None else np.concatenate((nothing, step.applied))
        if isinstance(event, TracePrior):
            event = event._replace(
                blocks=(noise.block, *event.blocks),
                dims=(noise.size, *event.dims),
                covariance=np.asarray(block_diag(noise.begun(), event.covariance)),
                point=None,
                charts=(ADDITIVE, *event.charts) if event.charts else (),
            )
        elif isinstance(event, Update):
            event = event._replace(gain=None, correction=applied)
            if noise.slot.touches(event):
                f, q = noise.moved(event.noise)
                blocks: Blocks = (noise.block,)
                passed = Predict(event.number, event.time_s, blocks, f, q)
                yield RecordedStep(passed, None)
                event = event._replace(
                    blocks=(*blocks, *event.blocks),
                    jacobian=np.hstack((noise.entering(), event.jacobian)),
                    noise=_WHITE * event.noise,
                )
        yield step._replace(event=event, applied=applied, estimate=None)


def coloured_noises(steps: Sequence[RecordedStep]) -> list[ColouredNoise]:
    """Return the likeliest correlated noise of each sensor and shape that is likelier than white.

    steps: Of a trace, from its prior on. Large states, and measurements of which there are few or
    whose sizes differ, are passed over.
    """
    first = steps[:_MOST_EVENTS]
    if _most_entries(first) > _MOST_ENTRIES:
        return []
    stated = defaultdict[str, list[Array]](list)
    for step in first:
        if isinstance(step.event, Update):
            stated[step.event.sensor].append(step.event.noise)
    fitted: list[ColouredNoise] = []
    for sensor, noises in stated.items():
        widths = {len(noise) for noise in noises}
        if len(noises) >= _LEAST_UPDATES and len(widths) == 1 and max(widths) <= _MOST_COMPONENTS:
            fitted += _of_sensor(first, sensor, noises[0])
    values = [log_likelihoods(with_colour(steps, noise), [{}])[0] for noise in fitted]
    neutral = log_likelihoods(steps, [{}])[0] if fitted else 0.0
    gains = [float(value - neutral) for value in values]
    return [
        noise._replace(gained=gained)
        for noise, gained in zip(fitted, gains, strict=True)
        if 0.0 < gained < np.inf
    ]


def _most_entries(steps: Iterable[RecordedStep]) -> int:
    """Of the state, at any event."""
    layout, most = BlockLayout(), 0
    for step in steps:
        if isinstance(step.event, TracePrior):
            layout = BlockLayout(step.event.blocks, step.event.dims)
        layout.follow(step.event)
        most = max(most, layout.size)
    return most


def _of_sensor(
    steps: Sequence[RecordedStep], sensor: str, stated: Array
) -> Iterator[ColouredNoise]:
    """Yield the likeliest share and factor of each shape, where they are likelier than white."""

    def scaled(shape: Shape, share: float, finer: int = 2) -> tuple[float, ColouredNoise]:
        slot = ColourSlot(sensor, shape)
        return _scaled(steps, ColouredNoise(slot, 0.0, share, 1.0, (1.0, 1.0), stated), finer)

    white = scaled("moving", 0.0)[0]
    for shape, shares in _SHARES.items():
        tried = {share: scaled(shape, share)[0] for share in shares}
        if not max(tried.values()) > white + _LEAST_GAINED:
            continue
        for step in _HALVINGS:
            best = max(tried, key=lambda share: tried[share])
            for share in (best - step, best + step):
                if abs(share) <= _MOST_SHARE[shape]:
                    tried[share] = scaled(shape, share)[0]
        best = max(tried, key=lambda share: tried[share])
        yield scaled(shape, best, finer=3)[1]


def _scaled(
    steps: Sequence[RecordedStep], noise: ColouredNoise, finer: int
) -> tuple[float, ColouredNoise]:
    """The likelihood's logarithm with the likeliest factor, and the noise with that.

    noise: with a factor of 1. finer: how often the factor is sought, each time about the likeliest
    of the time before.
    """
    extended = list(with_colour(steps, noise))
    slots = NoiseSlot("P0", noise.block), NoiseSlot("Q", noise.block)
    logs = _LOGS
    for _ in range(finer):
        factors = [dict.fromkeys(slots, float(np.exp(log))) for log in logs]
        values = log_likelihoods(extended, factors)
        best, step = int(values.argmax()), logs[1] - logs[0]
        around = logs[best]
        logs = around + step * np.linspace(-1.0, 1.0, len(_LOGS))
    low, middle, high = values[np.clip((best - 1, best, best + 1), 0, len(values) - 1)]
    bend = (2.0 * middle - low - high) / step**2
    width = 1.96 / np.sqrt(bend) if bend > 0.0 else np.inf
    interval = float(np.exp(around - width)), float(np.exp(around + width))
    return float(middle), noise._replace(factor=float(np.exp(around)), interval=interval)
