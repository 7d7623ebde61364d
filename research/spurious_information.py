"""What variants of the EKF learn of a heading that nothing measures, beside their consistency.

    python -m research.spurious_information [--runs 20] [--steps 2500]

Every variant goes through the same simulated runs of `slamcheck montecarlo circle`. The
spurious information is that of comparisons.audit.spurious, by the events that the filter itself
records. Beside it: the mean NEES of heading and pose over the runs (1 and 3 are right), each
averaged over the steps since the row before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comparisons.audit.replay import Replay
from comparisons.audit.spurious import Learnt, SpuriousInformation
from comparisons.experiments.montecarlo.runs import FILTERS
from comparisons.experiments.scenarios.scenario import read_scenario
from comparisons.experiments.scenarios.world import ScenarioWorld, build_world, measure
from comparisons.experiments.variants.batch_ekf import BatchEkf, BatchInvariantEkf
from comparisons.trace.events import Directions, Event, TracePrior
from ekf_reference.core.geometry import wrap_angle
from research.recorded_batch import record
from research.script import options, present, print_head, print_row

ROWS = (100, 500, 1000, 2500)
HEADING = 2
Array = NDArray[np.float64]


class Follower:
    """Follows the events of one run."""

    def __init__(self) -> None:
        """Wait for the prior."""
        self._replay: Replay | None = None
        self._found: SpuriousInformation | None = None

    def take(self, event: Event) -> None:
        """Take the next event."""
        if isinstance(event, TracePrior):
            self._replay = Replay(event)
        elif isinstance(event, Directions) and self._replay is not None:
            self._found = SpuriousInformation(event, self._replay)
        elif self._found is not None:
            self._found.take(event)

    def learnt(self) -> Learnt:
        """Return what the run has learnt so far."""
        return present(self._found).result()


class VariantMeans(NamedTuple):
    """Of one variant over the steps (T,), the mean over the runs.

    information [1/rad^2] of the heading, zero where all is rounding. rounding: what there is of it
    at the end, however little, the most of all runs. heading and pose: NEES.
    """

    information: Array
    rounding: float
    heading: Array
    pose: Array


def measured(name: str, world: ScenarioWorld, runs: int) -> VariantMeans:
    """Run one variant over all runs."""
    data = measure(world, range(runs))
    filter_ = FILTERS[name](world, runs)
    assert isinstance(filter_, BatchEkf | BatchInvariantEkf)
    followers = [Follower() for _ in range(runs)]
    record(filter_, len(world.landmark), {run: one.take for run, one in enumerate(followers)})
    steps = len(world.seen)
    heading, pose = np.empty(steps), np.empty(steps)
    for k, seen in enumerate(world.seen):
        filter_.predict(data.control[:, k])
        if len(seen):
            filter_.observe(data.z[k], world.sigma[k], seen)
        truth, state = world.pose[k + 1], filter_.state
        error, covariance = state.pose_error(truth)
        pose[k] = np.einsum("bi,bij,bj->b", error, np.linalg.inv(covariance), error).mean()
        turned = wrap_angle(truth[2] - state.pose[:, 2])
        heading[k] = (turned**2 / state.pose_covariance()[:, 2, 2]).mean()
    learnt = [one.learnt() for one in followers]
    information = np.mean([_at_steps(one, steps) for one in learnt], axis=0)
    most = max(float(one.information[HEADING, HEADING]) for one in learnt)
    return VariantMeans(information, most, heading, pose)


def _at_steps(found: Learnt, steps: int) -> Array:
    """Information about the heading after each step (T,)."""
    at = np.searchsorted(found.time_s, np.arange(1, steps + 1), side="right") - 1
    result: Array = found.growth[at, HEADING]
    return result


def print_table(by_variant: dict[str, VariantMeans], steps: int) -> None:
    """A row for each variant and step."""
    titles = ("information [1/rad^2]", "sigma [deg]", "NEES heading", "NEES pose")
    print_head("filter", "step", *titles)
    rows = [row for row in ROWS if row < steps] + [steps]
    for name, one in by_variant.items():
        for begin, end in zip([0, *rows[:-1]], rows, strict=True):
            told = one.information[end - 1]
            sigma = f"{np.degrees(told**-0.5):.2f}" if told > 0.0 else "none"
            amount = f"{told:.4g}" if told > 0.0 else f"0 (rounding, {one.rounding:.0e} at the end)"
            nees = (f"{each[begin:end].mean():.2f}" for each in (one.heading, one.pose))
            print_row(name, end, amount, sigma, *nees)


def main() -> None:
    """Measure all variants and print a table."""
    asked, scenario = options(__doc__, runs=20, steps=int), read_scenario("circle")
    if asked.steps is not None:
        scenario = scenario.model_copy(update={"steps": asked.steps})
    world = build_world(scenario)
    by_variant = {name: measured(name, world, asked.runs) for name in FILTERS}
    print_table(by_variant, scenario.steps)


if __name__ == "__main__":
    main()
