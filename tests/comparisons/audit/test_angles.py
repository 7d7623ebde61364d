"""A mean of angles that was not taken round the circle is told from gain, covariance, residual."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from comparisons.arrays import Array
from comparisons.audit.audit import Audit, audit
from comparisons.trace.recorder import Recorder
from ekf_reference.core.geometry import wrap_angle

F = np.array([[1.0, 0.1], [0.0, 1.0]])
Q = 1e-4 * np.eye(2)
ROUND = "mean of angles on both sides of +-pi"
Mean = Callable[[Array, Array], Array]


def on_the_line(weight: Array, angle: Array) -> Array:
    """Of angles (k,), as of any numbers."""
    return np.asarray(weight @ angle)


def on_the_circle(weight: Array, angle: Array) -> Array:
    return np.asarray(angle[0] + weight @ wrap_angle(angle - angle[0]))


class Compass:
    """An unscented filter of heading and rate that turns through +-pi, and has a compass.

    central: the weight of the middle point, by which the others are more or less far away. along:
    it measures the rate beside the heading.
    """

    def __init__(self, path: Path, central: float, *, along: bool) -> None:
        self.path, self.h = path, np.eye(2)[::-1] if along else np.eye(1, 2)
        self.r = 0.05**2 * np.eye(len(self.h))
        self.weight = np.r_[central, np.full(4, 0.25 * (1.0 - central))]

    def audited(self, mean: Mean, told: str, seed: int = 3, gain_of: float = 1.0) -> Audit:
        """mean: of angles. told: gain, correction or nothing. gain_of: times its own gain."""
        rng, p = np.random.default_rng(seed), 0.01 * np.eye(2)
        x = np.array([2.7, 0.4])
        truth, angle = x + 0.1 * rng.standard_normal(2), len(self.h) - 1
        with Recorder(self.path) as record:
            record.prior({"heading": 1, "rate": 1}, p)
            for step in range(40):
                record.at(0.1 * step)
                truth = F @ truth + 0.01 * rng.standard_normal(2)
                x, p = F @ x, F @ p @ F.T + Q
                record.predict(F, Q)
                z = self.h @ truth + 0.05 * rng.standard_normal(len(self.h))
                root = np.linalg.cholesky(p / (2.0 * self.weight[1])).T
                points = np.vstack((x, x + root, x - root))
                read = points @ self.h.T
                expected = self.weight @ read
                expected[angle] = mean(self.weight, wrap_angle(read[:, angle]))
                apart, residual = read - expected, z - expected
                apart[:, angle], residual[angle] = (
                    wrap_angle(one) for one in (apart[:, angle], residual[angle])
                )
                s = apart.T @ (self.weight[:, None] * apart) + self.r
                gain = (points - x).T @ (self.weight[:, None] * apart) @ np.linalg.inv(s)
                gain = gain_of * gain
                correction = gain @ residual
                x, p = x + correction, p - gain @ s @ gain.T
                shown = {"gain": {"gain": gain}, "correction": {"correction": correction}}
                record.update("compass", residual, self.h, self.r, **shown.get(told, {}))
                record.snapshot(p)
        return audit(self.path)


def named(done: Audit) -> list[str]:
    return [one.text for one in done.findings if ROUND in one.text]


@pytest.mark.parametrize("central", [0.0, 1.0 / 3.0, 0.6])
@pytest.mark.parametrize(
    ("told", "along"), [("gain", False), ("gain", True), ("correction", False)]
)
def test_a_mean_across_the_line_is_named(
    tmp_path: Path, central: float, told: str, along: bool
) -> None:
    done = Compass(tmp_path / "a.trace", central, along=along).audited(on_the_line, told)
    texts = named(done)
    assert texts
    assert done.findings[0].text == texts[0]
    assert done.findings[0].fault
    assert done.findings[0].sensor == "compass"
    assert ("component 1" in texts[0]) == along


@pytest.mark.parametrize("told", ["gain", "correction"])
@pytest.mark.parametrize(("mean", "gain_of"), [(on_the_circle, 1.0), (on_the_circle, 0.4)])
def test_no_other_gain_is_called_so(tmp_path: Path, told: str, mean: Mean, gain_of: float) -> None:
    """A right mean, and less than the gain that follows from it."""
    done = Compass(tmp_path / "a.trace", 1.0 / 3.0, along=False).audited(mean, told, 3, gain_of)
    assert not named(done)
