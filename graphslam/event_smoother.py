"""Any Kalman filter's recorded events as one linear least-squares problem, solved piece by piece.

The error state consists of named blocks. Each is an affine function of independent variables,
`shift + sum M_k x_k`, and every event adds variables or equations of unit covariance to a gtsam
graph. A piece ends where the marginal is asked for, or the graph has grown: gtsam eliminates by QR
what is no longer needed, and the state goes on as `mean + A s`, s ~ N(0, I), P = A A^T. So a prior
without variance, a noise of any rank and a clone are like any other, and memory is bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtrs

from graphslam.arrays import Array, Index, Marginal

MOST_NUMBERS = 4_000_000
"""In the equations of a piece."""
_MOST_KEYS = 3
"""Of a gtsam.JacobianFactor that Python makes."""
_LEAST_PIVOT = 1e-5
"""Of a noise's correlation matrix, beyond which it is used by its inverse."""
_LEAST_LEFT = 1e-7
"""Of the sigma of a component, which the others of its measurement leave."""
_NOTHING = 1e-15
"""Eigenvalue of a correlation matrix, relative to the largest."""
_LEAST = 1e-150
"""Standard deviation, below which the inverse of all may overflow: it is known."""
_KNOWN = 1e-9
"""Of a measurement without noise, relative to what cancels in it: rounding of what is known."""

Terms = dict[int, Array]
"""Matrices by the key of their variable."""
Blocks = tuple[str, ...]


class Link(NamedTuple):
    """The anchor's error given the error of the state at the end of the piece.

    mean_then + gain (e_now - mean_now), with a covariance. For the backward pass of a smoother.
    """

    gain: Array
    mean_then: Array
    mean_now: Array
    covariance: Array


class EventSmoother:
    """The posterior of the error state, by least squares over all events so far."""

    def __init__(self, blocks: Blocks, dims: Sequence[int], covariance: Array) -> None:
        """Start with blocks of some dimensions and their joint covariance (n, n)."""
        self._keys = 0
        self._state: dict[str, tuple[int, Terms]] = {}
        self._begin()
        self._shift: dict[str, Array] = {}
        root = square_root(covariance)
        key = self._variable(root.shape[1])
        self._place(blocks, dims, {key: root}, np.zeros(len(root)))
        self._anchor: tuple[Array, Terms] | None = None
        self._pending: tuple[Blocks, Array, Array] | None = None
        self._whitened: tuple[Array, Array | None] | None = None

    def predict(self, blocks: Blocks, f: Array, q: Array | None) -> None:
        """Add e' = F e + w, w ~ N(0, Q), on some blocks. q: None for none."""
        noise = np.zeros_like(f) if q is None else q
        if self._pending is not None and self._pending[0] == blocks:
            _, before, spread = self._pending
            self._pending = blocks, f @ before, f @ spread @ f.T + noise
            return
        self._flush()
        self._pending = blocks, f, noise

    def measure(self, blocks: Blocks, h: Array, r: Array, residual: Array) -> None:
        """Add residual = H e + v, v ~ N(0, R). Along what R has no variance, H e is known."""
        self._flush()
        w = self._inverse_root(r)
        if w is None:
            self._measure_exactly(blocks, h, r, residual)
            return
        self._fuse(blocks, h, w, residual)

    def _fuse(self, blocks: Blocks, h: Array, w: Array, residual: Array) -> None:
        """Add w residual = w (H e + v), of which the noise is N(0, I)."""
        rows = w @ h
        for _ in range(2):
            terms = {key: rows @ m for key, m in self._terms(blocks).items()}
            groups = [np.arange(len(w))]
            if len(terms) <= _MOST_KEYS:
                break
            groups = _rows_by_keys(terms)
            if max(len(_touched(terms, group)) for group in groups) <= _MOST_KEYS:
                break
            self._collapse()
        b = w @ (residual - h @ self._shifts(blocks))
        for group in groups:
            keys = _touched(terms, group) if len(terms) > _MOST_KEYS else terms
            self._add({key: terms[key][group] for key in keys}, b[group])

    def _measure_exactly(self, blocks: Blocks, h: Array, r: Array, residual: Array) -> None:
        """Fuse what a singular R leaves uncertain, then fix what it says exactly."""
        sigma = np.sqrt(np.maximum(r.diagonal(), 0.0))
        scale = np.where(sigma > 0.0, sigma, 1.0)
        values, axes = np.linalg.eigh(r / np.outer(scale, scale))
        some = values > _NOTHING * len(values) * max(values[-1], 0.0)
        if some.any():
            w = (axes[:, some] / np.sqrt(values[some])).T / scale
            self._fuse(blocks, h, w, residual)
        exact = axes[:, ~some].T / scale
        self._fix(blocks, exact @ h, exact @ residual)

    def _fix(self, blocks: Blocks, rows: Array, values: Array) -> None:
        """Let rows e = values: of what is uncertain, the rest of the directions goes on.

        Directions that are known already, but for rounding, are left out.
        """
        self._collapse()
        anchor = self._anchor
        names, dims = tuple(self._state), [dim for dim, _ in self._state.values()]
        (whole,), (used,) = self._terms(names).values(), self._terms(blocks).values()
        gross = np.abs(rows) @ np.abs(used).sum(axis=1)
        unit = np.where(gross > 0.0, gross, 1.0)
        left, singular, right = np.linalg.svd(rows @ used / unit[:, None])
        count = int((singular > _KNOWN).sum())
        off = (values - rows @ self._shifts(blocks)) / unit
        x = right[:count].T @ ((left.T @ off)[:count] / singular[:count])
        free, shift = right[count:].T, self._shifts(names)
        self._begin()
        new = self._variable(free.shape[1])
        if anchor is not None:
            ((_, then),) = anchor[1].items()
            self._anchor = anchor[0] + then @ x, {new: then @ free}
        self._place(names, dims, {new: whole @ free}, shift + whole @ x)

    def augment(self, name: str, blocks: Blocks, g: Array, noise: Array) -> None:
        """Add a block e_new = G e + v, v ~ N(0, noise)."""
        self._flush()
        self._set((name,), [len(g)], g, noise, blocks)

    def clone(self, source: str, name: str) -> None:
        """Add a copy of a block."""
        self._flush()
        self._state[name] = self._state[source]
        self._shift[name] = self._shift[source]

    def remove(self, blocks: Blocks) -> None:
        """Marginalise blocks out: they are eliminated with the next piece."""
        self._flush()
        for name in blocks:
            del self._state[name], self._shift[name]
        self._gathered.clear()

    def correct(self, correction: Array) -> None:
        """Move the estimate by (n,), all blocks in their order: the error becomes so much less."""
        self._flush()
        start = 0
        for name, before in self._shift.items():
            stop = start + len(before)
            self._shift[name] = before - correction[start:stop]
            start = stop

    def marginal(self) -> Marginal:
        """Return mean and covariance of all blocks in their order, and begin a new piece."""
        self._flush()
        root = self._collapse()
        return Marginal(self._shifts(tuple(self._state)), root @ root.T)

    def anchor(self) -> Link | None:
        """Keep the state as it is now for a smoother; return the link of the one kept before.

        Only directly after `marginal`.
        """
        state = self._terms(tuple(self._state))
        shift, link = self._shifts(tuple(self._state)), None
        if self._anchor is not None:
            mean, terms = self._anchor
            ((key, now),) = state.items()
            then = terms[key]
            gain = np.zeros((len(then), len(now)))
            if np.abs(now).max(initial=0.0) > _LEAST:
                gain = then @ np.linalg.pinv(now, rcond=1e-12)
            left = then - gain @ now
            link = Link(gain, mean, shift, left @ left.T)
        self._anchor = shift, state
        return link

    def _begin(self) -> None:
        self._graph = gtsam.GaussianFactorGraph()
        self._dims: dict[int, int] = {}
        self._numbers = 0
        self._gathered: dict[Blocks, Terms] = {}

    def _variable(self, dim: int, *, unit: bool = True) -> int:
        """Return the key of a new variable. unit: x ~ N(0, I) is added."""
        key = self._keys
        self._keys += 1
        self._dims[key] = dim
        if unit and dim:
            self._add({key: np.eye(dim)}, np.zeros(dim))
        return key

    def _add(self, terms: Terms, b: Array) -> None:
        """Add sum A_k x_k = b + noise of unit covariance. Variables of no entries are left out."""
        parts: list[Any] = [x for key, a in terms.items() if self._dims[key] for x in (key, a)]
        if not parts:
            return
        factor: Any = gtsam.JacobianFactor
        self._graph.push_back(factor(*parts, b, _unit(len(b))))
        self._numbers += sum(a.size for a in terms.values())

    def _flush(self) -> None:
        """Add the prediction that has come together."""
        if self._pending is None:
            return
        (blocks, f, q), self._pending = self._pending, None
        self._set(blocks, [self._state[name][0] for name in blocks], f, q, blocks)

    def _set(
        self, blocks: Blocks, dims: Sequence[int], f: Array, q: Array, sources: Blocks
    ) -> None:
        """Let blocks be F e + w of the sources' e, by a variable of their own or of the noise's."""
        if self._numbers > MOST_NUMBERS or len(self._terms(sources)) >= _MOST_KEYS:
            self._collapse()
        terms = {key: f @ m for key, m in self._terms(sources).items()}
        shift = f @ self._shifts(sources)
        inverse_root = _inverse_root(q)
        if inverse_root is not None:
            key = self._variable(len(f), unit=False)
            equation = {other: -inverse_root @ m for other, m in terms.items()}
            terms = {key: np.eye(len(f))}
            self._add({key: inverse_root, **equation}, np.zeros(len(f)))
        elif (root := square_root(q)).shape[1]:
            terms[self._variable(root.shape[1])] = root
        self._gathered.clear()
        self._place(blocks, dims, terms, shift)

    def _place(self, blocks: Blocks, dims: Sequence[int], terms: Terms, shift: Array) -> None:
        start = 0
        for name, dim in zip(blocks, dims, strict=True):
            part = slice(start, start + dim)
            self._state[name] = dim, {key: m[part] for key, m in terms.items()}
            self._shift[name] = shift[part]
            start += dim
        self._gathered[blocks] = terms

    def _terms(self, blocks: Blocks) -> Terms:
        """Return the matrices of some blocks together, by variable."""
        found = self._gathered.get(blocks)
        if found is None:
            parts = [self._state[name] for name in blocks]
            size = sum(dim for dim, _ in parts)
            found, start = {}, 0
            for dim, terms in parts:
                for key, m in terms.items():
                    if key not in found:
                        found[key] = np.zeros((size, self._dims[key]))
                    found[key][start : start + dim] = m
                start += dim
            self._gathered[blocks] = found
        return found

    def _shifts(self, blocks: Blocks) -> Array:
        return np.concatenate([self._shift[name] for name in blocks])

    def _inverse_root(self, r: Array) -> Array | None:
        """L^-1 of R = L L^T, which mostly is the same as before; None of a singular R."""
        if self._whitened is None or self._whitened[0] is not r:
            self._whitened = r, _whitening(r)
        return self._whitened[1]

    def _collapse(self) -> Array:
        """Eliminate all variables into one; return A (n, r) of all blocks by it."""
        blocks = tuple(self._state)
        terms, shift = self._terms(blocks), self._shifts(blocks)
        anchor = self._anchor
        then: Terms = {} if anchor is None else anchor[1]
        kept = [key for key in {**then, **terms} if self._dims[key]]
        rows = sum(dim for dim, _ in self._state.values())
        before = 0 if anchor is None else len(anchor[0])
        stacked = np.zeros((before + rows, sum(self._dims[key] for key in kept)))
        start = 0
        for key in kept:
            part = slice(start, start + self._dims[key])
            if key in then:
                stacked[:before, part] = then[key]
            if key in terms:
                stacked[before:, part] = terms[key]
            start = part.stop
        root, mean = self._posterior(kept)
        by_noise = stacked @ root
        moved = stacked @ mean
        a: Array = np.asarray(np.linalg.qr(by_noise.T, mode="r")).T
        dims = [dim for dim, _ in self._state.values()]
        self._begin()
        key = self._variable(a.shape[1])
        if anchor is not None:
            self._anchor = anchor[0] + moved[:before], {key: a[:before]}
        self._place(blocks, dims, {key: a[before:]}, shift + moved[before:])
        return a[before:]

    def _posterior(self, kept: list[int]) -> tuple[Array, Array]:
        """Return a root (N, N) of the covariance of some variables, and their mean (N,)."""
        if not kept:
            return np.zeros((0, 0)), np.zeros(0)
        wanted = set(kept)
        gone = [key for key, dim in self._dims.items() if dim and key not in wanted]
        remaining = self._graph
        if gone:
            _, remaining = remaining.eliminatePartialMultifrontal(gone, gtsam.EliminateQR)
        jacobian, b = remaining.jacobian(gtsam.Ordering(kept))
        size = jacobian.shape[1]
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack((jacobian, b)), mode="r"))
        inverse: Array = solve_triangular(triangle[:size, :size], np.eye(size))
        return inverse, inverse @ triangle[:size, size]


def square_root(covariance: Array) -> Array:
    """Return A (n, r) of a covariance A A^T (n, n) of rank r, which may be none.

    Scaled to correlations first, so that units do not decide what is rounding.
    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    inverse = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0.0)
    values, axes = np.linalg.eigh(covariance * np.outer(inverse, inverse))
    some = values > _NOTHING * max(values[-1], 0.0)
    root: Array = sigma[:, None] * axes[:, some] * np.sqrt(values[some])
    return root


def _whitening(r: Array) -> Array | None:
    """Return L^-1 of R = L L^T; None where a component is known from others, but for rounding."""
    try:
        root = np.linalg.cholesky(r)
    except np.linalg.LinAlgError:
        return None
    if (root.diagonal() <= _LEAST_LEFT * np.sqrt(r.diagonal())).any():
        return None
    return _solve_lower(root, np.eye(len(r)))


def _inverse_root(covariance: Array) -> Array | None:
    """Return W with W P W^T = I, or None of a covariance that is singular, or nearly."""
    variance = covariance.diagonal()
    if not (variance > 0.0).all():
        return None
    inverse = 1.0 / np.sqrt(variance)
    try:
        root = np.linalg.cholesky(covariance * (inverse[:, None] * inverse))
    except np.linalg.LinAlgError:
        return None
    if root.diagonal().min() < _LEAST_PIVOT:
        return None
    return _solve_lower(root, np.diag(inverse))


def _solve_lower(root: NDArray[np.floating[Any]], right: Array) -> Array:
    """Return L^-1 B of a Cholesky factor, which numpy keeps by rows and LAPACK reads by columns.

    Without scipy's solve_triangular, whose checks take longer than a small system.
    """
    found: Array = dtrtrs(root.T, right, lower=0, trans=1)[0]
    return found


@cache
def _unit(size: int) -> gtsam.noiseModel.Unit:
    return gtsam.noiseModel.Unit.Create(size)


def _touched(terms: Terms, rows: Index) -> list[int]:
    """Keys of the variables that some rows are on."""
    return [key for key, a in terms.items() if a[rows].any()]


def _rows_by_keys(terms: Terms) -> list[Index]:
    """Split equations into groups that are on the same variables."""
    on = np.array([a.any(axis=1) for a in terms.values()])
    _, group = np.unique(on, axis=1, return_inverse=True)
    return [np.flatnonzero(group == i) for i in range(int(group.max()) + 1)]
