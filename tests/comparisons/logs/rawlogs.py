"""MRPT rawlogs written byte by byte, in the layouts that the reader's module describes."""

import gzip
import struct
from pathlib import Path

import numpy as np

START = 132159670633605833
"""Ticks of 100 ns since 1601."""
_GAUSSIAN = (0.01, 0.06, 0.02, 0.05, 0.04, 0.002)
_THRUN = (0.05, 0.07, 0.01, 0.006, 0.001, 0.0009)


def thing(name: str, version: int, fields: bytes, end: int = 0x88) -> bytes:
    return bytes((0x80 + len(name),)) + name.encode() + bytes((version,)) + fields + bytes((end,))


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def pose_2d(x: float, y: float, heading: float, space: str = "") -> bytes:
    return thing(f"{space}CPose2D", 1, struct.pack("<3d", x, y, heading))


def pose_3d(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, version: int = 2) -> bytes:
    cos, sin = np.cos(yaw), np.sin(yaw)
    if version == 1:
        rows = (cos, -sin, 0, x, sin, cos, 0, y, 0, 0, 1, 0.3, 0, 0, 0, 1)
        inner = thing("CMatrixD", 0, struct.pack("<2I16d", 4, 4, *rows))
        return thing("CPose3D", 1, inner)
    place = struct.pack("<3d", x, y, 0.3)
    if version == 2:
        half = struct.pack("<4d", np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        return thing("CPose3D", 2, place + half)
    matrix = struct.pack("<9d", cos, -sin, 0, sin, cos, 0, 0, 0, 1)
    return thing("mrpt::poses::CPose3D", 3, place + matrix)


def action(
    moved: tuple[float, float, float],
    *,
    method: int = 0,
    model: int = 0,
    version: int = 7,
    gaussian: tuple[float, ...] = _GAUSSIAN,
    thrun: tuple[float, ...] = _THRUN,
) -> bytes:
    fields = struct.pack("<I", method) + pose_2d(*moved)
    fields += struct.pack("<I6fi6f", model, *gaussian, 300, *thrun)
    if version == 6:
        fields += struct.pack("<B2fB2i", 0x5A, 1.0, 2.0, 8, 3, 4)
    else:
        fields += struct.pack("<B3dB2i", 1, 0.1, 0.2, 0.3, 1, 5, 6)
    movement = thing("CActionRobotMovement2D", version, fields + struct.pack("<Q", 0))
    return thing("CActionCollection", 0, struct.pack("<I", 1) + movement)


def frame(*observations: bytes) -> bytes:
    return thing("CSensoryFrame", 2, struct.pack("<I", len(observations)) + b"".join(observations))


def seen(
    rows: list[tuple[float, float, float, int]],
    ticks: int = START,
    sensor: bytes = pose_3d(),
    covariances: bool = False,
) -> bytes:
    fields = (
        struct.pack("<4f", 0.0, 6.0, 3.0, 3.0) + sensor + struct.pack("<QB", ticks, covariances)
    )
    fields += struct.pack("<3fI", 0.02, 0.003, 0.0, len(rows))
    fields += b"".join(struct.pack("<3fi", *row) for row in rows)
    return thing("mrpt::obs::CObservationBearingRange", 3, fields + text("eyes"))


def sweep(
    ranges: list[float],
    ticks: int = START,
    *,
    label: str = "front",
    anticlockwise: bool = True,
    sensor: bytes = pose_3d(0.2, 0.1, 0.5),
    version: int = 6,
    count: int | None = None,
) -> bytes:
    """The second beam is marked as not valid."""
    n = len(ranges) if count is None else count
    fields = struct.pack("<f?f", 3.0, anticlockwise, 80.0) + sensor + struct.pack("<I", n)
    fields += struct.pack(f"<{len(ranges)}f", *ranges)
    fields += bytes([1, 0] + [1] * (len(ranges) - 2))
    fields += struct.pack("<fQf", 0.01, ticks, 0.005) + text(label) + struct.pack("<d", 0.0)
    if version == 7:
        fields += b"\1" + struct.pack(f"<{len(ranges)}i", *range(len(ranges)))
    return thing("CObservation2DRangeScan", version, fields)


def odometry(x: float, y: float, heading: float, ticks: int, version: int = 2) -> bytes:
    fields = pose_2d(x, y, heading, "mrpt::poses::") + text("ODOMETRY")
    more = struct.pack("<QBB", ticks, 0, 0)
    if version == 1:  # encoders, and velocities as two floats
        more = struct.pack("<QB2iB2f", ticks, 1, 7, 8, 1, 0.5, 0.1)
    return thing("mrpt::obs::CObservationOdometry", version, fields + more)


def beacons() -> bytes:
    point = thing("CPoint3D", 1, struct.pack("<3d", -np.inf, 0, 0))
    fields = struct.pack("<3fI", 0.0, 8.0, 0.01, 1) + point + struct.pack("<fi", 3.5, 2)
    fields += pose_2d(0, 0, 0) + text("uwb") + struct.pack("<Q", 0)
    return thing("CObservationBeaconRanges", 3, fields)


def comment() -> bytes:
    return thing("CObservationComment", 0, text("hello") + struct.pack("<Q", 0))


LANDMARKS = {3: 4.0 + 1.0j, 8: 2.0 - 2.0j, 9: 5.0 + 3.0j}
MOVES = ((0.5, 0.02, 0.1), (0.4, -0.01, 0.3), (0.0, 0.0, 0.0))


def drive(ticks: int = 0, labelled: bool = True) -> bytes:
    """Frames with a scan and actions in turns, measurements without noise.

    ticks: from frame to frame.
    """
    at, heading, parts = 0j, 0.0, []
    for number, moved in enumerate((*MOVES, None)):
        rows = []
        for name, place in LANDMARKS.items():
            arm = (place - at) * np.exp(-1j * heading)
            rows.append((abs(arm), float(np.angle(arm)), 0.0, name if labelled else -1))
        now = START + number * ticks
        parts.append(frame(comment(), seen(rows, now), sweep([2.0, 3.0, 4.0], now), beacons()))
        if moved is not None:
            parts.append(action(moved))
            at, heading = at + complex(*moved[:2]) * np.exp(1j * heading), heading + moved[2]
    return b"".join(parts)


def rawlog(folder: Path, content: bytes | None = None, packed: bool = True) -> Path:
    path = folder / "drive.rawlog"
    whole = drive() if content is None else content
    path.write_bytes(gzip.compress(whole, mtime=0) if packed else whole)
    return path
