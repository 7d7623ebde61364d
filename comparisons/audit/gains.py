"""Gains and corrections that are not Kalman's: named, not condemned.

A filter may use any gain, if its covariance is that of this gain and its estimate moves by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.arrays import Array
from comparisons.audit.events import Blocks, Update
from comparisons.audit.replay import Fused, Layout

_ALIKE = 1e-4
"""Relative to the largest entry, within which a shape of a gain is recognised."""


class Unlike(NamedTuple):
    """A gain, or a correction, that is another. what: a predicate of the update. blocks: where.

    fault: of a correction that is not gain times residual.
    """

    what: str
    blocks: Blocks
    fault: bool


def check_gain(
    event: Update, fused: Fused, sigma: Array, layout: Layout, tolerance: float
) -> list[Unlike]:
    """Return what is unlike Kalman in an update that was used.

    Args:
        event: With gain or correction.
        fused: What the replay made of it.
        sigma: (n,) standard deviations after the update, as units.
        layout: Of the state.
        tolerance: Relative to what a measurement of one sigma corrects.
    """
    found = []
    root: Array = np.asarray(np.linalg.inv(fused.inverse_root), dtype=np.float64)
    unit = np.where(sigma > 0.0, sigma, 1.0)
    if event.gain is not None:
        found += _gain(event, fused, root, unit, layout, tolerance)
    if event.correction is not None:
        gain = fused.gain if event.gain is None else event.gain
        found += _correction(event, gain @ event.residual, unit, layout, tolerance)
    return found


def _gain(
    event: Update, fused: Fused, root: Array, unit: Array, layout: Layout, tolerance: float
) -> list[Unlike]:
    """The columns are compared times the innovation's root, in sigmas of the state."""
    assert event.gain is not None  # noqa: S101 - asked for above
    given, right = ((k @ root) / unit[:, None] for k in (event.gain, fused.gain))
    if not np.abs(given - right).max() > tolerance:
        return []
    scale = float(np.abs(right).max())
    wrong = _blocks(np.abs(given - right).max(axis=1), layout, max(tolerance, _ALIKE * scale))
    if not wrong:
        wrong = tuple(layout.dims)
    silent = tuple(b for b in wrong if not event.gain[layout.entries(b)].any())
    if silent and set(silent) == set(wrong):
        names = ", ".join(silent)
        return [Unlike(f"does not correct {names} (Schmidt)", silent, False)]
    weight = float(np.vdot(given, right) / np.vdot(right, right)) if scale else 0.0
    if np.abs(given - weight * right).max() <= _ALIKE * scale:
        return [Unlike(f"uses {weight:.4g} times Kalman's gain", wrong, False)]
    factor = _noise_factor(event, fused, given * unit[:, None], root)
    if factor is not None:
        return [Unlike(f"uses the gain of {factor:.4g} R", wrong, False)]
    off = float(np.abs(given - right).max() / (scale or 1.0))
    text = f"has a gain that is not Kalman's on {', '.join(wrong)} (by {100 * off:.2g} %)"
    return [Unlike(text, wrong, False)]


def _noise_factor(event: Update, fused: Fused, given: Array, root: Array) -> float | None:
    """The number c with a gain of c R, P H^T (H P H^T + c R)^-1, if there is one."""
    s = root @ root.T
    across = fused.gain @ s
    gain = given @ fused.inverse_root
    # K (H P H^T + c R) = P H^T is linear in c.
    left, right = gain @ event.noise, across - gain @ (s - event.noise)
    c = float(np.vdot(left, right) / np.vdot(left, left)) if left.any() else 0.0
    if c <= 0.0 or np.abs(right - c * left).max() > _ALIKE * float(np.abs(across).max()):
        return None
    return c


def _correction(
    event: Update, right: Array, unit: Array, layout: Layout, tolerance: float
) -> list[Unlike]:
    assert event.correction is not None  # noqa: S101 - asked for above
    off = np.abs(event.correction - right) / unit
    wrong = _blocks(off, layout, max(tolerance, _ALIKE * float(np.abs(right / unit).max())))
    if not off.max() > tolerance or not wrong:
        return []
    given = np.concatenate([event.correction[layout.entries(b)] for b in wrong])
    meant = np.concatenate([right[layout.entries(b)] for b in wrong])
    names, near = ", ".join(wrong), _ALIKE * float(np.abs(meant).max())
    if not given.any():
        text = f"does not correct the estimate of {names}, though its gain does"
    elif np.abs(given + meant).max() <= near:
        text = f"corrects the estimate of {names} with the wrong sign"
    elif np.abs(given - 2.0 * meant).max() <= near:
        text = f"corrects the estimate of {names} twice"
    else:
        text = f"corrects the estimate of {names} by other than gain times residual"
    return [Unlike(text, wrong, True)]


def _blocks(off: Array, layout: Layout, allowed: float) -> Blocks:
    """Blocks with an entry that is off by more than allowed."""
    return tuple(b for b in layout.dims if off[layout.entries(b)].max() > allowed)
