"""What the smoother's own association costs, by part, and whether a full solve decides alike.

    python benchmarks/own_association.py [LOG ...] [--robot N] [--full] [--check]

Seconds of processor time by part; landmarks; measurements left out. --full: the same with
everything solved anew after each piece until it converges, as before, and how the two partitions
compare: by pairs of measurements, and how many measurements go to another landmark. Where the log
has labels, also both partitions against these. --check: seconds of each variant of the association
that `solve` compares it with. Logs: names or folders; by default a simulated one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import gtsam
import numpy as np

from comparisons.adapters.smoother_association import OwnAssociator
from comparisons.adapters.smoother_input import position_rows
from comparisons.arrays import Array, Index
from comparisons.checks.association import (
    compare_partitions,
    counterparts,
    differing_measurements,
)
from comparisons.config import EkfConfig, SolveConfig
from comparisons.logs.bundled import open_log
from comparisons.logs.log import NO_LANDMARK, Log
from comparisons.pipeline.prepare import Required, no_progress, prepare
from graphslam import association
from graphslam.association_variants import associate_by, variants
from graphslam.graph_builder import POSE_KEY
from graphslam.growing_smoother import GrowingSmoother
from graphslam.increments import dead_reckoned
from graphslam.marginals import joint_marginal
from graphslam.optimisers import levenberg_marquardt
from graphslam.problem import SlamProblem

PARTS = {
    "judging": (association, "_see"),
    "solving": (GrowingSmoother, "extend"),
    "covariance": (GrowingSmoother, "joint_covariance"),
    "new landmarks": (association, "_promote"),
    "end": (association, "_finish"),
}
"""The end judges all measurements again by the map; it has a little of the covariance's time."""


class FullSmoother(GrowingSmoother):
    """Everything anew after each piece, to convergence."""

    def extend(self, factors: Sequence[gtsam.NonlinearFactor], start: gtsam.Values) -> None:
        """By Levenberg-Marquardt over all factors."""
        for factor in factors:
            self._graph.push_back(factor)
        self.values.insert(start)
        self.values, *_ = levenberg_marquardt(self._graph, self.values, 1e-10)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """By elimination of all other variables."""
        size = sum(3 if key >= POSE_KEY else 2 for key in keys)
        return joint_marginal(self._graph.linearize(self.values), keys, size).covariance


def timed(spent: dict[str, float], name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that adds its processor time to an entry."""

    def measured(*given: Any) -> Any:
        begin = time.process_time()
        result = function(*given)
        spent[name] += time.process_time() - begin
        return result

    return measured


def unlabelled(log: Log) -> tuple[SlamProblem, Index]:
    """The problem that `solve --association own` decides on, and the labels (M,)."""
    config, ekf = SolveConfig(association="own"), EkfConfig(association="nn")
    ready = prepare(log, config, ekf, no_progress, Required(None, None))
    associator = OwnAssociator(
        ready.log, ready.timeline, position_rows(ready.timeline, ready.positions)
    )
    return associator.problem, ready.log.measurements.landmark[associator.open_rows]


def associated(name: str, problem: SlamProblem) -> Index:
    """Associate and print the cost. Returns the landmark index (M,)."""
    spent = dict.fromkeys(PARTS, 0.0)
    with ExitStack() as stack:
        for part, (module, function) in PARTS.items():
            owner = vars(association)["GrowingSmoother"] if module is GrowingSmoother else module
            original = getattr(owner, function)
            stack.enter_context(patch.object(owner, function, timed(spent, part, original)))
        begin = time.process_time()
        found = association.associate(problem)
        spent["all"] = time.process_time() - begin
    seconds = ", ".join(f"{part} {s:.2f}" for part, s in spent.items())
    left_out = int(np.count_nonzero(found.landmark_index < 0))
    print(f"{name}: {found.landmark_count} landmarks, {left_out} left out; seconds: {seconds}")
    return found.landmark_index


def show_agreement(name: str, first: Index, second: Index) -> None:
    """Print how two partitions (M,) of the measurements compare."""
    pairs = compare_partitions(first, second)
    ours, theirs = counterparts(first, second)
    matched = np.full(int(second.max(initial=-1)) + 1, -1, dtype=np.intp)
    matched[theirs] = ours
    different = differing_measurements(first, second, matched)
    both = int(np.count_nonzero((first[different] >= 0) & (second[different] >= 0)))
    print(
        f"{name}: {pairs.pairs_both} pairs in both, {pairs.pairs_first} and {pairs.pairs_second} "
        f"in one; {both} measurements at other landmarks, {pairs.only_first} and "
        f"{pairs.only_second} used by one"
    )


def main() -> None:
    """Print all that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", default=["simulated-loop"], metavar="LOG")
    parser.add_argument("--robot", type=int)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--check", action="store_true")
    choices = parser.parse_args()
    robot = {} if choices.robot is None else {"robot": choices.robot}
    for name in choices.logs:
        problem, labels = unlabelled(open_log(name, **robot))
        print(f"{name}: {problem.pose_count} poses, {len(problem.z)} measurements")
        own = associated("own", problem)
        label = np.unique(labels, return_inverse=True)[1].astype(np.intp)
        labelled = len(labels) > 0 and bool((labels != NO_LANDMARK).all())
        if labelled:
            show_agreement("own and labels", own, label)
        if choices.full:
            with patch.object(association, "GrowingSmoother", FullSmoother):
                full = associated("full", problem)
            show_agreement("own and full", own, full)
            if labelled:
                show_agreement("full and labels", full, label)
        if choices.check:
            last = dead_reckoned(problem.prior_pose, problem.increment)[-1]
            for variant in variants():
                begin = time.process_time()
                found = associate_by(problem, variant, last)
                spent = time.process_time() - begin
                print(f"{variant.name}: {found.landmark_count} landmarks, {spent:.2f} s")


if __name__ == "__main__":
    main()
