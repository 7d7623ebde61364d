"""What a log's sightings tell of their landmarks besides where they are, and how surely."""

from __future__ import annotations

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import Log
from ekf_reference.attributes import AttributeEstimates
from ekf_reference.sightings import SightedAttributes

ATTRIBUTES = ("off", "on")
TAKING = ("nn", "jcbb")
"""The associations that take attributes: `known` needs none, `euclidean` knows no likelihood, and
`agreed` sees discs that may hold several trees."""

SIGMA_WIDTH_RAD = 0.006
SIGMA_SHAPE_M = 0.05
"""Of a diameter (Guivant 2002, eq. 15). Set by hand, so that differences between sightings of one
tree, more than a minute apart on Victoria Park, have a mean normalised square of about one, near
and far (0.96 to 1.33; benchmarks/attributes.py): least squares would follow the outliers, 0.15 m at
any range. The first is 1.7 times what beams half a degree apart explain."""
SIGMA_INTENSITY = 0.45
"""Of an intensity, as a share of the median over the log, for its unit is the sensor's own; from
the spread within the reflectors of the ACFR car park."""
REPEATS = 12.0
"""Sightings that are worth one independent one: the sum of the autocorrelation of what is left of
diameters on Victoria Park, sighting by sighting."""


def sighted_attributes(log: Log) -> SightedAttributes:
    """Diameter and intensity of each sighting (M, 2), NaN where the log has none."""
    seen = log.sightings
    variance = np.empty((len(seen.time_s), 2))
    variance[:, 0] = (seen.range_m * SIGMA_WIDTH_RAD) ** 2 + SIGMA_SHAPE_M**2
    told = seen.intensity[~np.isnan(seen.intensity)]
    unit = float(np.median(np.abs(told))) if len(told) else 1.0
    variance[:, 1] = (SIGMA_INTENSITY * (unit or 1.0)) ** 2
    return SightedAttributes(np.column_stack((seen.diameter_m, seen.intensity)), variance)


def no_estimates() -> AttributeEstimates:
    """A memory that has seen nothing yet."""
    return AttributeEstimates(np.full(2, REPEATS))


def check_attributes(log: Log, choice: str, association: str) -> None:
    """Raises InputError where they are asked for and cannot be had."""
    if choice not in ATTRIBUTES:
        raise InputError(f"attributes '{choice}' is unknown, expected {' or '.join(ATTRIBUTES)}")
    if choice == "off":
        return
    if association not in TAKING:
        raise InputError(
            f"association '{association}' takes no attributes, expected {' or '.join(TAKING)}; "
            "use --attributes off"
        )
    if np.isnan(log.sightings.diameter_m).all() and np.isnan(log.sightings.intensity).all():
        raise InputError(
            f"{log.name}: its sightings hold no diameter and no intensity; use --attributes off"
        )
