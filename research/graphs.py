"""Public planar graphs of poses: our optimum against the best of ten of gtsam's starts.

    python -m research.graphs FOLDER [--starts 10]

gtsam reads the file itself. Its starts: the file's vertices or the edges in a row, its linear
approximation (LAGO, for diagonal noise), then that one with headings disturbed by 0.1, 0.2, ...
rad; each is followed by its Levenberg-Marquardt. Our poses are judged by gtsam's graph. `SE-Sync`
is the cost of that program (chordal, isotropic noise) where descent from our poses leads, to be
held against its published one.
`times`: processor time of our search and its evidence over the median of
gtsam's descents.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve

from comparisons.arrays import Array
from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from research.script import options, print_head, print_row
from research.timing import timed

_DISTURBED = 0.1
_AS_GOOD = 1e-6
_ROUNDS = 12
_SUFFIXES = (".g2o", ".graph", ".txt")


class GraphOutcome(NamedTuple):
    """Of one graph. ours, theirs: errors by gtsam's graph, half of chi-square."""

    name: str
    poses: int
    edges: int
    ours: float
    theirs: float
    chordal: float
    verdict: str
    ours_s: float
    theirs_s: float

    @property
    def as_good(self) -> bool:
        """No start of gtsam's ends below ours."""
        return self.ours <= self.theirs * (1.0 + _AS_GOOD) + 1e-9


def measured(path: Path, starts: int) -> GraphOutcome:
    """Solve a graph both ways."""
    graph, given = (gtsam.readG2o if path.suffix == ".g2o" else gtsam.load2D)(str(path))
    count = graph.nrFactors()
    solution, ours_s = timed(solve, open_log(str(path)))
    poses = solution.result.poses
    ours = float(graph.error(values_of(poses)))
    chordal = se_sync_cost(graph, poses)
    sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-3))
    graph.add(gtsam.PriorFactorPose2(0, given.atPose2(0), sigmas))
    ends, taken_s = [], []
    for start in beginnings(graph, given, starts):
        with suppress(RuntimeError):
            end, spent_s = timed(gtsam.LevenbergMarquardtOptimizer(graph, start).optimize)
            ends.append(float(graph.error(end)))
            taken_s.append(spent_s)
    verdict = "verified" if solution.verified else solution.lacks[0]
    sha = hashlib.sha256(path.read_bytes()).hexdigest()[:8]
    return GraphOutcome(
        f"{path.stem} ({sha})",
        len(poses),
        count,
        ours,
        min(ends),
        chordal,
        verdict,
        ours_s,
        float(np.median(taken_s)),
    )


def beginnings(
    graph: gtsam.NonlinearFactorGraph, given: gtsam.Values, starts: int
) -> Iterator[gtsam.Values]:
    """The file's, the linear approximation, and that one disturbed."""
    yield given
    try:
        linear = gtsam.lago.initialize(graph)
    except (ValueError, IndexError):  # it takes diagonal noise alone, and poses in a row
        linear = given
    yield linear
    rng = np.random.default_rng(0)
    for k in range(1, starts - 1):
        moved = gtsam.Values()
        for key in range(graph.size()):
            if not linear.exists(key):
                break
            pose = linear.atPose2(key)
            turn = pose.theta() + _DISTURBED * k * rng.standard_normal()
            moved.insert(key, gtsam.Pose2(pose.x(), pose.y(), turn))
        yield moved


def values_of(poses: Array) -> gtsam.Values:
    """Poses by their numbers."""
    values = gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, gtsam.Pose2(*pose))
    return values


def se_sync_cost(graph: gtsam.NonlinearFactorGraph, poses: Array) -> float:
    """The least sum of kappa |R_j - R_i R_ij|^2 + tau |t_j - t_i - R_i t_ij|^2 from our poses on.

    Rosen, Carlone, Bandeira and Leonard 2019. By Gauss and Newton, the first pose held.
    """
    factors: list[Any] = [graph.at(number) for number in range(graph.size())]
    i, j = np.array([factor.keys() for factor in factors]).T
    measured = [factor.measured() for factor in factors]
    z = np.array([(one.x(), one.y(), one.theta()) for one in measured])
    information = np.array([factor.noiseModel().information() for factor in factors])
    tau = np.sqrt(2.0 / np.trace(np.linalg.inv(information[:, :2, :2]), axis1=1, axis2=2))
    kappa = np.sqrt(2.0 * information[:, 2, 2])
    x, row = poses.copy(), np.arange(len(z))
    for _ in range(_ROUNDS):
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        turned = np.column_stack((c[i] * z[:, 0] - s[i] * z[:, 1], s[i] * z[:, 0] + c[i] * z[:, 1]))
        to = x[i, 2] + z[:, 2]
        off = np.column_stack(
            (
                tau[:, None] * (x[j, :2] - x[i, :2] - turned),
                kappa[:, None] * np.column_stack((c[j] - np.cos(to), s[j] - np.sin(to))),
            )
        )
        slopes = [
            (0, 3 * j, tau), (0, 3 * i, -tau), (0, 3 * i + 2, tau * turned[:, 1]),
            (1, 3 * j + 1, tau), (1, 3 * i + 1, -tau), (1, 3 * i + 2, -tau * turned[:, 0]),
            (2, 3 * j + 2, -kappa * s[j]), (2, 3 * i + 2, kappa * np.sin(to)),
            (3, 3 * j + 2, kappa * c[j]), (3, 3 * i + 2, -kappa * np.cos(to)),
        ]  # fmt: skip
        rows, columns, values = (
            np.concatenate(part)
            for part in zip(*((4 * row + k, at, slope) for k, at, slope in slopes), strict=True)
        )
        jacobian = csc_array((values, (rows, columns)), shape=(off.size, x.size))[:, 3:]
        step = spsolve(jacobian.T @ jacobian, -jacobian.T @ off.ravel())
        x[1:] += step.reshape(-1, 3)
    return float(np.sum(off**2))


def main() -> int:
    """Print the table; return 1, an exit code, where a start of gtsam's ends lower."""
    given = options(__doc__, "folder", starts=10)
    print_head(
        "graph (SHA-256)", "poses", "edges", "ours", "gtsam's best", "SE-Sync", "verdict", "times"
    )
    lost = 0
    for path in sorted(one for one in Path(given.folder).iterdir() if one.suffix in _SUFFIXES):
        one = measured(path, given.starts)
        lost |= not one.as_good
        errors = f"{one.ours:.7g}", f"{one.theirs:.7g}", f"{one.chordal:.5g}"
        times = f"{one.ours_s / one.theirs_s:.1f}"
        print_row(one.name, f"{one.poses:,}", f"{one.edges:,}", *errors, one.verdict, times)
    return int(lost)


if __name__ == "__main__":
    sys.exit(main())
