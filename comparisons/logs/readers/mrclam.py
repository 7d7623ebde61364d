"""UTIAS MR.CLAM folders: one robot's odometry and measurements, motion capture as truth.

Subjects 1 to 5 are robots, the others landmarks; measurements carry barcodes, which `Barcodes.dat`
maps to subjects. Barcodes are now and then misread, hence the gate on labels.

What motion capture shows of these sensors, the same for all robots of the data set: the odometry
(the speeds commanded) runs 0.18 s ahead of the motion. The range is the depth along the camera's
axis, not the slant range, and reads 3 to 5 % long; with both undone it errs by 1 % instead of 4 %.
The heading walks off by 0.028 to 0.036 rad per root second, most of it in turns.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Poses, Prior, Truth
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from comparisons.logs.stamps import seconds_after
from comparisons.logs.table import TextTable
from comparisons.logs.validation import whole_numbers, within

_ROBOTS = 5
_ODOMETRY_LEAD_S = 0.18
_DEPTH_GAIN = 1.036
_SIGMA_RANGE_M = 0.05
_SIGMA_RANGE_SHARE = 0.03
_SIGMA_BEARING_RAD = 0.02
_LABEL_GATE = 60.0
_NOISE = OdometryNoise(0.12, 0.0, 1e-6, 1.2e-3)
_PRIOR_SIGMA = np.array([0.01, 0.01, 0.01])


def recognises(path: Path) -> bool:
    """A folder with the barcode table."""
    return (path / "Barcodes.dat").is_file()


def read(path: Path, robot: int) -> Log:
    """Read one robot's log; times count from its first odometry record.

    The prior is the motion capture's pose then. Measurements of other robots and of unlisted
    barcodes are left out, and the provenance says how many. Raises InputError.
    """
    odometry = TextTable(path / f"Robot{robot}_Odometry.dat", ("time", "v", "omega"))
    measured = TextTable(
        path / f"Robot{robot}_Measurement.dat", ("time", "barcode", "range", "bearing")
    )
    captured = TextTable(path / f"Robot{robot}_Groundtruth.dat", ("time", "x", "y", "heading"))
    surveyed = TextTable(
        path / "Landmark_Groundtruth.dat", ("subject", "x", "y", "sigma_x", "sigma_y")
    )
    barcodes = TextTable(path / "Barcodes.dat", ("subject", "barcode"))
    for table in (odometry, measured, captured, surveyed, barcodes):
        if not len(table):
            raise InputError(f"{table.path}: holds no records")
    start = odometry.decimals("time")[0]
    with odometry.locating():
        motion = VelocityOdometry(
            seconds_after(odometry.decimals("time"), start),
            odometry["v"],
            odometry["omega"],
            _NOISE,
        )
    motion = replace(motion, time_s=motion.time_s + _ODOMETRY_LEAD_S)
    with captured.locating():
        pose = np.column_stack((captured.data[:, 1:3], np.unwrap(captured["heading"])))
        truth = Poses(seconds_after(captured.decimals("time"), start), pose)
    subject_of = dict(zip(barcodes["barcode"].tolist(), barcodes["subject"].tolist(), strict=True))
    subject = np.array([subject_of.get(code, 0.0) for code in measured["barcode"].tolist()])
    early = measured["time"] < odometry["time"][0]
    with measured.locating():
        everything = _measurements(measured, start, subject)
    kept = (subject > _ROBOTS) & ~early
    landmark_measurements = everything.chosen(kept)
    slant = landmark_measurements.range_m / (
        _DEPTH_GAIN * np.cos(landmark_measurements.bearing_rad)
    )
    sigma_m = np.hypot(_SIGMA_RANGE_M, _SIGMA_RANGE_SHARE * slant)
    measurements = replace(
        landmark_measurements, range_m=slant, sigma_range_m=sigma_m, label_gate=_LABEL_GATE
    )
    variance = surveyed.data[:, 3:5] ** 2
    with surveyed.locating():
        landmarks = Landmarks(
            whole_numbers("landmarks", "subject", surveyed["subject"]),
            surveyed.data[:, 1:3],
            variance[:, :, None] * np.eye(2),
        )
    if not truth.time_s[0] <= 0.0 <= truth.time_s[-1]:
        raise InputError(
            f"{captured.path}: does not cover the start of the odometry, which gives the prior"
        )
    first = truth.at(np.zeros(1))[0]
    return Log(
        name=f"{path.name.lower()}-robot-{robot}",
        format="mrclam",
        prior=Prior(0.0, first, np.diag(_PRIOR_SIGMA**2)),
        odometry=motion,
        measurements=measurements,
        truth=Truth(truth, landmarks),
        provenance={
            "folder": path.name,
            "robot": str(robot),
            "time_origin_s": f"{start:.3f}",
            "left_out": f"{np.count_nonzero((subject > 0) & (subject <= _ROBOTS))} measurements of "
            f"robots, {np.count_nonzero(subject == 0)} of unlisted barcodes, "
            f"{np.count_nonzero(early)} before the odometry",
        },
    )


def _measurements(measured: TextTable, start: Decimal, landmark: Array) -> LandmarkMeasurements:
    """All records as recorded, robots included, so that a fault is reported by its line."""
    within("measurements", "bearing_rad", measured["bearing"], -1.5, 1.5)
    ids = whole_numbers("measurements", "subject", landmark)
    time_s = seconds_after(measured.decimals("time"), start)
    return LandmarkMeasurements.of(time_s, measured.data[:, 2:], (1.0, _SIGMA_BEARING_RAD), ids)
