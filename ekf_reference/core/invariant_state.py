"""Gaussians that an update corrects in errors other than the additive one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ekf_reference.core.geometry import Array, Index
from ekf_reference.core.layout import ABSENT
from ekf_reference.core.state import Correction, KalmanState


class InvariantState(KalmanState):
    """Mean and covariance that an update corrects in right-invariant error (Zhang et al. 2017).

    With the error (t, p), a turn of the whole map and places in it, a place's additive error is
    p + t J place, and a pose moves by the exponential of SE(2). To first order this is the EKF's
    update; the covariance is turned from the old places to the new ones.
    """

    def update(
        self, columns: Index, jacobian: Array, innovation: Array, noise: Array
    ) -> Correction:
        """Correct the mean on the group, then express the covariance at the new mean.

        Arguments, result and errors are those of `KalmanState.update`.
        """
        before = self.mean.copy()
        done = super().update(columns, jacobian, innovation, noise)
        error = self.mean - before
        size, turn = len(before), float(error[2])
        place = self._places()
        at, moved = _complex(before[place]), _complex(error[place])
        after, spin = self._carried(turn, at, moved - 1j * turn * at)
        self._mean[place[:, 0]], self._mean[place[:, 1]] = after.real, after.imag
        across = 1j * (after - spin * at)
        change = np.eye(size)
        change[place[:, 0], 2], change[place[:, 1], 2] = across.real, across.imag
        for k, one in enumerate((spin.real, spin.imag)):
            change[place[:, 0], place[:, k]] = (1.0, -1.0)[k] * one
            change[place[:, 1], place[:, 1 - k]] = one
        p = self._covariance[:size, :size]
        p[:] = change @ p @ change.T
        return done

    def _places(self) -> Index:
        """(k, 2) entries x and y of the pose and of landmarks; headings have additive errors."""
        first = np.concatenate(([0], *self.layout.first.values()))
        entries: Index = first[first != ABSENT][:, None] + np.arange(2)
        return entries

    def _carried(
        self, turn: float, at: NDArray[np.complex128], own: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], complex]:
        """Where places go by a turn and their error p, and how their own errors turn."""
        spin = complex(np.exp(1j * turn))
        return spin * at + ((spin - 1.0) / (1j * turn) if turn else 1.0) * own, 1.0 + 0.0j


class RobocentricState(InvariantState):
    """Mean and covariance that an update corrects as seen from the vehicle (Castellanos 2004).

    The errors are those of the map's origin and of the landmarks in the vehicle's frame. Predicting
    is linear in these, and the chain rule makes F, Q and H those of the EKF.
    """

    def _carried(
        self, turn: float, at: NDArray[np.complex128], own: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], complex]:
        spin = complex(np.exp(1j * turn))
        return spin * (at + own), spin


def _complex(places: Array) -> NDArray[np.complex128]:
    found: NDArray[np.complex128] = places[:, 0] + 1j * places[:, 1]
    return found
