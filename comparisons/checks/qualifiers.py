"""What qualifies a verdict: the smoother against truth, and what nobody has checked.

EKF and smoother share the log, its stated noise and the association; where they agree they may
share a mistake. Truth, labels and the smoother's own association do not share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy
from comparisons.checks.association import AssociationScore
from comparisons.checks.causes import Cause
from comparisons.checks.consistency.consistency import Consistency
from comparisons.checks.consistency.filter_smoother import FilterAgainstSmoother
from comparisons.checks.consistency.nees import TruthConsistency
from comparisons.checks.verdict import Verdict, rounded
from comparisons.config import FailOn
from comparisons.logs.log import LandmarkMeasurements
from comparisons.statistics import chi2_quantile

TRUTH_GAP, UNCHECKED = "truth gap", "association unchecked"
INCONSISTENT = "filter inconsistent"
WORSE = 2.0
"""So many times the error with labels is a mistake of the association."""
_SHARE = 0.999
"""Of the sound runs that stay within the limit. The errors of one run depend on each other, hence
the limit of one value, not of an average of independent ones."""
_SURER = 0.05
"""Of the epochs: so many with a filter more certain than the smoother make it inconsistent."""
_NONE_FOUND = 3
"""With so many landmarks, of which none is near a true one, the map is wrong as a whole."""


def limit(dof: int) -> float:
    """Root of a mean NEES over its degrees of freedom that a sound run hardly passes."""
    return float(np.sqrt(chi2_quantile(_SHARE, dof) / dof))


@dataclass(frozen=True)
class Distance:
    """How far the smoother is from the truth in one kind of unknowns.

    what: they are. sigma: root of the mean NEES over `dof`. error_m: root mean square; labels_m:
    the same of the smoother with the log's labels, where S has not used them.
    """

    what: str
    dof: int
    sigma: float
    error_m: float
    labels_m: float | None = None

    @property
    def limit(self) -> float:
        """The sigma that a sound run hardly passes."""
        return limit(self.dof)

    @property
    def far(self) -> bool:
        """By its own covariance."""
        return self.sigma > self.limit

    @property
    def worse(self) -> bool:
        """By what the same smoother reaches with the log's labels."""
        return self.labels_m is not None and self.error_m > WORSE * self.labels_m

    @property
    def off(self) -> bool:
        """By either."""
        return self.far or self.worse


@dataclass(frozen=True, kw_only=True)
class TruthGap:
    """S against truth, or against the smoother with the log's labels where there is no truth.

    measurement_m: standard deviation of the place that a single measurement gives, the scale in
    metres.
    lost: no landmark is near a true one. association: of the filter, against the log's labels.
    reference: what the smoother is compared with.
    """

    distances: tuple[Distance, ...]
    measurement_m: float
    lost: bool = False
    association: AssociationScore | None = None
    reference: str = "the truth"

    @property
    def stands(self) -> bool:
        """Off, and by more than one measurement may err."""
        return self.lost or any(d.off and d.error_m > self.measurement_m for d in self.distances)

    @property
    def settled(self) -> bool:
        """The log's labels could not make it stand, nor fall: it does, or all errors are small."""
        return self.stands or all(d.error_m <= self.measurement_m for d in self.distances)

    @property
    def rough(self) -> bool:
        """Far by its covariance only: the stated sigmas are too small, the estimate is good."""
        return not self.stands and any(d.far for d in self.distances)


def truth_gap(
    accuracy: Accuracy | None,
    consistency: TruthConsistency | None,
    association: AssociationScore | None,
    measurement_m: float,
    landmarks: int,
) -> TruthGap | None:
    """Return S against truth, None where the log has none. landmarks: of S."""
    if accuracy is None or (accuracy.ate_m is None and accuracy.landmarks_true is None):
        return None
    found = []
    poses = None if consistency is None else consistency.poses
    mapped = None if consistency is None else consistency.map
    for what, errors, metres in (
        ("poses", None if poses is None else poses.pose, accuracy.ate_m),
        ("landmarks", None if mapped is None else mapped.landmarks, accuracy.landmark_rmse_m),
    ):
        if errors is not None and errors.mean is not None and metres is not None:
            sigma = float(np.sqrt(errors.mean / errors.dof))
            found.append(Distance(what, errors.dof, sigma, metres))
    true = accuracy.landmarks_true
    lost = true is not None and not accuracy.landmarks_found and min(true, landmarks) >= _NONE_FOUND
    return TruthGap(
        distances=tuple(found), measurement_m=measurement_m, lost=lost, association=association
    )


def measurement_scale(seen: LandmarkMeasurements, places: Array) -> float:
    """Median standard deviation [m] of the place that one measurement gives.

    places: (N, 2, 2) covariances of measured pose landmarks, which count without measurements.
    """
    if len(seen.time_s):
        spread = np.hypot(seen.sigma_range_m, seen.range_m * seen.sigma_bearing_rad)
        return float(np.median(spread))
    return float(np.median(np.sqrt(np.trace(places, axis1=1, axis2=2)))) if len(places) else 0.0


def inconsistencies(consistency: Consistency) -> tuple[str, ...] | None:
    """Return what is outside its band: the filter's NEES, filter against smoother, NIS.

    None where there is none of these.

    An association that leaves out large innovations makes the NIS too low, which does not count.
    The bands of NIS are those of the notes: all of them hold in 99.9 % of sound runs. The band of
    filter against smoother is the figure's: 5 of 520 sound runs leave it, since its independent
    epochs are counted low. A filter more certain than the smoother counts from one epoch in twenty
    on, the NEES from the limit of the truth gap.
    """
    against, smoothed = consistency.ekf, consistency.smoothed
    if against is None and smoothed is None and not consistency.sensors:
        return None
    far, found = [], []
    if against is not None and against.poses is not None:
        far.append(("poses", against.poses.pose))
    if against is not None and against.map is not None:
        far.append(("landmarks", against.map.landmarks))
    for what, errors in far:
        if errors.mean is not None and errors.mean / errors.dof > limit(errors.dof) ** 2:
            found.append(
                f"NEES of the {what} {rounded(errors.mean / errors.dof)} per degree of freedom, "
                f"limit {limit(errors.dof) ** 2:.2g}"
            )
    if smoothed is not None:
        found += _against_smoother(smoothed)
    for nis in (nis for sensor in consistency.sensors for nis in sensor.nis):
        reading, (low, high) = nis.worded(consistency.outside)
        if reading == "too high" or (reading == "too low" and not consistency.gated):
            found.append(
                f"NIS of {nis.name} {nis.mean / nis.dof:.3g} per degree of freedom, band "
                f"{low / nis.dof:.3g} to {high / nis.dof:.3g}"
            )
    return tuple(found)


def _against_smoother(smoothed: FilterAgainstSmoother) -> list[str]:
    found, mean, band = [], smoothed.mean_per_dof, smoothed.band
    if mean is not None and band is not None and not band.holds(mean):
        found.append(
            f"filter-smoother difference {rounded(mean)} per degree of freedom, "
            f"band {band.low:.2g} to {band.high:.2g}"
        )
    if len(smoothed.overconfident) > _SURER * len(smoothed.time_s):
        found.append(
            f"filter more certain than the smoother at {len(smoothed.overconfident)} of "
            f"{len(smoothed.time_s)} epochs"
        )
    return found


def qualified(
    verdict: Verdict,
    gap: TruthGap | None,
    *,
    unchecked: str,
    consistency: Consistency,
    fail_on: Sequence[FailOn],
) -> Verdict:
    """Return the verdict with its qualifiers, and with what it fails on of `fail_on`.

    unchecked: why nobody has checked the association; empty where somebody has, or need not.
    """
    found = []
    causes, remarks = verdict.causes, verdict.remarks
    if gap is not None and gap.stands:
        found.append(TRUTH_GAP)
        causes = (*causes, _cause(gap))
    elif gap is not None and gap.rough:
        remarks = (*remarks, _rough(gap))
    if unchecked:
        found.append(UNCHECKED)
        remarks = (*remarks, unchecked)
    outside = inconsistencies(consistency)
    if outside:
        found.append(INCONSISTENT)
    of: dict[FailOn, bool] = {
        "disagreement": verdict.outcome == "disagree",
        "consistency": bool(outside),
        "truth": TRUTH_GAP in found,
        "association": UNCHECKED in found,
    }
    return replace(
        verdict,
        causes=causes,
        remarks=remarks,
        qualifiers=tuple(found),
        inconsistent=outside,
        failed_on=tuple(one for one in dict.fromkeys(fail_on) if of[one]),
    )


def _cause(gap: TruthGap) -> Cause:
    parts = [
        f"the RMS error of its {d.what} is {d.error_m:.2g} m, {d.sigma:.1f} times what its "
        "covariance states"
        + (f" (with the log's labels {d.labels_m:.2g} m)" if d.labels_m is not None else "")
        for d in gap.distances
        if d.off
    ]
    if gap.lost:
        parts.append("none of its landmarks lies near a true landmark")
    hint = "check the stated noise, the models and the start pose, which EKF and smoother share"
    if gap.association is not None:
        pairs = gap.association.landmarks
        parts.append(
            f"of the pairs of measurements that the association assigns to one landmark, "
            f"{100.0 * pairs.precision:.1f} % have the same label, and it finds "
            f"{100.0 * pairs.recall:.1f} % of the pairs with the same label"
        )
        hint = (
            "check the association, which EKF and smoother share: use the log's labels or a "
            "stricter "
            "association, and compare with --smoother-association own"
        )
    return Cause(
        "truth",
        f"the smoother is far from {gap.reference}: {'; '.join(parts)}; the sigma of a single "
        f"measurement is {gap.measurement_m:.2g} m",
        hint,
    )


def _rough(gap: TruthGap) -> str:
    worst = max(gap.distances, key=lambda d: d.sigma / d.limit)
    return (
        f"the RMS error of the smoother's {worst.what} is {worst.error_m:.2g} m: less than the "
        f"sigma of a single measurement ({gap.measurement_m:.2g} m), but {worst.sigma:.1f} times "
        "what "
        "its covariance states, so the stated sigmas are too small"
    )
