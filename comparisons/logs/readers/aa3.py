"""Victoria Park as recorded: `aa3_dr.mat`, `aa3_lsr2.mat` and, where present, `aa3_gpsx.mat`.

The scans are raw, so measurements come from them only (`--features trees`). The GPS has a map's
frame, turned against the start by some 36 degrees; it is brought into the frame of the vehicle's
start by laying the first seconds of dead reckoning onto it. Fewer hold too little motion, more the
drift of dead reckoning: against the whole drive's smoothed trajectory laid onto the GPS, 10 s of
wheel samples err by 0.8 degrees and 1 m, 5 s and 60 s by 2 to 4 degrees. (The rotation of 33
degrees in `gps.dat` differs by 3.) The antenna behaves as if at the laser.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.arrays import Array
from comparisons.errors import InputError, RecordError, naming
from comparisons.logs.log import Log, Positions, Prior
from comparisons.logs.odometry import SteeringOdometry
from comparisons.logs.readers.gps_start import start_from_gps
from comparisons.logs.readers.matlab import load_matlab
from comparisons.logs.readers.scan_odometry import no_measurements
from comparisons.logs.readers.victoria_park import NOISE, SIGMA_GPS_M, UTE
from comparisons.logs.scans import Scans

_WHEELS, _LASER, _GPS = "aa3_dr.mat", "aa3_lsr2.mat", "aa3_gpsx.mat"
_BEAMS = 361
_RANGE_BITS = 13
_NO_RETURN_M = 80.0
_ALIGNED_S = 11.0
_START_SIGMA = np.array([0.5, 0.5, np.deg2rad(1.0)])


def recognises(path: Path) -> bool:
    """A folder with the wheels' or the laser's file, even where the other is missing."""
    return (path / _WHEELS).is_file() or (path / _LASER).is_file()


def read(path: Path) -> Log:
    """Read the folder; times count from the first record of any file.

    Ranges of 80 m and more, and zeros, are no returns; the upper three bits are the intensity.
    Raises InputError naming file, variable and record.
    """
    wheels = load_matlab(path / _WHEELS, ("time", "speed", "steering"))
    laser = load_matlab(path / _LASER, ("TLsr", "LASER"))
    gps = None
    if (path / _GPS).is_file():
        gps = load_matlab(path / _GPS, ("timeGps", "Lo_m", "La_m"))
    instants = {_WHEELS: wheels["time"], _LASER: laser["TLsr"]}
    if gps is not None:
        instants[_GPS] = gps["timeGps"]
    for name, times in instants.items():
        if not times.size:
            raise InputError(f"{path / name}: holds no records")
    start_ms = min(float(times.flat[0]) for times in instants.values())
    seconds = {name: (times.ravel() - start_ms) / 1e3 for name, times in instants.items()}
    with naming(path / _WHEELS):
        odometry = SteeringOdometry(
            seconds[_WHEELS], wheels["speed"].ravel(), wheels["steering"].ravel(), UTE, NOISE
        )
    with naming(path / _LASER):
        scans = _scans(seconds[_LASER], laser["LASER"])
    positions = None
    if gps is not None:
        with naming(path / _GPS):
            positions = _positions(seconds[_GPS], gps["Lo_m"], gps["La_m"], odometry)
    return Log(
        name="victoria-park-scans",
        format="aa3",
        prior=Prior(
            float(min(odometry.time_s[0], scans.time_s[0])), np.zeros(3), np.diag(_START_SIGMA**2)
        ),
        odometry=odometry,
        measurements=no_measurements(),
        positions=positions,
        scans=scans,
        provenance={
            "folder": path.name,
            "vehicle": "UTE, Nieto 2005, Appendix A",
            "time_origin_s": f"{start_ms / 1e3:.3f}",
            "frame": "the vehicle's start; the GPS laid onto dead reckoning of the first "
            f"{_ALIGNED_S:g} s",
        },
    )


def _scans(time_s: Array, words: Array) -> Scans:
    """Range in centimetres below, intensity above, in words of 16 bits."""
    if words.ndim != 2 or words.shape[1] != _BEAMS:
        raise InputError(f"LASER has shape {words.shape}, expected (N, {_BEAMS})")
    bad = np.argwhere((words < 0) | (words >= 2**16) | (words != np.round(words)))
    if len(bad):
        row, beam = bad[0].tolist()
        fault = f"beam {beam} is {words[row, beam]:g}, expected a whole number below 65536"
        raise RecordError("LASER", row, fault)
    whole = words.astype(np.uint16)
    range_m = (whole & (2**_RANGE_BITS - 1)) / 100.0
    return Scans(
        time_s=time_s,
        angle_rad=np.deg2rad(np.linspace(-90.0, 90.0, _BEAMS)),
        range_m=np.where((range_m > 0) & (range_m < _NO_RETURN_M), range_m, np.nan),
        intensity=(whole >> _RANGE_BITS).astype(float),
    )


def _positions(time_s: Array, east: Array, north: Array, odometry: SteeringOdometry) -> Positions:
    """Fixes in the frame of the vehicle's start."""
    if not time_s.size == east.size == north.size:
        raise InputError("timeGps, Lo_m and La_m differ in length")
    covariance = np.broadcast_to(SIGMA_GPS_M**2 * np.eye(2), (len(time_s), 2, 2))
    mapped = Positions(time_s, np.column_stack((east.ravel(), north.ravel())), covariance)
    x, y, heading = start_from_gps(odometry, mapped, _ALIGNED_S)
    moved = (mapped.position_m - (x, y)) @ np.array([1.0, 1j]) * np.exp(-1j * heading)
    return Positions(time_s, np.column_stack((moved.real, moved.imag)), covariance)
