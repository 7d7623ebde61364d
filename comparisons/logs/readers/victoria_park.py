"""Victoria Park tree detections: `measurements.dat`, `inputs.dat`, `gps.dat` in one folder.

Columns: time, range, bearing (pi/2 straight ahead), diameter; time, speed, steering; time, x, y.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import LandmarkMeasurements, Log, Positions, Prior
from comparisons.logs.odometry import Ackermann, OdometryNoise, SteeringOdometry
from comparisons.logs.table import TextTable

UTE = Ackermann(wheelbase_m=2.83, encoder_offset_m=0.76, sensor_forward_m=3.78, sensor_left_m=0.5)
"""The vehicle of Nieto 2005, Appendix A."""
NOISE = OdometryNoise(np.hypot(0.2, 0.2), np.deg2rad(3.0), 1e-5, 1e-6)
"""Of its wheel and steering encoders."""
SIGMA_GPS_M = 0.5
"""Of its GPS, per axis."""
STRAIGHT_AHEAD_RAD = np.pi / 2
"""A bearing straight ahead, as the files have it."""

_SIGMA_RANGE_M = 0.5
_SIGMA_BEARING_RAD = np.deg2rad(2.0)
_START_SIGMA = np.array([0.05, 0.05, np.deg2rad(1.0)])


def recognises(path: Path) -> bool:
    """A folder with the two files every run needs."""
    return (path / "measurements.dat").is_file() and (path / "inputs.dat").is_file()


def read(path: Path) -> Log:
    """Read the folder. Raises InputError naming file, line, value and expectation."""
    seen = TextTable(path / "measurements.dat", ("time", "range", "bearing", "diameter"))
    inputs = TextTable(path / "inputs.dat", ("time", "speed", "steering"))
    for table in (seen, inputs):
        if not len(table):
            raise InputError(f"{table.path}: holds no records")
    with inputs.locating():
        odometry = SteeringOdometry(inputs["time"], inputs["speed"], inputs["steering"], UTE, NOISE)
    with seen.locating():
        measurements = LandmarkMeasurements.of(
            seen["time"],
            np.column_stack((seen["range"], seen["bearing"] - STRAIGHT_AHEAD_RAD)),
            (_SIGMA_RANGE_M, _SIGMA_BEARING_RAD),
            diameter_m=seen["diameter"],
            needs_confirmation=True,
        )
    positions = None
    if (path / "gps.dat").is_file():
        gps = TextTable(path / "gps.dat", ("time", "x", "y"))
        covariance = np.broadcast_to(SIGMA_GPS_M**2 * np.eye(2), (len(gps), 2, 2))
        with gps.locating():
            positions = Positions(gps["time"], gps.data[:, 1:], covariance)
    start = float(min(odometry.time_s[0], measurements.time_s[0]))
    return Log(
        name="victoria-park-detections",
        format="victoria-park",
        prior=Prior(start, np.zeros(3), np.diag(_START_SIGMA**2)),
        odometry=odometry,
        measurements=measurements,
        positions=positions,
        provenance={"folder": path.name, "vehicle": "UTE, Nieto 2005, Appendix A"},
    )
