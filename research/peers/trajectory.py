"""The trajectory part of `slamcheck check` against evo's `evo_ape`, on 60,000 poses.

    python -m research.peers --only trajectory

Both read the true and the estimated trajectory (TUM files), pair them by time, and find the
absolute error as it is after the rigid motion that fits best. Ours reads an estimate folder, whose
covariances evo does not know, and finds beside it the error without the motion, the relative errors
over 10 m and the NEES of every pose. Once whole programs, their imports included; once in this
process, imports left out. Both must find the same error to 1e-9 m.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import assess
from comparisons.checks.consistency.nees import against_truth
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import read_external
from comparisons.estimates.folder import tum_text, write_estimate
from comparisons.estimates.trajectory_files import read_trajectory_file
from comparisons.logs.log import LandmarkMeasurements, Log, Poses, Prior, Truth
from comparisons.logs.odometry import OdometryNoise, VelocityOdometry
from research.timing import MissingError, Spent, TimedPair, here, run

POSES = 60_000
INSTALL = "evo not installed: make peers"
AGREE_M = 1e-9


def write_pair(folder: Path, count: int) -> None:
    """Write `truth.txt`, `estimate.txt` and the estimate folder `estimate` of a drive at 10 Hz."""
    rng = np.random.default_rng(0)
    time_s: Array = 1000.0 + 0.1 * np.arange(count, dtype=float)
    heading = np.cumsum(rng.normal(0.0, 0.02, count))
    step = 0.1 * np.column_stack((np.cos(heading), np.sin(heading)))
    true = np.column_stack((np.cumsum(step, axis=0), heading))
    sigma = np.array((1e-3, 1e-3, 2e-5))
    pose = true + np.cumsum(sigma * rng.standard_normal((count, 3)), axis=0)
    covariance = np.diag(sigma**2) * (1.0 + np.arange(count))[:, None, None]
    (folder / "truth.txt").write_text(tum_text(time_s, true), encoding="utf-8")
    (folder / "estimate.txt").write_text(tum_text(time_s, pose), encoding="utf-8")
    estimate = Estimate(
        time_s=time_s,
        pose=pose,
        pose_covariance=covariance,
        landmark_id=np.zeros(0, dtype=np.int64),
        landmark=np.zeros((0, 2)),
        joint_covariance=covariance[-1],
        information="filtered",
    )
    write_estimate(estimate, folder / "estimate")


def truth_alone(path: Path) -> Log:
    """A log of a trajectory file's poses as truth, and no more than a log must have."""
    time_s, pose, *_ = read_trajectory_file(path)
    one, noise = np.ones(1), OdometryNoise(0.1, 0.1)
    return Log(
        name="truth",
        format="tum",
        prior=Prior(float(time_s[0]), pose[0], np.eye(3)),
        odometry=VelocityOdometry(time_s[:1], one, one, noise),
        measurements=LandmarkMeasurements(
            time_s=time_s[:1],
            range_m=one,
            bearing_rad=one,
            sigma_range_m=one,
            sigma_bearing_rad=one,
            landmark=np.zeros(1, dtype=np.int64),
            diameter_m=one,
        ),
        truth=Truth(poses=Poses(time_s, pose)),
    )


def check_trajectory(folder: Path) -> tuple[float, float | None]:
    """Return the aligned absolute error [m] and the pose's mean NEES, as `check` finds them."""
    given = read_external(folder / "estimate").padded()
    log = truth_alone(folder / "truth.txt")
    accuracy = assess(given, log, labelled=True)
    consistency = against_truth(given, log, labelled=True)
    assert accuracy is not None
    assert accuracy.ate_aligned_m is not None
    assert consistency is not None
    assert consistency.poses is not None
    return accuracy.ate_aligned_m, consistency.poses.pose.mean


def evo_program() -> Path:
    """`evo_ape` beside this Python or on the path. Raises MissingError."""
    beside = Path(sys.executable).with_name("evo_ape")
    found = str(beside) if beside.is_file() else shutil.which("evo_ape")
    if found is None:
        raise MissingError(INSTALL)
    return Path(found)


def evo_in_process(folder: Path) -> Callable[[], float]:
    """Return a call of what `evo_ape -a` does behind its imports. Raises MissingError."""
    try:
        from evo.core import metrics, sync
        from evo.main_ape import ape
        from evo.tools import file_interface
    except ModuleNotFoundError:
        raise MissingError(INSTALL) from None
    read: Callable[[str], Any] = file_interface.read_tum_trajectory_file

    def call() -> float:
        pair = [read(str(folder / name)) for name in ("truth.txt", "estimate.txt")]
        reference, theirs = sync.associate_trajectories(*pair, max_diff=0.01)
        relation = metrics.PoseRelation.translation_part
        return float(ape(reference, theirs, relation, align=True).stats["rmse"])

    return call


def rows(*, quick: bool) -> list[TimedPair]:
    """Return the pairs; `quick` has few poses. Raises MissingError."""
    program, count = evo_program(), 600 if quick else POSES
    folder = Path(tempfile.mkdtemp(prefix="peer-evo-"))
    write_pair(folder, count)
    theirs = evo_in_process(folder)

    def evo() -> tuple[Spent, float]:
        home = ("env", f"HOME={folder}")  # where it keeps its settings
        done = run((*home, program, "tum", folder / "truth.txt", folder / "estimate.txt", "-a"))
        found = re.search(r"rmse\s+([\d.]+)", done.printed)
        assert found, done.printed
        return done.spent, float(found[1])

    def notes() -> list[str]:
        ate_m, nees = check_trajectory(folder)
        other = theirs()
        assert abs(ate_m - other) <= AGREE_M, (ate_m, other)
        assert abs(ate_m - evo()[1]) <= 1e-6  # as printed
        return [
            f"both find {ate_m:.9f} m, {abs(ate_m - other):.1e} apart; ours a NEES of {nees:.3f}"
        ]

    evo()  # the first run writes its settings
    words = (sys.executable, "-m", "research.peers.trajectory", folder)
    whole = TimedPair(
        name="evo_ape -a, whole program",
        work=f"{count:,} poses; ours with relative errors and NEES",
        ours=lambda: run(words).spent,
        theirs=lambda: evo()[0],
        goal=1.0,
        notes=notes,
    )
    inside = replace(
        whole,
        name="evo_ape -a, without imports",
        ours=here(lambda: check_trajectory(folder)),
        theirs=here(theirs),
        notes=tuple,
    )
    return [whole, inside]


def main() -> None:
    """Do our part once, of the pair in the folder that is named."""
    error, nees = check_trajectory(Path(sys.argv[1]))
    print(f"aligned error {error:.9f} m, mean NEES {nees:.3f}")


if __name__ == "__main__":
    main()
