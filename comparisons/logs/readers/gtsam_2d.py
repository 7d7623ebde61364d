"""Text graphs with ODOMETRY and LANDMARK lines, such as gtsam's `victoria_park.txt`.

`ODOMETRY i j dx dy dheading` and the covariance's upper triangle: pose j seen from pose i.
`LANDMARK i j x y` and the covariance's upper triangle: landmark j in the frame of pose i. Poses
and landmarks share one numbering; poses come in driving order. There are no times, so pose k
gets k seconds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.errors import InputError
from comparisons.logs.log import Log, Prior, RelativePoses, Sightings
from comparisons.logs.table import number_or_fail, read_text, shorten

_ODOMETRY = ("i", "j", "dx", "dy", "dheading", "c00", "c01", "c02", "c11", "c12", "c22")
_LANDMARK = ("i", "j", "x", "y", "c00", "c01", "c11")
_PRIOR_SIGMA = 1e-6


def recognises(path: Path) -> bool:
    """A text file whose first word is one of the two tags."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(16).split(b" ")[0] in (b"ODOMETRY", b"LANDMARK")


def read(path: Path) -> Log:
    """Read the file; the prior is the origin with sigma 1e-6 (m and rad).

    A landmark's position becomes range and bearing; its variance v, equal in x and y, becomes
    sigma_r = sqrt(v) and sigma_b = sigma_r / r. Raises InputError naming the line at fault.
    """
    moves: list[list[float]] = []
    seen: list[tuple[float, ...]] = []
    pose_of: dict[int, int] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        columns = {"ODOMETRY": _ODOMETRY, "LANDMARK": _LANDMARK}.get(words[0])
        if columns is None:
            raise InputError(
                f"{path}:{number}: starts with '{shorten(words[0])}', expected ODOMETRY or LANDMARK"
            )
        if len(words) - 1 != len(columns):
            raise InputError(
                f"{path}:{number}: {len(words) - 1} values after {words[0]}, expected {len(columns)}"
                f" ({', '.join(columns)})"
            )
        values = [
            number_or_fail(word, path, number, name)
            for name, word in zip(columns, words[1:], strict=True)
        ]
        i, j = int(values[0]), int(values[1])
        if columns is _ODOMETRY:
            if not moves:
                pose_of[i] = 0
            if pose_of.get(i) != len(moves):
                raise InputError(f"{path}:{number}: departs from {i}, expected the latest pose")
            pose_of[j] = len(moves) + 1
            upper = values[5:]
            covariance = np.array([[upper[0], upper[1], upper[2]], [upper[1], upper[3], upper[4]],
                                   [upper[2], upper[4], upper[5]]])  # fmt: skip
            if np.linalg.eigvalsh(covariance)[0] <= 0:
                raise InputError(
                    f"{path}:{number}: the covariance is not positive definite, expected positive "
                    "variances"
                )
            moves.append(values)
        else:
            if i not in pose_of:
                raise InputError(f"{path}:{number}: seen from {i}, which is no pose so far")
            x, y, vxx, vxy, vyy = values[2:]
            if vxx <= 0 or abs(vxy) > 1e-9 * vxx or abs(vxx - vyy) > 1e-9 * vxx:
                raise InputError(
                    f"{path}:{number}: covariance {vxx} {vxy} {vyy}, expected positive and equal in "
                    "every direction"
                )
            distance = float(np.hypot(x, y))
            if distance == 0.0:
                raise InputError(f"{path}:{number}: the landmark lies at the sensor")
            sigma = float(np.sqrt(vxx))
            seen.append((pose_of[i], distance, np.arctan2(y, x), sigma, sigma / distance, j))
    if not moves or not seen:
        raise InputError(f"{path}: expected at least one ODOMETRY and one LANDMARK line")
    return _assemble(path, np.array(moves), np.array(seen))


def _assemble(path: Path, moves: np.ndarray, seen: np.ndarray) -> Log:
    upper = moves[:, 5:]
    covariance = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    seen = seen[np.argsort(seen[:, 0], kind="stable")]
    return Log(
        path.stem.replace("_", "-"),
        "gtsam-2d",
        Prior(0.0, np.zeros(3), _PRIOR_SIGMA**2 * np.eye(3)),
        RelativePoses(np.arange(1.0, len(moves) + 1), moves[:, 2:5], covariance),
        Sightings(
            *seen[:, :5].T,
            seen[:, 5].astype(np.int64),
            np.full(len(seen), np.nan),
        ),
        provenance={"file": path.name, "times": "pose number in place of seconds"},
    )
