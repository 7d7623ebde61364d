"""Noises other than the stated ones: their likelihood by an oracle, and what is named of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from comparisons.arrays import Array
from comparisons.audit.audit import audit
from comparisons.audit.explained import explained_innovations
from comparisons.audit.replay import BlockLayout, Replay
from comparisons.explain.noises import (
    NoiseFactor,
    NoiseSlot,
    log_likelihoods,
    noise_slots,
    readings,
    with_noises,
)
from comparisons.explain.offsets import (
    AHEAD,
    LEFT,
    MOVES,
    Offset,
    OffsetSlot,
    offset_slots,
    without_offsets,
)
from comparisons.explain.recorded_steps import RecordedStep, steps_of
from comparisons.explain.scores import Slot, likelihood_slopes
from comparisons.trace.events import Augment, Event, Predict, TracePrior, Update
from comparisons.trace.reader import TraceReader
from research.trust.drawn_causes import (
    H_OF,
    F,
    JacobianFault,
    LinearDrive,
    LinearFault,
    tells,
)

RNG = np.random.default_rng(3)
P0_OF_BIAS = NoiseSlot("P0", "bias")
Q_OF_SPEED = NoiseSlot("Q", "speed")
R_OF_RANGE = NoiseSlot("R", "range")
R_OF_EAST = NoiseSlot("R", "gps", 0)
LATER = Q_OF_SPEED._replace(since=5)
FACTORS: tuple[dict[NoiseSlot, float], ...] = (
    {},
    {P0_OF_BIAS: 4.0},
    {Q_OF_SPEED: 0.1, R_OF_RANGE: 3.0},
    {R_OF_EAST: 7.0},
    {LATER: 5.0},
)


def covariance(size: int, scale: float) -> Array:
    root = RNG.standard_normal((size, size))
    return np.asarray(scale * (0.3 * root @ root.T + np.eye(size)))


STATE = ("place", "speed", "bias")
EVERYTHING: tuple[Event, ...] = (
    TracePrior(0, None, STATE, (2, 1, 1), covariance(4, 1.0)),
    Predict(1, 0.1, STATE, RNG.standard_normal((4, 4)), covariance(4, 0.2)),
    Update(2, 0.2, "gps", ("place",), RNG.standard_normal(2), np.eye(2), covariance(2, 0.3), True,
           RNG.standard_normal(4), None),
    Augment(3, 0.3, "tree", STATE, RNG.standard_normal((2, 4)), np.eye(2), covariance(2, 0.1)),
    Predict(4, 0.4, ("speed", "bias"), RNG.standard_normal((2, 2)), covariance(2, 0.2)),
    Update(5, 0.5, "range", ("tree", "bias"), RNG.standard_normal(1), RNG.standard_normal((1, 3)),
           covariance(1, 0.3), True, RNG.standard_normal(6), None),
    Predict(6, 0.6, STATE, RNG.standard_normal((4, 4)), covariance(4, 0.2)),
    Update(7, 0.7, "range", STATE, RNG.standard_normal(1), RNG.standard_normal((1, 4)),
           covariance(1, 0.3), False, None, None),
)  # fmt: skip
"""Whatever the corrections were: they are drawn."""
WITH_MOVES: tuple[Event, ...] = tuple(
    one._replace(
        point=RNG.standard_normal(len(one.jacobian)), after=RNG.standard_normal(len(one.jacobian))
    )
    if isinstance(one, Predict)
    else one
    for one in EVERYTHING
)
"""Predictions that say where they lead."""


def residuals_of(steps: Sequence[RecordedStep], drawn: Array) -> Array:
    """Return all residuals, by the noises that are drawn: those of the prior, and of each event."""
    at, residuals = 0, []
    replay: Replay
    for event, applied, *_ in steps:
        if isinstance(event, TracePrior):
            replay = Replay(event)
            size = len(event.covariance)
            replay.mean = drawn[:size].copy()
            at = size
            continue
        assert isinstance(event, Predict | Update | Augment)
        noise = drawn[at : at + len(event.noise)]
        at += len(event.noise)
        columns = replay.layout.columns(event.blocks)
        if isinstance(event, Update):
            residuals.append(event.jacobian @ replay.mean[columns] + noise)
            replay.mean = replay.mean - (0.0 if applied is None else applied)
            continue
        replay.apply(event)
        new = replay.layout.columns((event.name,) if isinstance(event, Augment) else event.blocks)
        replay.mean[new] += noise
    return np.concatenate(residuals)


def dense(steps: Sequence[RecordedStep], factors: Mapping[NoiseSlot, float]) -> float:
    """The logarithm of the residuals' density as one Gaussian, linear in all noises."""
    noises = [
        event.covariance if isinstance(event, TracePrior) else event.noise
        for event, *_ in with_noises(steps, factors)
        if isinstance(event, TracePrior | Predict | Update | Augment)
    ]
    covariance = block_diag(*noises)
    mean = residuals_of(steps, np.zeros(len(covariance)))
    by_noise = np.array([residuals_of(steps, row) - mean for row in np.eye(len(covariance))])
    measured = np.concatenate([e.residual for e, *_ in steps if isinstance(e, Update)])
    return float(multivariate_normal(mean, by_noise.T @ covariance @ by_noise).logpdf(measured))


def test_the_likelihood_is_that_of_all_residuals_as_one_gaussian() -> None:
    steps = list(steps_of(EVERYTHING))
    recursive = log_likelihoods(steps, FACTORS)
    oracle = np.array([dense(steps, factors) for factors in FACTORS])
    assert np.ptp(oracle) > 0.1
    np.testing.assert_allclose(np.diff(recursive), np.diff(oracle), rtol=1e-8)
    # broken: the filter's corrections are forgotten
    forgotten = [step._replace(applied=None) for step in steps]
    assert not np.allclose(np.diff(log_likelihoods(forgotten, FACTORS)), np.diff(oracle), rtol=1e-2)


def slopes_of(steps: Sequence[RecordedStep], slots: Sequence[Slot]) -> Array:
    """Central differences of the likelihood by logarithms of factors, and by constants."""
    size, slopes = 1e-4, []
    for slot in slots:
        if isinstance(slot, NoiseSlot):
            logs = log_likelihoods(steps, [{slot: np.exp(size)}, {slot: np.exp(-size)}])
        else:
            constants = [Offset(slot, 0.0, sign * size, 1.0) for sign in (1.0, -1.0)]
            shifted = [list(without_offsets(steps, [one])) for one in constants]
            logs = np.concatenate([log_likelihoods(each, [{}]) for each in shifted])
        slopes.append((logs[0] - logs[1]) / (2.0 * size))
    return np.array(slopes)


@pytest.mark.parametrize("events", [EVERYTHING, WITH_MOVES])
def test_slopes_are_those_of_the_likelihood(events: Sequence[Event]) -> None:
    steps = list(steps_of(events))
    slots: list[Slot] = [*noise_slots(steps), *offset_slots(steps)]
    assert len(slots) > 12
    slopes = likelihood_slopes(steps, slots, {})
    np.testing.assert_allclose(slopes.total[:-1, 0], slopes_of(steps, slots), rtol=1e-5, atol=1e-7)
    # under factors that are known already
    known = {R_OF_RANGE: 3.0}
    other = likelihood_slopes(steps, [Q_OF_SPEED], known).total[0, 0]
    logs = log_likelihoods(steps, [{**known, Q_OF_SPEED: np.exp(x)} for x in (1e-4, -1e-4)])
    assert other == pytest.approx((logs[0] - logs[1]) / 2e-4, rel=1e-5)
    # broken: the filter's corrections are forgotten
    forgotten = [step._replace(applied=None) for step in steps]
    wrong = likelihood_slopes(forgotten, slots, {}).total[:-1, 0]
    assert not np.allclose(wrong, slopes.total[:-1, 0], rtol=1e-2)


def with_entry(step: RecordedStep, entry: tuple[int, ...], more: float, by: Array) -> RecordedStep:
    """Another entry of a step's Jacobian, that a filter moves its estimate by as well, by `by`."""
    event = step.event
    assert isinstance(event, Predict | Update)
    added = np.zeros(event.jacobian.shape)
    added[entry] = more
    if isinstance(event, Update):
        residual = event.residual - added @ by
        return step._replace(
            event=event._replace(jacobian=event.jacobian + added, residual=residual)
        )
    layout = BlockLayout(("place", "speed", "bias", "tree"), (2, 1, 1, 2))
    applied = np.zeros(4 if event.number < 3 else 6)
    applied[layout.columns(event.blocks)] = -added @ by
    return RecordedStep(event._replace(jacobian=event.jacobian + added), applied, step.estimate)


@pytest.mark.parametrize("moves_estimate", [False, True])
def test_derivatives_by_jacobians_are_those_of_the_likelihood(moves_estimate: bool) -> None:
    steps = list(steps_of(EVERYTHING))
    numbers = [step.event.number for step in steps if step.estimate is not None]
    assert len(numbers) == 6
    gradients = likelihood_slopes(steps, [], {}, numbers).gradients
    size, largest = 1e-5, 0.0
    for k, step in enumerate(steps):
        if step.estimate is None:
            continue
        event = step.event
        assert isinstance(event, Predict | Update)
        by = step.estimate if moves_estimate else np.zeros_like(step.estimate)
        gradient = gradients[event.number].with_estimate(by)[:, :, 0]
        for entry in np.ndindex(*event.jacobian.shape):
            logs = [
                log_likelihoods(
                    [*steps[:k], with_entry(step, entry, more, by), *steps[k + 1 :]], [{}]
                )
                for more in (size, -size)
            ]
            slope = float(logs[0][0] - logs[1][0]) / (2.0 * size)
            assert gradient[entry] == pytest.approx(slope, rel=1e-5, abs=1e-7)
            without = gradients[event.number].slope[(*entry, 0)]
            largest = max(largest, abs(float(without) - slope))
    # broken: the estimate is not moved by it
    assert (largest > 0.1) == moves_estimate


def test_slopes_of_a_long_trace_are_as_chance_makes_them(tmp_path: Path) -> None:
    """Of an unstable drive: what rounding makes unlike in N would grow with each event."""
    LinearDrive(5, None).record(tmp_path / "run.trace")
    steps = list(steps_of(TraceReader(tmp_path / "run.trace")))
    numbers = [step.event.number for step in steps if isinstance(step.event, Update)]
    gradients = likelihood_slopes(steps, [], {}, numbers).gradients
    drawn = np.stack([gradients[k].slope[0, 0, 1:] for k in numbers if k in gradients])
    mean, spread = drawn.mean(axis=1), drawn.std(axis=1)
    assert np.all(np.abs(mean) < 6.0 * spread / np.sqrt(drawn.shape[1]) + 1e-9)


def test_the_estimate_is_that_of_a_linear_filter(tmp_path: Path) -> None:
    drive = LinearDrive(5, None)
    drive.record(tmp_path / "run.trace")
    last = list(steps_of(TraceReader(tmp_path / "run.trace")))[-1]
    *_, step = (s for s in steps_of(TraceReader(tmp_path / "run.trace")) if s.estimate is not None)
    assert step.estimate is not None
    assert step.applied is not None
    assert last.estimate is None
    after = step.estimate + step.applied
    np.testing.assert_allclose(after, drive.estimate, rtol=1e-9)
    # broken: corrections without what predictions make of them
    assert not np.allclose(step.applied, drive.estimate)


EXCHANGED_F, HALVED_F = F.copy(), F.copy()
EXCHANGED_F[:, [3, 4]] = F[:, [4, 3]]
HALVED_F[0, 2] = 0.05
NEGATED_H, HALVED_H = H_OF["odometer"] * (1, 1, 1, -1, 1), H_OF["odometer"] * (1, 1, 0.5, 1, 1)


@pytest.mark.parametrize(
    ("of", "wrong", "moves_estimate", "words"),
    [
        ("odometer", NEGATED_H, False, "has the opposite sign"),
        ("odometer", NEGATED_H, True, "H of sensor `odometer`, in what it expects as well"),
        ("odometer", HALVED_H, True, "is the filter's +0.5"),
        ("", EXCHANGED_F, False, "the columns of speed[1] and bias in F are exchanged"),
        ("", EXCHANGED_F, True, "F of place, speed, bias, in their estimate as well"),
        ("", HALVED_F, True, "the speed[0] term of the place[0] row of F is the filter's +0.04"),
    ],
)
def test_a_jacobian_that_is_another_is_named(
    of: str, wrong: Array, moves_estimate: bool, words: str, tmp_path: Path
) -> None:
    fault = JacobianFault(of, wrong, moves_estimate, "")
    LinearDrive(7, fault).record(tmp_path / "run.trace")
    assert tells(tmp_path / "run.trace", fault)
    explained = audit(tmp_path / "run.trace").explained
    assert explained is not None
    assert explained.fits
    first = explained.causes[0]
    assert any(map(fault.is_named, (first.fitted, *first.others))), explained.what
    assert words in explained.what


@pytest.mark.parametrize("events", [EVERYTHING, WITH_MOVES])
def test_drawn_slopes_are_as_chance_makes_them(events: Sequence[Event]) -> None:
    """Of the drawn innovations: those of the filter's own covariance have slopes about zero."""
    steps = list(steps_of(events))
    slots: list[Slot] = [*noise_slots(steps), *offset_slots(steps)]
    drawn = likelihood_slopes(steps, slots, {}).total[:-1, 1:]
    spread = drawn.std(axis=1) / np.sqrt(drawn.shape[1])
    assert (np.abs(drawn.mean(axis=1)) < 4.0 * spread).all()


@pytest.mark.parametrize(
    "fault",
    [
        LinearFault(NoiseSlot("Q", "speed"), 10.0, 0),
        LinearFault(NoiseSlot("R", "gps"), 0.1, 0),
        LinearFault(NoiseSlot("R", "gps", 1), 10.0, 150),
        LinearFault(OffsetSlot("odometer", 0, False), 0.5, 150),
        LinearFault(OffsetSlot("speed", 1, True), 0.3, 100),
    ],
)
def test_what_is_not_as_stated_is_named(fault: LinearFault, tmp_path: Path) -> None:
    LinearDrive(5, fault).record(tmp_path / "run.trace")
    explained = audit(tmp_path / "run.trace").explained
    assert explained is not None
    first = explained.causes[0]
    assert explained.fits
    assert fault.is_named(first.fitted)
    assert bool(first.slot.since) == bool(fault.since)


def driven(
    seed: int, *, times: float = 1.0, late_s: float = 0.0, arm: tuple[float, float] = (0.0, 0.0)
) -> list[Event]:
    """A filter of a position that is moved by times the true moves, and measured late.

    arm: of what is measured, ahead and to the left.
    """
    rng, step_s = np.random.default_rng(seed), 0.1
    p, q, r, one = 0.01 * np.eye(2), 1e-4 * np.eye(2), 0.04 * np.eye(2), np.eye(2)
    place = ("place",)
    truth, estimate = 0.1 * rng.standard_normal(2), np.zeros(2)
    events: list[Event] = [TracePrior(0, 0.0, place, (2,), p)]
    for k in range(1, 400):
        speed = 1.0 + 0.8 * np.sin(0.05 * k)
        velocity = speed * np.array((np.cos(0.03 * k), np.sin(0.03 * k)))
        truth = truth + step_s * velocity + 0.01 * rng.standard_normal(2)
        before, estimate, p = estimate, estimate + times * step_s * velocity, p + q
        events.append(Predict(len(events), step_s * k, place, one, q, before, estimate))
        if k % 3:
            continue
        ahead = velocity / np.linalg.norm(velocity)
        measured = truth - late_s * velocity + np.column_stack((ahead, ahead[::-1] * (-1, 1))) @ arm
        residual = measured + 0.2 * rng.standard_normal(2) - estimate
        gain = p @ np.linalg.inv(p + r)
        correction = gain @ residual
        events.append(Update(len(events), step_s * k, "gps", place, residual, one, r, True,
                             correction, None, estimate))  # fmt: skip
        estimate, p = estimate + correction, p - gain @ p
    return events


@pytest.mark.parametrize(
    ("slot", "made", "value"),
    [
        (OffsetSlot("place", -1, True, 0, MOVES, (0, 1)), {"times": 2.0}, -0.5),
        (OffsetSlot("place", -1, True, 0, MOVES, (0, 1)), {"times": 1.1}, -1.0 + 1.0 / 1.1),
        (OffsetSlot("gps", -1, False, 0, MOVES), {"late_s": 0.4}, -0.4),
        (OffsetSlot("gps", -1, False, 0, AHEAD), {"arm": (-0.6, 0.0)}, -0.6),
        (OffsetSlot("gps", -1, False, 0, LEFT), {"arm": (0.0, 0.3)}, 0.3),
    ],
)
def test_what_goes_with_moves_is_named(
    slot: OffsetSlot, made: Mapping[str, Any], value: float
) -> None:
    """A scale of the motion, a delay of a sensor; broken: the sensor's mean and noise were."""
    explained = explained_innovations(driven(3, **made), {}, 1e-3, is_off=True)
    assert explained is not None
    assert explained.fits
    (cause,) = explained.causes
    named = {one.slot: one for one in (cause.fitted, *cause.others)}
    fitted = named[slot]
    assert isinstance(fitted, Offset)
    assert abs(fitted.value - value) < 3.5 * fitted.sigma


def test_a_sound_filter_that_moves_is_not_accused() -> None:
    for seed in range(8):
        assert explained_innovations(driven(seed), {}, 1e-3, is_off=False) is None


def test_what_follows_from_a_cause_is_no_fault_of_its_own(tmp_path: Path) -> None:
    fault = LinearFault(OffsetSlot("odometer", 0, False), 1.0, 150)
    LinearDrive(5, fault, has_truth=True).record(tmp_path / "run.trace")
    result = audit(tmp_path / "run.trace")
    faults = [one.text for one in result.findings if one.fault]
    assert len(faults) == 1, faults
    assert faults[0].startswith("a constant +")
    explained = [
        one
        for one in result.findings
        if "explained by component 0 of sensor `odometer`" in one.text
    ]
    assert {"innovations", "nees"} <= {one.check for one in explained}


def test_what_a_cause_does_not_explain_stays_a_fault(tmp_path: Path) -> None:
    """Errors that the innovations do not show: the truth is 30 m elsewhere."""
    fault = LinearFault(OffsetSlot("odometer", 0, False), 1.0, 150)
    drive = LinearDrive(5, fault, has_truth=True)
    drive.truth_is_off = np.array([30.0, 0.0, 0.0, 0.0, 0.0])
    drive.record(tmp_path / "run.trace")
    faults = [one for one in audit(tmp_path / "run.trace").findings if one.fault]
    assert [one.check for one in faults] == ["innovations", "nees"]


def test_a_sound_filter_is_not_accused(tmp_path: Path) -> None:
    for seed in range(6):
        LinearDrive(seed, None).record(tmp_path / f"{seed}.trace")
        assert audit(tmp_path / f"{seed}.trace").explained is None


def test_what_may_have_been_written_is_within_the_interval() -> None:
    steps = [RecordedStep(EVERYTHING[0], None)]
    steps += [RecordedStep(Update(k, 0.1 * k, "range", ("bias",), np.zeros(1), np.eye(1),
                                  np.array([[0.04]]), True, None, None), None)
              for k in range(1, 4)]  # fmt: skip
    sigma = NoiseFactor(R_OF_RANGE, 9.0, 0.041, 0.02, 0.08)
    assert readings(sigma, steps) == ["as of a sigma where its square should be"]
    squared = sigma._replace(factor=5.2, low=4.0, high=6.0)
    assert readings(squared, steps) == ["as of a variance that was squared"]
    assert readings(sigma._replace(low=0.05), steps) == []
