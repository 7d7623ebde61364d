"""EKF on wheels, smoother on wheels, smoother on scans: do they agree on the landmarks?

The smoother on scans shares the measurements with the other two, but not what the vehicle's motion
rests on. A difference that the stated sigmas do not cover says that one of the two kinds of
motion is not what it says of itself; which one, its own chi-square or the truth shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from comparisons.checks.accuracy import Accuracy
from comparisons.checks.map_agreement import MapPair
from comparisons.estimates.estimate import Estimate
from comparisons.figures import Aside, Same
from comparisons.words import Cause
from graphslam.optimum import Optimality, chi_square_test
from graphslam.smoother import SmootherEvidence

_CLEARLY = 1.5
"""Of two errors, one so many times the other shows the worse motion."""


@dataclass(frozen=True, kw_only=True)
class ThreeWay:
    """Entry `three_way`: EKF and smoother on wheels, each compared with the smoother on scans.

    Attributes:
        ekf: EKF on wheels and smoother on scans.
        smoother: smoother on wheels and smoother on scans.
        loops: loop closures.
        verified: whether the optimum on scans is verified.
        chi2: chi-square on scans, with closures under their robust kernel, which only lowers it.
        dof: its degrees of freedom.
        accuracy: errors of the smoother on scans.
        inconsistent_source: the motion that is wrong, `wheels` or `scans`; empty where the maps
            agree, or nothing shows which one is wrong.
        evidence: what shows it.
        too_high: whether that chi-square is.
        estimate: of the smoother on scans.
    """

    ekf: MapPair
    smoother: MapPair
    loops: int
    verified: bool
    chi2: Same[float]
    dof: int
    accuracy: Accuracy | None
    inconsistent_source: str
    evidence: str
    too_high: Aside[bool]
    estimate: Aside[Estimate]

    @property
    def remarks(self) -> list[str]:
        """How far this estimate can be trusted."""
        remarks = []
        if not self.verified:
            remarks.append(
                "the optimum of the smoother on scans is not verified, so the verdict ignores "
                "its map"
            )
        if self.too_high:
            remarks.append(
                f"on scans, chi-square {self.chi2:.0f} for {self.dof} degrees of freedom is too "
                "high: the sigmas of the scan odometry are too small, or scans and measurements "
                "contradict each other"
            )
        return remarks


def readable(result: SmootherEvidence) -> Optimality:
    """The optimality check with a chi-square that counts its degrees of freedom, kernels or not.

    A robust kernel only lowers the error, so what is too high under it is so without it.
    """
    problem = result.problem
    dof = problem.residual_dimension - problem.state_dimension
    return replace(result.optimality, chi_square=chi_square_test(result.error, dof))


def find_inconsistent_source(
    wheels: Optimality,
    scans: Optimality,
    accuracy_wheels: Accuracy | None,
    accuracy_scans: Accuracy | None,
) -> tuple[str, str]:
    """Whose motion is to blame for a disagreement, and the evidence; `` when nothing shows it.

    wheels, scans: with a chi-square that can be read, see readable.
    """
    for name, optimality in (("wheels", wheels), ("scans", scans)):
        other = scans if name == "wheels" else wheels
        if optimality.chi_square.reading == "too high" and other.chi_square.reading != "too high":
            test = optimality.chi_square
            return name, (
                f"chi-square with the motion from {name} is too high, {test.chi2:.0f} for "
                f"{test.dof} degrees of freedom"
            )
    figures = ("ate_aligned_m", "gps_rms_aligned_m", "landmark_rmse_aligned_m")
    for figure in figures:
        w, s = (getattr(a, figure, None) for a in (accuracy_wheels, accuracy_scans))
        if w is not None and s is not None and max(w, s) > _CLEARLY * min(w, s):
            name = "wheels" if w > s else "scans"
            return name, f"{figure} is {w:.3f} on wheels and {s:.3f} on scans"
    return "", "neither chi-square nor a reference shows which of the two is wrong"


def motion_cause(three_way: ThreeWay) -> Cause:
    """Wheels against scans."""
    pair = three_way.ekf
    hint = {
        "wheels": (
            "check the wheel odometry: its sigmas, the wheelbase, the scale of speed and yaw rate"
        ),
        "scans": (
            "check the scan odometry: the factor of its sigmas, unobservable directions, "
            "failed scans"
        ),
        "": "compare both with GPS or truth, and check the sigmas of both",
    }[three_way.inconsistent_source]
    return Cause(
        "motion",
        f"EKF on wheels and smoother on scans differ by {pair.rms_m:.3f} m RMS, {pair.outside} of "
        f"{pair.landmarks} landmarks lie outside their 99 % region; {three_way.evidence}",
        hint,
    )
