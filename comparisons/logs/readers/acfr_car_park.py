"""The ACFR car park: `data_set.mat` (wheel, steering, scans, GPS) and `beac_juan3.mat` (beacons).

Reflectors light up in the scans' intensity; a run of lit beams is one measurement. The prior's
position and heading come from laying the first seconds of dead reckoning onto the RTK GPS.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.errors import InputError, naming
from comparisons.logs.log import LandmarkMeasurements, Landmarks, Log, Positions, Prior, Truth
from comparisons.logs.odometry import OdometryNoise, SteeringOdometry
from comparisons.logs.readers.gps_start import start_from_gps
from comparisons.logs.readers.matlab import load_matlab
from comparisons.logs.readers.victoria_park import UTE
from comparisons.logs.scans import Scans

_NOISE = OdometryNoise(0.1, np.deg2rad(2.0), 1e-5, 1e-6)
_SIGMA_RANGE_M = 0.05
_SIGMA_BEARING_RAD = np.deg2rad(1.0)
_SIGMA_GPS_M = 0.05
_NO_RETURN_M = 80.0
_CLUSTER_GAP_M = 0.5
_CLUSTER_GAP_BEAMS = 2
_ALIGNED_S = 6.0
_START_SIGMA = np.array([0.05, 0.05, np.deg2rad(0.5)])
_FILES = ("data_set.mat", "beac_juan3.mat")


def recognises(path: Path) -> bool:
    """A folder with the first of the two files."""
    return (path / _FILES[0]).is_file()


def read(path: Path) -> Log:
    """Read the pair of files. Raises InputError naming file and variable."""
    data = load_matlab(
        path / _FILES[0],
        ("Time_VS", "Velocity", "Steering", "TimeLaser", "Laser", "Intensity", "TimeGPS", "GPSLon",
         "GPSLat"),
    )  # fmt: skip
    beacons = load_matlab(path / _FILES[1], ("estbeac",))["estbeac"]
    if beacons.ndim != 2 or beacons.shape[1] != 2:
        raise InputError(f"{path / _FILES[1]}: estbeac has shape {beacons.shape}, expected (L, 2)")
    time = {name: data[name].ravel() for name in ("Time_VS", "TimeLaser", "TimeGPS")}
    for name, instants in time.items():
        if not len(instants):
            raise InputError(f"{path / _FILES[0]}: {name} is empty")
    if data["GPSLon"].size != data["GPSLat"].size:
        raise InputError(f"{path / _FILES[0]}: GPSLon and GPSLat differ in length")
    start = min(float(instants[0]) for instants in time.values())
    with naming(path / _FILES[0]):
        odometry = SteeringOdometry(
            time["Time_VS"] - start, data["Velocity"].ravel(), data["Steering"].ravel(), UTE, _NOISE
        )
        scans = Scans(
            time_s=time["TimeLaser"] - start,
            angle_rad=np.deg2rad(np.linspace(-90.0, 90.0, data["Laser"].shape[-1])),
            range_m=np.where(data["Laser"] < _NO_RETURN_M, data["Laser"], np.nan),
            intensity=data["Intensity"],
        )
        position = np.column_stack((data["GPSLon"].ravel(), data["GPSLat"].ravel()))
        covariance = np.broadcast_to(_SIGMA_GPS_M**2 * np.eye(2), (len(position), 2, 2))
        positions = Positions(time["TimeGPS"] - start, position, covariance)
        measurements = reflector_measurements(scans)
        start_pose = start_from_gps(odometry, positions, _ALIGNED_S)
    return Log(
        name="acfr-car-park",
        format="acfr-car-park",
        prior=Prior(0.0, start_pose, np.diag(_START_SIGMA**2)),
        odometry=odometry,
        measurements=measurements,
        positions=positions,
        scans=scans,
        truth=Truth(
            landmarks=Landmarks(np.arange(len(beacons)), beacons, np.zeros((len(beacons), 2, 2)))
        ),
        provenance={
            "folder": path.name,
            "time_origin_s": f"{start:.3f}",
            "prior": f"dead reckoning of the first {_ALIGNED_S:g} s laid onto the GPS",
        },
    )


def reflector_measurements(scans: Scans) -> LandmarkMeasurements:
    """One measurement per run of lit beams: mean range, bearing and intensity of the run.

    Beams belong to one run when at most two dark beams lie between them and their ranges differ
    by less than half a metre.
    """
    scan, beam = np.nonzero((scans.intensity > 0) & np.isfinite(scans.range_m))
    distance, angle = scans.range_m[scan, beam], scans.angle_rad[beam]
    fresh = (
        (np.diff(scan, prepend=-1) != 0)
        | (np.diff(beam, prepend=-1) > _CLUSTER_GAP_BEAMS + 1)
        | (np.abs(np.diff(distance, prepend=0.0)) > _CLUSTER_GAP_M)
    )
    run = np.cumsum(fresh) - 1
    lit = (distance, angle, scans.intensity[scan, beam])
    *z, intensity = (np.bincount(run, one) / np.bincount(run) for one in lit)
    sigma = (_SIGMA_RANGE_M, _SIGMA_BEARING_RAD)
    time_s = scans.time_s[scan[fresh]]
    return LandmarkMeasurements.of(time_s, np.column_stack(z), sigma, intensity=intensity)
