"""The event smoother against the joint Gaussian of all independent noises, conditioned at once."""

import numpy as np
import pytest

from graphslam import event_smoother
from graphslam.arrays import Array
from graphslam.event_smoother import EventSmoother

TOLERANCE = 1e-9
DIMS = {"p": 3, "v": 2, "b": 1}


class Everything:
    """Every block is a matrix on all unit noises that there ever were; nothing is marginalised."""

    def __init__(self, covariance: Array) -> None:
        self.noises = 0
        self.blocks: dict[str, Array] = {}
        root = self._noise(covariance)
        start = 0
        for name, dim in DIMS.items():
            self.blocks[name] = root[start : start + dim]
            start += dim
        self.moved = {name: np.zeros(dim) for name, dim in DIMS.items()}
        self.rows: list[Array] = []
        self.right: list[Array] = []

    def _noise(self, covariance: Array) -> Array:
        """A root of a covariance on new noises."""
        values, axes = np.linalg.eigh(covariance)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        before, self.noises = self.noises, self.noises + len(root)
        return np.hstack((np.zeros((len(root), before)), root))

    def stacked(self, blocks: tuple[str, ...]) -> Array:
        return np.vstack([self._padded(self.blocks[name]) for name in blocks])

    def _padded(self, m: Array) -> Array:
        return np.hstack((m, np.zeros((len(m), self.noises - m.shape[1]))))

    def set(self, names: tuple[str, ...], value: Array, moved: Array, dims: list[int]) -> None:
        start = 0
        for name, dim in zip(names, dims, strict=True):
            self.blocks[name] = value[start : start + dim]
            self.moved[name] = moved[start : start + dim]
            start += dim

    def predict(self, blocks: tuple[str, ...], f: Array, q: Array | None) -> None:
        moved = f @ np.concatenate([self.moved[b] for b in blocks])
        value = f @ self.stacked(blocks)
        if q is not None:
            noise = self._noise(q)
            value = self._padded(value) + noise
        self.set(blocks, value, moved, [len(self.moved[b]) for b in blocks])

    def measure(self, blocks: tuple[str, ...], h: Array, r: Array, residual: Array) -> None:
        moved = np.concatenate([self.moved[b] for b in blocks])
        weight = np.linalg.inv(np.linalg.cholesky(r))
        self.rows.append(weight @ h @ self.stacked(blocks))
        self.right.append(weight @ (residual - h @ moved))

    def marginal(self, blocks: tuple[str, ...]) -> tuple[Array, Array]:
        rows = [self._padded(row) for row in self.rows]
        a = np.vstack([np.eye(self.noises), *rows])
        b = np.concatenate([np.zeros(self.noises), *self.right])
        q, r = np.linalg.qr(a)
        mean = np.linalg.solve(r, q.T @ b)
        root = self.stacked(blocks) @ np.linalg.inv(r)
        moved = np.concatenate([self.moved[name] for name in blocks])
        return moved + self.stacked(blocks) @ mean, root @ root.T


def covariance(rng: np.random.Generator, n: int, rank: int) -> Array:
    root = rng.standard_normal((n, rank))
    return 0.1 * root @ root.T


def drive(seed: int, rank: int, often: float) -> float:
    """The largest difference of mean and covariance, in sigmas, over a random course of events."""
    rng = np.random.default_rng(seed)
    prior = covariance(rng, 6, min(rank + 3, 6))
    smoother = EventSmoother(tuple(DIMS), tuple(DIMS.values()), prior)
    oracle, names, worst = Everything(prior), list(DIMS), 0.0
    for number in range(70):
        kind = rng.choice(
            ["predict", "measure", "clone", "augment", "remove", "reset", "correct"],
            p=[0.3, 0.3, 0.08, 0.08, 0.08, 0.06, 0.1],
        )
        some = tuple(rng.permutation([n for n in names if rng.random() < 0.6] or names[:1]))
        dims = [len(oracle.moved[name]) for name in some]
        n = sum(dims)
        if kind in ("predict", "reset"):
            f = np.eye(n) + 0.2 * rng.standard_normal((n, n))
            q = None if kind == "reset" else covariance(rng, n, min(rank, n))
            smoother.predict(some, f, q)
            oracle.predict(some, f, q)
        elif kind == "measure":
            h, r = rng.standard_normal((2, n)), np.array([[0.5, 0.1], [0.1, 0.3]])
            residual = rng.standard_normal(2)
            smoother.measure(some, h, r, residual)
            oracle.measure(some, h, r, residual)
        elif kind == "clone":
            new = f"clone {number}"
            smoother.clone(some[0], new)
            oracle.blocks[new], oracle.moved[new] = oracle.blocks[some[0]], oracle.moved[some[0]]
            names.append(new)
        elif kind == "augment":
            new, g, noise = f"new {number}", rng.standard_normal((2, n)), covariance(rng, 2, 1)
            smoother.augment(new, some, g, noise)
            value = g @ oracle.stacked(some)
            moved = g @ np.concatenate([oracle.moved[b] for b in some])
            root = oracle._noise(noise)
            oracle.set((new,), oracle._padded(value) + root, moved, [2])
            names.append(new)
        elif kind == "remove" and len(names) > 4:
            smoother.remove((names.pop(4),))
        elif kind == "correct":
            step = rng.standard_normal(sum(len(oracle.moved[name]) for name in names))
            smoother.correct(step)
            start = 0
            for name in names:
                dim = len(oracle.moved[name])
                oracle.moved[name] = oracle.moved[name] - step[start : start + dim]
                start += dim
        if rng.random() < often or number == 69:
            mean, p = oracle.marginal(tuple(names))
            found = smoother.marginal()
            sigma = np.sqrt(np.diag(p)) + 1e-6
            worst = max(
                worst,
                float(np.abs((found.mean - mean) / sigma).max()),
                float(np.abs((found.covariance - p) / np.outer(sigma, sigma)).max()),
            )
    return worst


@pytest.mark.parametrize("rank", [6, 2, 1])
@pytest.mark.parametrize("often", [0.0, 0.1, 1.0])
def test_any_course_of_events_is_the_joint_gaussian_conditioned(rank: int, often: float) -> None:
    assert drive(seed=rank, rank=rank, often=often) < TOLERANCE


def test_small_pieces_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_smoother, "MOST_NUMBERS", 50)
    assert drive(seed=3, rank=6, often=0.05) < TOLERANCE


def test_a_smoother_that_forgets_what_it_eliminates_is_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A piece that goes on with its covariance, but not with its mean."""
    whole = EventSmoother._posterior

    def forgetful(self: EventSmoother, kept: list[int]) -> tuple[Array, Array]:
        root, mean = whole(self, kept)
        return root, 0.0 * mean

    monkeypatch.setattr(EventSmoother, "_posterior", forgetful)
    assert drive(seed=3, rank=6, often=0.05) > 1e-3


def test_a_known_start_and_noise_of_rank_one() -> None:
    """A prior without variance, and a unicycle whose noise has fewer numbers than its pose."""
    smoother = EventSmoother(("pose",), (3,), np.zeros((3, 3)))
    found = smoother.marginal()
    np.testing.assert_array_equal(found.covariance, np.zeros((3, 3)))
    g = np.array([[1.0], [0.5], [0.1]])
    smoother.predict(("pose",), np.eye(3), g @ g.T)
    np.testing.assert_allclose(smoother.marginal().covariance, g @ g.T, rtol=1e-12)
    assert np.linalg.matrix_rank(smoother.marginal().covariance, tol=1e-9) == 1


def test_links_are_the_backward_pass_of_a_smoother() -> None:
    """Rauch, Tung and Striebel over the links equals the estimate of a clone kept to the end."""
    rng = np.random.default_rng(1)
    names = ("x",)
    prior = covariance(rng, 2, 2) + np.eye(2)
    smoother, keeper = (EventSmoother(names, (2,), prior) for _ in range(2))
    filtered, links, f = [], [], np.array([[1.0, 0.3], [0.0, 1.0]])
    for k in range(6):
        for one in (smoother, keeper):
            one.predict(names, f, 0.05 * np.eye(2))
            one.measure(names, np.eye(2)[:1], np.eye(1), np.array([0.3 * k]))
        filtered.append(smoother.marginal())
        links.append(smoother.anchor())
        if k == 2:
            keeper.clone("x", "then")
    assert links[0] is None
    mean, p = filtered[-1].mean, filtered[-1].covariance
    for k in (4, 3, 2):
        link = links[k + 1]
        assert link is not None
        mean = link.mean_then + link.gain @ (mean - link.mean_now)
        p = link.covariance + link.gain @ p @ link.gain.T
    kept = keeper.marginal()
    np.testing.assert_allclose(mean, kept.mean[2:], atol=1e-12)
    np.testing.assert_allclose(p, kept.covariance[2:, 2:], atol=1e-12)
    assert np.abs(p - filtered[2].covariance).max() > 1e-3


@pytest.mark.parametrize("others", [1, 2, 3, 5])
def test_a_jacobian_may_be_as_wide_as_the_state(others: int) -> None:
    """Zeros for what is not measured: the same as without these blocks."""
    smoothers = []
    for whole in (True, False):
        smoother = EventSmoother(("p",), (3,), np.eye(3))
        names = [f"landmark {i}" for i in range(others)]
        for name in names:
            smoother.augment(name, ("p",), np.eye(3)[:2], 0.5 * np.eye(2))
        h = np.hstack((-np.eye(3)[:2], np.eye(2)))
        if whole:
            h = np.hstack((h, np.zeros((2, 2 * (others - 1)))))
        blocks = ("p", *names) if whole else ("p", names[0])
        smoother.measure(blocks, h, np.eye(2), np.array([0.1, -0.2]))
        smoothers.append(smoother.marginal())
    whole_state, own_blocks = smoothers
    assert np.abs(whole_state.mean - own_blocks.mean).max() < 1e-12
    assert np.abs(whole_state.covariance - own_blocks.covariance).max() < 1e-12


@pytest.mark.parametrize("rank", [0, 1])
@pytest.mark.parametrize("anchored", [False, True])
def test_a_perfect_measurement_is_what_a_precise_one_tends_to(rank: int, anchored: bool) -> None:
    """R of no rank, or of one of two directions: mean and covariance by the Kalman update."""
    rng = np.random.default_rng(4)
    half = rng.standard_normal((4, 4))
    p, h = half @ half.T, rng.standard_normal((2, 3))
    g = rng.standard_normal((2, rank))
    r, residual = g @ g.T, rng.standard_normal(2)
    smoother = EventSmoother(("a", "b"), (1, 3), p)
    if anchored:
        smoother.marginal()
        smoother.anchor()
    smoother.measure(("b",), h, r, residual)
    whole = np.hstack((np.zeros((2, 1)), h))
    gain = p @ whole.T @ np.linalg.inv(whole @ p @ whole.T + r)
    found = smoother.marginal()
    np.testing.assert_allclose(found.mean, gain @ residual, atol=1e-10)
    np.testing.assert_allclose(found.covariance, p - gain @ whole @ p, atol=1e-10)
    if anchored:
        link = smoother.anchor()
        assert link is not None
        np.testing.assert_allclose(link.mean_then, gain @ residual, atol=1e-10)


def test_what_is_known_already_is_not_measured_again() -> None:
    """The same perfect measurement twice: the second says nothing, not even by rounding."""
    smoother = EventSmoother(("a",), (2,), np.eye(2))
    for _ in range(2):
        smoother.measure(("a",), np.array([[1.0, 0.5]]), np.zeros((1, 1)), np.array([0.3]))
    found = smoother.marginal()
    expected = np.eye(2) - np.outer([1.0, 0.5], [1.0, 0.5]) / 1.25
    np.testing.assert_allclose(found.covariance, expected, atol=1e-12)
