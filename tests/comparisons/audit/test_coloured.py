"""Noise that is not white is named, with its correlation and its factor, from a trace alone."""

from pathlib import Path

import numpy as np
import pytest

import slamcheck
from comparisons.arrays import Array
from comparisons.audit.audit import Audit
from comparisons.explain.coloured import ColouredNoise, coloured_noises
from comparisons.explain.recorded_steps import steps_of
from comparisons.trace.events import Augment
from comparisons.trace.reader import TraceReader

DT_S, COUNT = 0.1, 300
F = np.array(((1.0, DT_S), (0.0, 1.0)))
Q = 0.05 * np.array(((DT_S**3 / 3.0, DT_S**2 / 2.0), (DT_S**2 / 2.0, DT_S)))
H = {"localiser": np.array(((1.0, 0.0),)), "odometer": np.array(((0.0, 1.0),))}
STATED = {"localiser": 0.05**2, "odometer": 0.03**2}


def white(rng: np.random.Generator) -> Array:
    return rng.standard_normal(COUNT)


def moving(rng: np.random.Generator, share: float) -> Array:
    steps = rng.standard_normal(COUNT + 1)
    noise: Array = (steps[1:] + share * steps[:-1]) / np.sqrt(1.0 + share**2)
    return noise


def lasting(rng: np.random.Generator, share: float) -> Array:
    noise = rng.standard_normal(COUNT)
    for k in range(1, COUNT):
        noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
    return noise


def audited(path: Path, noises: dict[str, Array], seed: int, q: float = 1.0) -> Audit:
    """A vehicle on a line. noises: (COUNT,) of each sensor, in stated sigmas. q: factor on Q."""
    rng = np.random.default_rng(seed)
    true, state, p = np.zeros(2), np.zeros(2), np.eye(2)
    root = np.linalg.cholesky(Q)
    with slamcheck.Recorder(path) as record:
        record.prior({"position": 1, "velocity": 1}, p)
        true = true + rng.standard_normal(2)
        for k in range(COUNT):
            record.at(k * DT_S)
            true, state = F @ true + root @ rng.standard_normal(2), F @ state
            p = F @ p @ F.T + q * Q
            record.predict(F, q * Q, ["position", "velocity"])
            for sensor, h in H.items():
                r = np.array(((STATED[sensor],),))
                z = h @ true + np.sqrt(r[0]) * noises[sensor][k]
                residual, gain = z - h @ state, p @ h.T / (h @ p @ h.T + r)
                record.update(sensor, residual, h, r, ["position", "velocity"])
                state, p = state + gain @ residual, p - gain @ h @ p
                p = 0.5 * (p + p.T)
            if k % 10 == 9:
                record.snapshot(p)
    return slamcheck.audit(path)


@pytest.mark.parametrize(
    ("shape", "share", "correlation"),
    [("moving", -1.0, -0.5), ("moving", 1.0, 0.5), ("lasting", 0.8, 0.8), ("lasting", 0.5, 0.5)],
)
@pytest.mark.parametrize(
    ("sensor", "factor"), [("localiser", 1.0), ("localiser", 30.0), ("odometer", 30.0)]
)
def test_a_correlated_noise_is_named(
    tmp_path: Path, sensor: str, shape: str, share: float, correlation: float, factor: float
) -> None:
    rng = np.random.default_rng(7)
    noise = (moving if shape == "moving" else lasting)(rng, share)
    noises = {name: white(rng) for name in H} | {sensor: np.sqrt(factor) * noise}
    explained = audited(tmp_path / "run.trace", noises, seed=8).explained
    assert explained is not None
    assert explained.fits
    assert explained.sensor == sensor
    (cause,) = explained.causes
    assert isinstance(cause.fitted, ColouredNoise)
    assert f"noise of sensor `{sensor}` that is correlated" in explained.what
    assert cause.fitted.correlation == pytest.approx(correlation, abs=0.12)
    assert cause.fitted.factor == pytest.approx(factor, rel=0.35)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("q", [1.0, 0.02, 30.0])
def test_white_noises_are_not_called_correlated(tmp_path: Path, seed: int, q: float) -> None:
    """Another Q correlates innovations as well."""
    rng = np.random.default_rng(seed)
    found = audited(tmp_path / "run.trace", {name: white(rng) for name in H}, seed + 100, q)
    explained = found.explained
    assert (explained is None) or "correlated" not in explained.what.split(", or ")[0]
    assert found.sound == (q == 1.0)


def test_states_that_grow_large_are_passed_over(tmp_path: Path) -> None:
    """As a map does: a recursion of nine choices at once would take minutes."""
    with slamcheck.Recorder(tmp_path / "run.trace") as record:
        record.prior({"state": 1}, np.eye(1))
        for k in range(40):
            record.update("gps", [0.3], np.eye(1), np.eye(1), ["state"])
            record.augment(f"landmark {k}", np.eye(1), np.eye(1), np.eye(1), ["state"])
    events = list(TraceReader(tmp_path / "run.trace"))
    assert coloured_noises(list(steps_of(events))) == []
    small = (event for event in events if not isinstance(event, Augment))
    assert coloured_noises(list(steps_of(small)))
