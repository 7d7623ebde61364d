"""How strongly the state's entries hang together (Nieto 2005, eq. 2.62 and Figs. 2.11, 2.12)."""

from __future__ import annotations

import numpy as np

from ekf_reference.core.geometry import Array


def correlation_coefficients(covariance: Array) -> Array:
    """rho_ij = |P_ij| / sqrt(P_ii P_jj) of a covariance (n, n), between 0 and 1."""
    sigma = np.sqrt(np.diag(covariance))
    coefficients: Array = np.abs(covariance) / np.outer(sigma, sigma)
    return coefficients
