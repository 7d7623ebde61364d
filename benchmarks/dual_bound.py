"""How near a dual bound comes to the lowest error found: can an optimum be certified?

    python benchmarks/dual_bound.py [LOG ...]

Each log's problem is bounded from below by one that is isotropic and chordal: a motion weighs no
more than in its least certain direction, a range and bearing no more than their circle allows
(the distance of two points is at most the range's error plus range times the bearing's), a heading
by its chord. Headings z, complex of length one, are what is left when places are eliminated:
error >= z^H M z / 2. The Lagrangian dual (Carlone et al. 2016, Rosen et al. 2019 in the plane)
takes lambda = Re(conj(z) M z) from a minimum of that problem; where M - diag(lambda) has no
negative eigenvalue, this minimum is the global one and the bound is tight for the lower problem.
`share` is the bound over the lowest error found. Only logs of motions, measurements and a prior.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from many_basins import CLASSES  # type: ignore[import-not-found]
from numpy.typing import NDArray
from scipy.linalg import eigh, eigvalsh
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from comparisons.logs.bundled import open_log
from comparisons.pipeline.solve import solve
from graphslam.problem import SlamProblem
from graphslam.smoother import smooth

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def weights(covariance: Array) -> tuple[Array, Array]:
    """(N,) roots of weights of place and heading that bound the information of (N, 3, 3) below."""
    place = 1.0 / np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    heading = 1.0 / covariance[:, 2, 2]
    bound = np.array([np.diag((p, p, h)) for p, h in zip(place, heading, strict=True)])
    share = np.array(
        [
            eigh(np.linalg.inv(c), b, eigvals_only=True)[0]
            for c, b in zip(covariance, bound, strict=True)
        ]
    )
    return np.sqrt(share * place), np.sqrt(share * heading)


def equations(problem: SlamProblem) -> tuple[csc_matrix, int]:
    """Whitened complex rows over headings, a reference of one, places and landmarks."""
    k, landmarks = problem.pose_count, problem.landmark_count
    reference, places, points = k, k + 1, 2 * k + 1
    entries: list[tuple[int, int, complex]] = []
    count = 0

    def add(weight: float, *terms: tuple[int, complex]) -> None:
        nonlocal count
        entries.extend((count, column, weight * value) for column, value in terms)
        count += 1

    place, heading = weights(problem.increment_covariance)
    for i, (forward, left, turn) in enumerate(problem.increment.tolist()):
        add(heading[i], (i + 1, 1.0), (i, -np.exp(1j * turn)))
        add(place[i], (places + i + 1, 1.0), (places + i, -1.0), (i, -complex(forward, left)))
    (prior_place,), (prior_heading,) = weights(problem.prior_covariance[None])
    x, y, angle = problem.prior_pose.tolist()
    add(prior_heading, (0, 1.0), (reference, -np.exp(1j * angle)))
    add(prior_place, (places, 1.0), (reference, -complex(x, y)))
    for i, (r, bearing) in enumerate(problem.z.tolist()):
        sigma = float(np.hypot(problem.sigma[i, 0], r * problem.sigma[i, 1]))
        pose, landmark = int(problem.measurement_pose[i]), int(problem.measurement_landmark[i])
        add(
            1.0 / sigma,
            (points + landmark, 1.0),
            (places + pose, -1.0),
            (pose, -r * np.exp(1j * bearing)),
        )
    rows, columns, values = zip(*entries, strict=True)
    shape = (count, 2 * k + 1 + landmarks)
    return coo_matrix((values, (rows, columns)), shape).tocsc(), k + 1


def reduced(problem: SlamProblem) -> Complex:
    """M, (K + 1, K + 1) Hermitian: the headings' problem when places are eliminated."""
    system, headings = equations(problem)
    turned, placed = system[:, :headings], system[:, headings:]
    cross = (placed.conj().T @ turned).toarray()
    solved = splu((placed.conj().T @ placed).tocsc()).solve(cross)
    matrix: Complex = (turned.conj().T @ turned).toarray() - cross.conj().T @ solved
    return 0.5 * (matrix + matrix.conj().T)


def settle(matrix: Complex, z: Complex, sweeps: int = 300) -> Complex:
    """A minimum of z^H M z near z: each heading in turn points where the others ask it to."""
    z = z.copy()
    for _ in range(sweeps):
        before = z.copy()
        for i in range(len(z)):
            pull = matrix[i, i] * z[i] - matrix[i] @ z
            z[i] = pull / max(abs(pull), 1e-300)
        if np.abs(z - before).max() < 1e-10:
            break
    return z


def bound(problem: SlamProblem, heading: Array) -> tuple[float, float]:
    """The dual bound of the error, and the same without the correction by the least eigenvalue."""
    matrix = reduced(problem)
    z = settle(matrix, np.append(np.exp(1j * heading), 1.0))
    multiplier = np.real(z.conj() * (matrix @ z))
    least = float(eigvalsh(matrix - np.diag(multiplier), subset_by_index=(0, 0))[0])
    primal = float(multiplier.sum())
    return 0.5 * (primal + len(z) * min(0.0, least)), 0.5 * primal


def main() -> None:
    """Print a line for each log."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_AS_WRITTEN)
    parser.add_argument("logs", nargs="*", default=["simulated-loop"])
    given = parser.parse_args()
    print(f"{'log':<24} {'poses':>6} {'lowest':>10} {'bound':>10} {'share':>6} {'lower min':>10}")
    problems = {name: solve(open_log(name)).result.problem for name in given.logs}
    for make in CLASSES.values():
        problems |= {world.name: world.problem for world in map(make, range(3))}
    for name, problem in problems.items():
        result = smooth(problem, {})
        below, primal = bound(problem, result.poses[:, 2])
        print(
            f"{name:<24} {problem.pose_count:>6} {result.error:>10.2f} {below:>10.2f} "
            f"{below / result.error:>6.2f} {primal:>10.2f}",
            flush=True,
        )


_AS_WRITTEN = argparse.RawDescriptionHelpFormatter

if __name__ == "__main__":
    main()
