"""Time of the suboptimal global update (Guivant 2002, section 4.1) against c1 and map size.

    python benchmarks/global_update.py [--sizes 100 250 500 1000] [--c1 1e-5 1e-4 1e-3 1e-2] \
        [--updates 20] [--repeat 3]

A vehicle mows a grid of N landmarks with the exact compressed filter. From there on it drives the
way again with each c1, each on a copy of the same state, until so many global updates are done.
Processor time of these, the least of the repetitions; ratios are to the exact update of the same
call. `left alone`: mean share of the passive covariance that was not evaluated (P22, eqs. 21 to
23). `sparing`: share of the updates that spared any; the others were exact, which is cheaper where
little can be spared. `variance`: the largest variance over the exact filter's at the end.

The second table: the change of the covariance alone, of a map with an area of 100 landmarks, all of
it in one product as in the exact update, and in strips against the share of the passive states that
is spared, scattered over the map. One thread.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import copy
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ekf_reference.association.known import KnownAssociation
from ekf_reference.core.ekf import Stabilisation
from ekf_reference.core.geometry import wrap_angle
from ekf_reference.core.state import subtract
from ekf_reference.filters.compressed import CompressedEkf, CompressedState, LocalAreas
from ekf_reference.models.motion import UnicycleModel

Array = NDArray[np.float64]

SPACING_M, LANE_M, STEP_M, RANGE_M = 12.0, 24.0, 2.0, 20.0
AREAS = LocalAreas(half_m=25.0, reach_m=RANGE_M)
SIGMA = (0.15, 0.02)
CONTROL = np.diag((0.05**2, 0.01**2))


class Timed(CompressedState):
    """Adds up the processor time of its global updates."""

    spent_s = 0.0

    def _global_update(self) -> None:
        start = time.process_time()
        super()._global_update()
        self.spent_s += time.process_time() - start


@dataclass
class Mower:
    """A filter on its way through a grid of landmarks (N, 2), from one turn (T, 2) to the next."""

    ekf: CompressedEkf
    landmark: Array
    turn: Array
    true: Array
    rng: np.random.Generator

    @classmethod
    def of(cls, count: int) -> Mower:
        """At the first corner of a square grid."""
        side = int(np.ceil(np.sqrt(count)))
        grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
        width, lanes = SPACING_M * side, np.arange(0.0, SPACING_M * side, LANE_M)
        turn = [(x, y) for k, y in enumerate(lanes) for x in ((0.0, width), (width, 0.0))[k % 2]]
        prior = np.zeros(3), np.diag((1e-4, 1e-4, 1e-6))
        ekf = CompressedEkf(
            UnicycleModel(), KnownAssociation(), *prior, Stabilisation(1e-6, 1e-8), areas=AREAS
        )
        ekf.state = Timed(*prior, AREAS)
        landmark: Array = np.asarray(SPACING_M * (grid[:count] + 0.5), dtype=np.float64)
        return cls(ekf, landmark, np.array(turn), np.zeros(3), np.random.default_rng(0))

    def drive(self, updates: int | None = None) -> None:
        """Go all the way, or until so many more global updates are done; then turn the way back."""
        state = self.ekf.state
        done = len(state.updates)
        for goal in self.turn[1:]:
            while np.hypot(*(goal - self.true[:2])) > STEP_M:
                if updates is not None and len(state.updates) >= done + updates:
                    return
                self._step(goal)
        self.turn = self.turn[::-1]

    def _step(self, goal: Array) -> None:
        east, north = goal - self.true[:2]
        turn = float(wrap_angle(np.arctan2(north, east) - self.true[2]))
        self.true = self.ekf.motion.step(self.true, np.array((STEP_M, turn)), 1.0)[0]
        control = (STEP_M, turn) + np.sqrt(np.diag(CONTROL)) * self.rng.standard_normal(2)
        self.ekf.predict(control, CONTROL, 1.0)
        offset = self.landmark - self.true[:2]
        near = np.flatnonzero(np.hypot(*offset.T) < RANGE_M)
        bearing = wrap_angle(np.arctan2(offset[near, 1], offset[near, 0]) - self.true[2])
        z = np.column_stack((np.hypot(*offset[near].T), bearing))
        z += SIGMA * self.rng.standard_normal(z.shape)
        self.ekf.observe(z, np.tile(SIGMA, (len(near), 1)), near)


@dataclass(frozen=True)
class Measured:
    """spent_ms: of a global update. sparing, alone: mean shares. variance: (n,) at the end."""

    spent_ms: float
    sparing: float
    alone: float
    variance: Array


def measure(mower: Mower, c1: float, updates: int) -> Measured:
    """Drive a copy on with a c1, until so many global updates are done."""
    own = copy.deepcopy(mower)
    state = own.ekf.state
    assert isinstance(state, Timed)
    state.areas, state.spent_s, first = replace(AREAS, least_gain=c1), 0.0, len(state.updates)
    own.drive(updates)
    done = [one for one in state.updates[first:] if one.passive]
    spent = 1e3 * state.spent_s / max(len(done), 1)
    return Measured(
        spent,
        float(np.mean([one.spared > 0 for one in done])),
        float(np.mean([one.saved for one in done])),
        state.covariance.diagonal().copy(),
    )


def strips_ms(size: int, share: float) -> tuple[float, float]:
    """Least milliseconds to change all of a covariance (size, size), and what is not spared."""
    rng, active = np.random.default_rng(0), 203
    p, root = np.zeros((2 * size, 2 * size)), rng.standard_normal((size, active))
    pairs = rng.permutation((size - active) // 2)[: int(share * (size - active) / 2)]
    spared = np.sort((active + 2 * pairs[:, None] + (0, 1)).ravel())
    changed = np.setdiff1d(np.arange(active, size), spared)
    whole, parts = [], []
    for _ in range(5):
        start = time.process_time()
        p[:size, :size] -= root @ root.T
        middle = time.process_time()
        subtract(p, root, changed, spared)
        whole.append(middle - start)
        parts.append(time.process_time() - middle)
    return 1e3 * min(whole), 1e3 * min(parts)


def main() -> None:
    """Measure, print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 250, 500, 1000])
    parser.add_argument("--c1", type=float, nargs="+", default=[1e-5, 1e-4, 1e-3, 1e-2])
    parser.add_argument("--shares", type=float, nargs="+", default=[0.0, 0.2, 0.4, 0.7, 0.9, 1.0])
    parser.add_argument("--updates", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=3)
    choices = parser.parse_args()
    print("landmarks  c1          ms  of exact  left alone  sparing  variance")
    for count in choices.sizes:
        mower = Mower.of(count)
        mower.drive()
        found: dict[float, Measured] = {}
        for _ in range(choices.repeat):
            for c1 in (0.0, *choices.c1):
                one = measure(mower, c1, choices.updates)
                if c1 not in found or one.spent_ms < found[c1].spent_ms:
                    found[c1] = one
        exact = found[0.0]
        for c1, one in found.items():
            print(
                f"{count:9d}  {c1:<7.0e} {one.spent_ms:6.1f}  {one.spent_ms / exact.spent_ms:8.2f}"
                f"  {one.alone:10.2f}  {one.sparing:7.2f}  "
                f"{(one.variance / exact.variance).max():8.4f}"
            )
    print("\nstates  whole ms  in strips, by share spared: over the whole")
    for size in (2 * count for count in choices.sizes if count > 200):
        times = [strips_ms(size, share) for share in choices.shares]
        ratios = "  ".join(
            f"{share:g}: {parts / whole:.2f}"
            for share, (whole, parts) in zip(choices.shares, times, strict=True)
        )
        print(f"{size:6d}  {times[0][0]:8.1f}  {ratios}")


if __name__ == "__main__":
    main()
