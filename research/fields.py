"""What the drives through fields of landmarks have in common, whatever they measure."""

from __future__ import annotations

import math

from comparisons.logs.simulate.drive import Drive

SPACING_M = 12.0
"""Mean distance of neighbouring landmarks: 5 to 20 of them are in view."""


def field_drive(scans: int) -> Drive:
    """Once around the path in so many scans, five a second, 0.4 m apart."""
    return Drive(
        speed_mps=2.0,
        sample_s=0.1,
        scan_every=2,
        loop_s=0.2 * scans,
        max_range_m=30.0,
        sigma_speed_mps=0.1,
        sigma_steering_rad=math.radians(1.0),
    )
