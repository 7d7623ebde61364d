"""What qualifies a verdict: the smoother against truth, and what nobody has checked.

EKF and smoother share the log, its stated noise and the association; where they agree they may
share a mistake. Truth, labels and the smoother's own association do not share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from pydantic import computed_field

from comparisons.arrays import Array
from comparisons.checks.accuracy import Accuracy, AccuracyFinding, exchanged_labels
from comparisons.checks.association import AssociationFinding, AssociationScore
from comparisons.checks.check import Check
from comparisons.checks.consistency.consistency import Consistency, inconsistencies
from comparisons.checks.consistency.finding import ConsistencyFinding
from comparisons.checks.consistency.nees import TruthConsistency, limit
from comparisons.checks.finding import Absent, Of
from comparisons.checks.unused_positions import UnusedPositions
from comparisons.checks.verdict import Verdict
from comparisons.config import FailOn
from comparisons.figures import Aside, Figure, Key, LeftOut, Less
from comparisons.logs.log import LandmarkMeasurements
from comparisons.words import Cause

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known

V = TypeVar("V", bound=Verdict)

TRUTH_GAP, UNCHECKED = "truth gap", "association unchecked"
CONTRADICTED = "positions contradict"
INCONSISTENT = "filter inconsistent"
WORSE = 2.0
"""So many times the error with labels is a mistake of the association."""
_NONE_FOUND = 3
"""With so many landmarks, of which none is near a true one, the map is wrong as a whole."""


@dataclass(frozen=True)
class Distance:
    """The smoother's poses or landmarks compared with truth.

    Attributes:
        what: poses or landmarks.
        sigma: root of the mean NEES over its degrees of freedom.
        limit: the largest value that a sound run reaches.
        error_m: root mean square error.
        labels_m: the same with the log's labels, where the run has not used them.
    """

    what: Key[str]
    sigma: Less[Figure]
    limit: LeftOut[float]
    error_m: Less[float]
    labels_m: Less[float | None] = None

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
    """The smoother compared with truth, or with itself by the log's labels where there is none.

    Attributes:
        stands: the smoother is far from truth, by its covariance or by what labels reach, and by
            more than `measurement_m`; or it is lost.
        distances: distances of poses and landmarks.
        measurement_m: the error of a single measurement.
        lost: no landmark is near a true one.
        reference: what it is compared with, in words.
        association: of the filter, against the log's labels; no part of a result file.
        found: rows of the prior's covariance, and labels, that the truth exchanges; neither.
    """

    distances: tuple[Distance, ...]
    measurement_m: LeftOut[float]
    lost: bool = False
    association: Aside[AssociationScore | None] = None
    reference: str = "the truth"
    found: Aside[tuple[str, ...]] = ()

    @computed_field
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
        """Far by its covariance only, and by less than one measurement errs."""
        return not self.stands and any(d.far for d in self.distances)

    @property
    def cause(self) -> Cause | None:
        """Why it stands, None where it does not."""
        if not self.stands:
            return None
        parts = list(self.found)
        parts += [
            f"the RMS error of its {d.what} is {d.error_m:.2g} m, {d.sigma:.1f} times what its "
            "covariance states"
            + (f" (with the log's labels {d.labels_m:.2g} m)" if d.labels_m is not None else "")
            for d in self.distances
            if d.off
        ]
        if self.lost:
            parts.append("none of its landmarks lies near a true landmark")
        hint = "check the stated noise, the models and the start pose, which EKF and smoother share"
        if self.association is not None:
            pairs = self.association.landmarks
            parts.append(
                f"of the pairs of measurements that the association assigns to one landmark, "
                f"{100.0 * pairs.precision:.1f} % have the same label, and it finds "
                f"{100.0 * pairs.recall:.1f} % of the pairs with the same label"
            )
            hint = (
                "check the association, which EKF and smoother share: use the log's labels or a "
                "stricter association, and compare with the smoother's own"
            )
        return Cause(
            "truth",
            f"the smoother is far from {self.reference}: {'; '.join(parts)}; the sigma of a single "
            f"measurement is {self.measurement_m:.2g} m",
            hint,
        )


class TruthGapFinding(Of[TruthGap]):
    """The smoother against truth, or itself by the log's labels: a qualifier where it stands."""


class CheckTruthGap(Check):
    """Is the smoother near the truth, or near what it finds with the log's labels?"""

    name = "truth_gap"
    needs = "truth, or labels that the run has not used"
    errs = "1 of 1,000 sound runs is farther from the truth than the limit of its NEES"
    figures = (("truth_gap", TruthGap),)

    def find(self, known: Known) -> TruthGapFinding | Absent:
        """Return S against truth, or else against labels, where S has not used them."""
        prepared, smoothed = known.prepared, known.smoothed
        places = known.result.problem.pose_landmarks.covariance[:, :2, :2]
        accuracy, consistency = known.value(AccuracyFinding), known.value(ConsistencyFinding)
        association = known.value(AssociationFinding)
        scale_m = measurement_scale(prepared.log.measurements, places)
        gap = truth_gap(
            None if accuracy is None else accuracy[known.called],
            None if consistency is None else consistency.smoother,
            association,
            scale_m,
            len(smoothed.landmark),
        )
        if gap is not None and not scale_m:
            return Absent("no landmark is measured, so that no sigma says which error is small")
        labelled = prepared.log.measurements.labelled and not prepared.labelled
        if labelled and not (gap and gap.settled):
            from comparisons.checks.truth_by_labels import labels_gap, with_labels

            gap = labels_gap(known, association) if gap is None else with_labels(known, gap)
        if gap is None:
            return Absent("the log has neither truth nor labels that nobody has used")
        if gap.stands:
            from comparisons.checks.diagnosis.first_pose import rows_by_truth

            log = prepared.log
            rows = rows_by_truth(log.prior, log.truth.poses)
            labels = exchanged_labels(smoothed, log, labelled=prepared.labelled)
            gap = replace(gap, found=tuple(filter(None, (rows, labels))))
        return TruthGapFinding(gap, entries={"truth_gap": gap})


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
    pose, places = (None, None) if consistency is None else (consistency.pose, consistency.places)
    framed = accuracy.ate_m is not None  # else nothing tells where the log starts
    map_m = accuracy.landmark_rmse_m if framed else accuracy.landmark_rmse_aligned_m
    for what, errors, metres in (("poses", pose, accuracy.ate_m), ("landmarks", places, map_m)):
        if errors is not None and errors.mean is not None and metres is not None:
            sigma = float(np.sqrt(errors.mean / errors.dof))
            found.append(Distance(what, sigma, limit(errors.dof), metres))
    true = accuracy.landmarks_true
    lost = true is not None and not accuracy.landmarks_found and min(true, landmarks) >= _NONE_FOUND
    return TruthGap(
        distances=tuple(found), measurement_m=measurement_m, lost=lost, association=association
    )


def measurement_scale(measurements: LandmarkMeasurements, places: Array) -> float:
    """Median standard deviation [m] of the place that one measurement gives.

    places: (N, 2, 2) covariances of measured pose landmarks, which count without measurements.
    """
    if len(measurements.time_s):
        spread = np.hypot(
            measurements.sigma_range_m, measurements.range_m * measurements.sigma_bearing_rad
        )
        return float(np.median(spread))
    return float(np.median(np.sqrt(np.trace(places, axis1=1, axis2=2)))) if len(places) else 0.0


def against_optimum(gap: TruthGap | None, unused: UnusedPositions | None) -> dict[str, Cause]:
    """Return what speaks against the smoother's optimum, by the qualifier's name."""
    causes = {
        TRUTH_GAP: None if gap is None else gap.cause,
        CONTRADICTED: None if unused is None else unused.cause,
    }
    return {name: cause for name, cause in causes.items() if cause is not None}


def qualified(
    verdict: V,
    gap: TruthGap | None,
    *,
    unchecked: str,
    consistency: Consistency | None,
    fail_on: Sequence[FailOn],
    unused: UnusedPositions | None = None,
) -> V:
    """Return the verdict with its qualifiers, and with what it fails on.

    That is what `fail_on` names, and positions that contradict the optimum. unchecked: why nobody
    has checked the association; empty where somebody has, or need not. unused: positions that no
    estimator has used.
    """
    against = against_optimum(gap, unused)
    outside = None if consistency is None else inconsistencies(consistency)
    rough = [_rough(gap)] if gap is not None and gap.rough else []
    found = {
        **dict.fromkeys(against, True),
        UNCHECKED: bool(unchecked),
        INCONSISTENT: bool(outside),
    }
    of: dict[FailOn, bool] = {
        "disagreement": verdict.outcome == "disagree",
        "consistency": found[INCONSISTENT],
        "truth": TRUTH_GAP in against,
        "association": found[UNCHECKED],
        "positions": CONTRADICTED in against,
    }
    return replace(
        verdict,
        causes=(*verdict.causes, *against.values()),
        remarks=(*verdict.remarks, *rough, *filter(None, [unchecked])),
        qualifiers=tuple(name for name, stands in found.items() if stands),
        inconsistent=outside,
        failed_on=tuple(one for one in dict.fromkeys((*fail_on, "positions")) if of[one]),
    )


def _rough(gap: TruthGap) -> str:
    worst = max(gap.distances, key=lambda d: d.sigma / d.limit)
    return (
        f"the RMS error of the smoother's {worst.what} is {worst.error_m:.2g} m: less than the "
        f"sigma of a single measurement ({gap.measurement_m:.2g} m), but {worst.sigma:.1f} times "
        "what its covariance states"
    )
