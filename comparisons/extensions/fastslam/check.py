"""The clouds of independent FastSLAMs against the smoother, at the last pose.

Particles of one cloud share ancestors, so the number of particles, and the effective sample size,
say too much of how well the cloud's mean is known. Independent clouds tell: the scatter of their
means, V, is the Monte Carlo error of one. The mean of M clouds is not better by M: depletion also
leaves a bias, which all clouds share and which averaging does not lessen. On simulated loops it is
some three times the scatter of a cloud in the worst direction. So the smoother's pose is taken for
one more draw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvalsh
from scipy.special import fdtri, stdtrit

from comparisons.arrays import Array
from comparisons.checks.agreement import Gaussian
from ekf_reference.core.geometry import wrap_angle

LEVEL = 1e-3
"""Probability, at most, that clouds and smoother of one posterior are said to disagree."""
LARGEST_SKEWNESS = 0.5
LEAST_KURTOSIS = -0.8
"""Excess kurtosis below which a distribution is flat or has several modes; a uniform has -1.2."""
AXES = ("east", "north", "heading")


@dataclass(frozen=True, kw_only=True)
class CloudCheck:
    """Clouds against the smoother.

    difference: (3,) mean of the clouds' means minus the smoother's last pose. scatter: (3,)
    standard deviations of the clouds' means. statistic: d^T (P + (1 + 1 / M) V)^-1 d. limit: what
    it exceeds with a probability of LEVEL at most. independent: least number, over all directions,
    of independent particles of the smoother's posterior that know the mean as well as a cloud.
    agrees: None where the clouds are too small to tell. shape: what is not Gaussian.
    """

    difference: Array
    scatter: Array
    statistic: float
    limit: float
    independent: float
    agrees: bool | None
    shape: tuple[str, ...]


def check_clouds(means: Array, moments: Array, smoother: Gaussian) -> CloudCheck:
    """Compare.

    Args:
        means: (M, 3) weighted mean of each cloud's last pose.
        moments: (M, 2, 3) skewness and excess kurtosis of each cloud's last pose.
        smoother: Of the last pose.

    Returns:
        The comparison. The limit is Hotelling's for one more draw of the clouds' distribution; P
        only adds to it. It holds where the clouds' bias is like the error of one of them.
    """
    count = len(means)
    apart = means - smoother.mean
    apart[:, 2] = wrap_angle(apart[:, 2])
    difference, v = apart.mean(axis=0), np.cov(apart.T)
    p = smoother.covariance
    statistic = float(difference @ np.linalg.solve(p + (1.0 + 1.0 / count) * v, difference))
    quantile = float(fdtri(3, count - 3, 1.0 - LEVEL))
    limit = 3.0 * (count - 1) / (count - 3) * quantile
    independent = 1.0 / float(eigvalsh(v, p)[-1])
    agrees: bool | None = statistic <= limit
    if agrees and independent < 1.0:
        agrees = None
    return CloudCheck(
        difference=difference,
        scatter=np.sqrt(np.diag(v)),
        statistic=statistic,
        limit=limit,
        independent=independent,
        agrees=agrees,
        shape=_shape(moments),
    )


def standardised_moments(pose: Array, weight: Array) -> Array:
    """Return skewness and excess kurtosis (2, 3) of weighted poses (N, 3).

    A cloud that is a single point has the moments of a Gaussian.
    """
    apart = pose - weight @ pose
    variance = weight @ apart**2
    if not (variance > 0.0).all():
        return np.zeros((2, 3))
    return np.stack(((weight @ apart**3) / variance**1.5, (weight @ apart**4) / variance**2 - 3.0))


def _shape(moments: Array) -> tuple[str, ...]:
    """What the clouds' moments (M, 2, 3) say together, each at LEVEL shared among the six."""
    count = len(moments)
    mean = moments.mean(axis=0)
    error = moments.std(axis=0, ddof=1) / np.sqrt(count)
    times = float(stdtrit(count - 1, 1.0 - LEVEL / 12.0))
    found = []
    for axis, skewness, kurtosis, by, width in zip(AXES, *mean, *error, strict=True):
        if abs(skewness) - times * by > LARGEST_SKEWNESS:
            found.append(f"{axis} is skew (skewness {skewness:.2f})")
        if kurtosis + times * width < LEAST_KURTOSIS:
            found.append(f"{axis} is flat or has several modes (excess kurtosis {kurtosis:.2f})")
    return tuple(found)
