"""Nieto 2005, Figs. 2.8 to 2.12 and 3.4: what they claim.

Where the thesis gives no number, "rapidly" and "alike" are taken as a factor of two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from comparisons.arrays import Array
from comparisons.experiments.reproduction.interface import (
    SHARE_WITHIN_3_SIGMA,
    THREE_SIGMA_SQUARED,
    Claim,
    at_least,
    at_most,
)
from comparisons.experiments.reproduction.nieto_slam import Fixed, LoopDrive, Loops, Moment
from comparisons.statistics import mean_band

NEAR_M, FAR_M = 12.0, 50.0
"""Landmarks nearer than that are close to each other; farther ones are not."""
_TOO_SURE = "EKF-SLAM grows too sure as its heading errs; see `slamcheck montecarlo`"


def _rms(values: Iterable[Array]) -> float:
    """Root mean square of all numbers of several arrays."""
    every = np.concatenate([np.ravel(value) for value in values])
    return float(np.sqrt(np.mean(np.square(every))))


def _far(drives: tuple[LoopDrive, ...], moment: Callable[[LoopDrive], Moment]) -> list[Array]:
    """Per drive, which landmarks of a moment are farthest from the start."""
    return [moment(d).far(d.true_path[0]) for d in drives]


def claims_2_8(loops: Loops) -> list[Claim]:
    """The largest error is at the far side; closing the loop corrects the map."""
    left, right = [], []
    for d in loops.drives:
        east = d.true_path[:, 0]
        open_ = d.poses.time_s <= d.before.time_s
        low, high = np.quantile(east, (1.0 / 3.0, 2.0 / 3.0))
        left.append(d.poses.error[open_ & (east <= low), :2])
        right.append(d.poses.error[open_ & (east >= high), :2])
    before, after = ([getattr(d, name).error_m for d in loops.drives] for name in _SIDES)
    return [
        at_least(
            "before the loop closes the path errs most on its left third (RMS over the right's)",
            _rms(left) / _rms(right),
            1.0,
            why="our loop begins at the right, where the thesis begins at the bottom",
        ),
        at_most(
            "closing the loop reduces the landmarks' error (RMS after over before)",
            _rms(after) / _rms(before),
            1.0,
        ),
    ]


_SIDES = ("before", "after")


def claims_2_9(loops: Loops) -> list[Claim]:
    """Of the far part of the map: errors lie within the ellipses, and both shrink."""
    drives = loops.drives
    far = _far(drives, lambda d: d.before)
    inside = [d.before.squared[f] <= THREE_SIGMA_SQUARED for d, f in zip(drives, far, strict=True)]
    farthest = [
        d.before.squared[np.argmax(np.linalg.norm(d.before.true - d.true_path[0], axis=1))]
        for d in drives
    ]
    error = {
        name: _rms(getattr(d, name).error_m[f] for d, f in zip(drives, far, strict=True))
        for name in _SIDES
    }
    sigma = {
        name: _rms(getattr(d, name).sigma_m[f] for d, f in zip(drives, far, strict=True))
        for name in _SIDES
    }
    return [
        at_least(
            "the far landmarks lie within their 3-sigma ellipses before the loop closes (share, of "
            "the drive drawn)",
            float(inside[0].mean()),
            1.0,
        ),
        at_most(
            "over drives the farthest landmark's error is as large as stated (mean NEES; limit: "
            "upper end of its 95 % band)",
            float(np.mean(farthest)),
            mean_band(len(drives), 2).high,
            why=_TOO_SURE,
        ),
        at_most("their error falls with the closing (ratio)", error["after"] / error["before"], 1),
        at_most(
            "their uncertainty falls with the closing (ratio)",
            sigma["after"] / sigma["before"],
            1.0,
        ),
        at_least(
            "and over all drives as many far landmarks lie within their ellipses as of a Gaussian "
            "(share)",
            float(np.mean(np.concatenate(inside))),
            SHARE_WITHIN_3_SIGMA,
            why="the landmarks of one drive share their error, so that one drive in ten decides "
            "this number; the NEES above takes one landmark a drive",
        ),
    ]


def claims_2_10(loops: Loops) -> list[Claim]:
    """Errors are as large as stated; a landmark's uncertainty only ever falls."""
    drives = loops.drives
    claims = [
        at_least(
            f"the error in {name} stays within 3 sigma (share of all scans of all drives)",
            float(np.mean(np.concatenate([_within(d, i) for d in drives]))),
            0.99,
            why=_TOO_SURE,
        )
        for i, name in enumerate(("east", "north", "heading"))
    ]
    squared = np.array(
        [d.poses.pose.squared[np.searchsorted(d.poses.time_s, d.before.time_s)] for d in drives]
    )
    highest = mean_band(len(drives), 3).high
    growth = max(float(np.max(d.first_landmark_m[1:] / d.first_landmark_m[:-1])) for d in drives)
    return [
        *claims,
        at_most(
            "before the loop closes the pose's error is as large as stated (mean NEES over drives; "
            "limit: upper end of its 95 % band)",
            float(squared.mean()),
            highest,
            why=_TOO_SURE,
        ),
        at_most(
            "a landmark's uncertainty never grows (largest ratio from scan to scan)",
            growth,
            1.0 + 1e-9,
        ),
    ]


def _within(d: LoopDrive, column: int) -> NDArray[np.bool_]:
    return np.abs(d.poses.error[:, column]) <= 3.0 * d.poses.sigma[:, column]


def claims_2_11(loops: Loops) -> list[Claim]:
    """The map grows more correlated by the closing, and by every further loop."""
    before, after, end = (
        np.array([getattr(d, name).mean_correlation for d in loops.drives])
        for name in ("before", "after", "end")
    )
    quarter = [len(d.quarter.landmark) / len(d.before.landmark) for d in loops.drives]
    return [
        at_most("after a quarter of the loop not all landmarks are in (share)", max(quarter), 0.99),
        at_least(
            "closing the loop makes the map more correlated (mean coefficient, least ratio)",
            float(np.min(after / before)),
            1.0,
        ),
        at_least(
            "further loops make it more correlated still (mean coefficient, least ratio)",
            float(np.min(end / after)),
            1.0,
        ),
    ]


def claims_2_12(found: Fixed) -> list[Claim]:
    """A few absolute observations take the correlation away."""
    return [
        at_most(
            f"{len(found.fix_s)} positions reduce the map's correlation rapidly (mean coefficient, "
            "after over before)",
            found.after.mean_correlation / found.before.mean_correlation,
            0.5,
        )
    ]


def claims_3_4(loops: Loops) -> list[Claim]:
    """What is close is correlated, equally uncertain, and corrected alike."""
    near_rho, far_rho, near_sigma, far_sigma, near_move, moved = [], [], [], [], [], []
    for d in loops.drives:
        m = d.before
        first, second = np.triu_indices(len(m.landmark), 1)
        apart = np.linalg.norm(m.landmark[first] - m.landmark[second], axis=1)
        rho = m.coefficients[3:, 3:]
        both = 0.5 * (rho[::2, ::2] + rho[1::2, 1::2])[first, second]
        unlike = np.abs(np.log(m.sigma_m[first] / m.sigma_m[second]))
        move = d.after.landmark[: len(m.landmark)] - m.landmark
        differing = np.linalg.norm(move[first] - move[second], axis=1)
        near, far = apart <= NEAR_M, apart >= FAR_M
        near_rho.append(both[near])
        far_rho.append(both[far])
        near_sigma.append(unlike[near])
        far_sigma.append(unlike[far])
        near_move.append(differing[near])
        moved.append(np.linalg.norm(move, axis=1))
    return [
        at_least(
            f"landmarks within {NEAR_M:.0f} m of each other are highly correlated (mean)",
            float(np.mean(np.concatenate(near_rho))),
            0.9,
            why="those around the start are known too well to share an error",
        ),
        at_most(
            f"those more than {FAR_M:.0f} m apart are less so (mean over the near ones')",
            float(np.mean(np.concatenate(far_rho)) / np.mean(np.concatenate(near_rho))),
            1.0,
        ),
        at_most(
            "close landmarks are about equally uncertain (log ratio of sigmas, near over far)",
            _rms(near_sigma) / _rms(far_sigma),
            0.5,
        ),
        at_most(
            "the closing moves close landmarks alike (difference over motion, RMS)",
            _rms(near_move) / _rms(moved),
            0.5,
        ),
    ]
