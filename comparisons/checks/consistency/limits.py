"""What of a filter's consistency is outside the band of sound runs, in words."""

from __future__ import annotations

import numpy as np

from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.consistency.filter_smoother import FilterAgainstSmoother
from comparisons.figures import rounded
from comparisons.statistics import chi2_quantile

_SHARE = 0.999
"""Of the sound runs that stay within the limit. The errors of one run depend on each other, hence
the limit of one value, not of an average of independent ones."""
_SURER = 0.05
"""Of the epochs: so many with a filter more certain than the smoother make it inconsistent."""


def limit(dof: int) -> float:
    """Root of a mean NEES over its degrees of freedom that a sound run hardly passes."""
    return float(np.sqrt(chi2_quantile(_SHARE, dof) / dof))


def inconsistencies(consistency: Consistency) -> tuple[str, ...] | None:
    """Return what is outside its band: the filter's NEES, filter against smoother, NIS.

    None where there is none of these.

    An association that leaves out large innovations makes the NIS too low, which does not count.
    The bands of NIS are those of the notes: all of them hold in 99.9 % of sound runs. The band of
    filter against smoother is the figure's: 5 of 520 sound runs leave it, since its independent
    epochs are counted low. A filter more certain than the smoother counts from one epoch in twenty
    on, the NEES from the limit of the truth gap.
    """
    against, smoothed = consistency.ekf, consistency.smoothed
    if against is None and smoothed is None and not consistency.sensors:
        return None
    far, found = [], []
    if against is not None and against.poses is not None:
        far.append(("poses", against.poses.pose))
    if against is not None and against.map is not None:
        far.append(("landmarks", against.map.landmarks))
    for what, errors in far:
        if errors.mean is not None and errors.mean / errors.dof > limit(errors.dof) ** 2:
            found.append(
                f"NEES of the {what} {rounded(errors.mean / errors.dof)} per degree of freedom, "
                f"limit {limit(errors.dof) ** 2:.2g}"
            )
    if smoothed is not None:
        found += _against_smoother(smoothed)
    for nis in (nis for sensor in consistency.sensors for nis in sensor.nis):
        reading, (low, high) = nis.worded(consistency.outside)
        if reading == "too high" or (reading == "too low" and not consistency.gated):
            found.append(
                f"NIS of {nis.name} {nis.mean / nis.dof:.3g} per degree of freedom, band "
                f"{low / nis.dof:.3g} to {high / nis.dof:.3g}"
            )
    return tuple(found)


def _against_smoother(smoothed: FilterAgainstSmoother) -> list[str]:
    found, mean, band = [], smoothed.mean_per_dof, smoothed.band
    if mean is not None and band is not None and not band.holds(mean):
        found.append(
            f"filter-smoother difference {rounded(mean)} per degree of freedom, "
            f"band {band.low:.2g} to {band.high:.2g}"
        )
    if len(smoothed.overconfident) > _SURER * len(smoothed.time_s):
        found.append(
            f"filter more certain than the smoother at {len(smoothed.overconfident)} of "
            f"{len(smoothed.time_s)} epochs"
        )
    return found
