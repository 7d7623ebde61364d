"""Whether the filter is as sure as it may be: by truth, by innovations, by the smoother."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.arrays import Array
from comparisons.checks.consistency.filter_smoother import (
    FilterAgainstSmoother,
    filter_against_smoother,
)
from comparisons.checks.consistency.nees import TruthConsistency, against_truth, limit
from comparisons.estimates.estimate import Estimate
from comparisons.figures import rounded
from comparisons.innovations import InnovationLog, SensorInnovations, whiten_alone
from comparisons.logs.log import Log
from comparisons.plane import pose_difference
from comparisons.shown import Brief
from comparisons.statistics import WORDS, Band, BlockDeparture, Nis
from ekf_reference.core.landmark_types import POINT

if TYPE_CHECKING:
    from comparisons.estimates.external import ExternalEstimate
    from comparisons.estimates.reference import Reference
    from comparisons.pipeline.known import EstimateUnderCheck, Known

_SURER = 0.05
"""Of the epochs: so many with a filter more certain than the smoother make it inconsistent."""


@dataclass(frozen=True, repr=False)
class Consistency(Brief):
    """What says how sure the filter may be.

    ekf, smoother: NEES against truth, where there is any. sensors: the filter's innovations.
    smoothed: the filter's poses against the smoother's; None where these do not rest on the same
    data, all of it, or are weighted by a robust kernel. gated: association may have left out, or
    shortened, large innovations.
    """

    ekf: TruthConsistency | None
    smoother: TruthConsistency | None
    sensors: tuple[SensorInnovations, ...]
    smoothed: FilterAgainstSmoother | None
    gated: bool

    @property
    def bands(self) -> int:
        """How many of NIS are judged: of every sensor together, and by component."""
        return sum(len(sensor.nis) for sensor in self.sensors)

    @property
    def outside(self) -> float:
        """Share of sound runs that leave one of these, such that all hold in 99.9 % (Bonferroni).

        What words say rests on such bands; figures have the 95 % band of each.
        """
        return WORDS / max(self.bands, 1)

    @property
    def remarks(self) -> list[str]:
        """What is out of its band, in words; nothing of this changes a verdict."""
        reported = [remark for sensor in self.sensors for remark in self._of(sensor)]
        reported += [
            f"{sensor.unusable} {sensor.sensor} have an innovation covariance that is not positive "
            "definite; the NIS leaves them out"
            for sensor in self.sensors
            if sensor.unusable
        ]
        if self.smoothed is not None and len(overconfident := self.smoothed.overconfident):
            worst = int(np.argmin(self.smoothed.ratio))
            reported.append(
                f"at {len(overconfident)} of {len(self.smoothed.time_s)} epochs, first at "
                f"{self.smoothed.time_s[overconfident[0]]:.1f} s, the filter is more certain of "
                "its pose than the smoother, which also uses later measurements: at "
                f"{self.smoothed.time_s[worst]:.1f} s the filter's variance is "
                f"{self.smoothed.ratio[worst]:.2g} times the smoother's"
            )
        return reported

    def _of(self, sensor: SensorInnovations) -> list[str]:
        """The components out of their bands, or both together where neither alone is."""
        found = [(nis, *nis.worded(self.outside)) for nis in sensor.nis]
        off = [one for one in found[1:] if one[1] != "plausible"] or [
            one for one in found[:1] if one[1] != "plausible"
        ]
        return [self._remark(sensor.sensor, *one) for one in off]

    def _remark(self, sensor: str, nis: Nis, reading: str, band: Band) -> str:
        of = nis.name if nis.name == sensor else f"{nis.name} ({sensor})"
        meaning = f"{reading}: larger innovations than the filter states"
        if reading == "too low":
            meaning = f"{reading}: smaller innovations than the filter states"
        if self.gated and reading == "too low" and sensor == "measurements":
            meaning += ", or the association rejects the large ones"
        joint = f"joint 99.9 % band of {self.bands} tests" if self.bands > 1 else "99.9 % band"
        return (
            f"mean NIS of {of} {nis.mean:.3g}, expected {nis.expected_words}, "
            f"band {band.low:.3g} to {band.high:.3g}, is {meaning} "
            f"(of {nis.count:,} innovations; {joint})"
        )


def check_innovations(run: EkfRun) -> tuple[SensorInnovations, ...]:
    """Of all measurements of mapped landmarks, and of the positions fused, where there are any."""
    line, trace, found = run.timeline, run.trace, []
    new = trace.initialisations[POINT]
    initialised = np.full(int(new.landmark_index.max(initial=-1)) + 1, -1, dtype=np.intp)
    initialised[new.landmark_index] = new.number
    for name, r, epoch in (
        ("measurements", trace.measurements[POINT], line.measurement_epoch),
        ("positions", trace.positions, line.position_epoch),
    ):
        alone = whiten_alone(r.innovation, r.spread, r.noise, r.weight)
        whitened = np.where((r.weight < 1.0)[:, None], alone, r.whitened).ravel()
        time_s, rows = line.epoch_time_s[epoch[r.number]], np.arange(len(r.number))
        log = InnovationLog(name, run.sensors[name])
        if len(rows):
            log.add(rows, time_s, whitened, number=r.number, landmark=r.landmark_index)
            found.append(log.judge(initialised))
    return tuple(one for one in found if one.nis)


def check_consistency(
    log: Log, run: EkfRun, smoothed: Estimate | None, *, labelled: bool, robust: str = "none"
) -> Consistency:
    """Everything the log allows. labelled: see accuracy.assess. robust: the smoother's kernel."""
    e = run.estimate
    compared = None
    if smoothed is not None and smoothed.information == "smoothed" and robust == "none":
        compared = filter_against_smoother(
            e.time_s, e.pose, e.pose_covariance, smoothed.pose, smoothed.pose_covariance
        )
    return Consistency(
        against_truth(e, log, labelled=labelled),
        None if smoothed is None else against_truth(smoothed, log, labelled=labelled),
        check_innovations(run),
        compared,
        not labelled,
    )


@dataclass(frozen=True, kw_only=True, repr=False)
class ExternalConsistency(Consistency):
    """How an external estimate errs, and whether it is as sure as it may be.

    ekf is the estimate; where no covariances were handed in, there are errors and no NEES. smoothed
    is None where Cov(difference) = P_given - P_smoother need not hold, for the reason unjudged.
    time_s: (K,) its poses in the log's time; difference: (K, 3) of these from the smoother's.
    """

    time_s: Array
    difference: Array
    unjudged: str


def external_consistency(known: Known, judged: EstimateUnderCheck) -> ExternalConsistency:
    """Everything the log and an estimate that is judged allow."""
    labelled, robust = known.prepared.labelled, known.result.options.robust
    given, optimum, log = judged.inside, judged.optimum, known.prepared.log
    reason, compared = _unjudged(given, optimum, judged.information), None
    if not reason and not labelled:
        reason = "without labels filter and smoother may use different associations"
    if not reason and (known.smoothed.information != "smoothed" or robust != "none"):
        reason = "the smoother does not weight the measurements as a filter does"
    if not reason and given.pose_covariance is not None:
        at = optimum.known
        compared = filter_against_smoother(
            given.time_s[at], given.pose[at], given.pose_covariance[at],
            optimum.pose[at], optimum.pose_covariance[at],
        )  # fmt: skip
    estimate = given.padded()
    if given.joint_covariance is None:
        estimate = replace(
            estimate, landmark_id=estimate.landmark_id[:0], landmark=estimate.landmark[:0]
        )
    truth = against_truth(estimate, log, labelled=labelled)
    if truth is not None and truth.pose is not None and not truth.pose.count:
        truth = replace(truth, pose=None, position=None, heading=None, departure=None)
    return ExternalConsistency(
        truth,
        against_truth(known.smoothed, log, labelled=labelled),
        judged.sensors,
        compared,
        not labelled,
        time_s=given.time_s,
        difference=pose_difference(given.pose, optimum.pose),
        unjudged=reason,
    )


def _unjudged(given: ExternalEstimate, optimum: Reference, information: str | None) -> str:
    """Why the identity of a filter and a smoother on the same data says nothing here."""
    if given.pose_covariance is None:
        return "the estimate has no pose covariances"
    if information is None:
        return "the estimate does not say whether its poses are filtered (estimate.toml)"
    if information != "filtered":
        return f"the test needs filtered poses, and these are {information}"
    if not optimum.known.any():
        return "no pose has the time of a measurement of the log"
    return ""


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
    found = [] if against is None else _against_truth(against)
    found += [] if smoothed is None else _against_smoother(smoothed)
    for nis in (nis for sensor in consistency.sensors for nis in sensor.nis):
        reading, (low, high) = nis.worded(consistency.outside)
        if reading == "too high" or (reading == "too low" and not consistency.gated):
            found.append(
                f"NIS of {nis.name} {nis.mean / nis.expected:.3g} per degree of freedom, band "
                f"{low / nis.expected:.3g} to {high / nis.expected:.3g}"
            )
    return tuple(found)


def _against_truth(truth: TruthConsistency) -> list[str]:
    found = []
    for what, errors, departure in (
        ("poses", truth.pose, truth.departure), ("landmarks", truth.places, None),
    ):  # fmt: skip
        if errors is not None and errors.mean is not None:
            mean, most = errors.mean / errors.dof, limit(errors.dof) ** 2
            if mean > most:
                found.append(
                    f"NEES of the {what} {rounded(mean)} per degree of freedom, limit "
                    f"{most:.2g}{_where(departure)}"
                )
    return found


def _where(departure: BlockDeparture | None) -> str:
    """In which block, and when."""
    return "" if departure is None else f", {departure.words}"


def _against_smoother(smoothed: FilterAgainstSmoother) -> list[str]:
    found, mean, band = [], smoothed.squared_per_dof, smoothed.band
    if mean is not None and band is not None and not band.holds(mean):
        found.append(
            f"filter-smoother difference {rounded(mean)} per degree of freedom, "
            f"band {band.low:.2g} to {band.high:.2g}{_where(smoothed.departure)}"
        )
    if len(smoothed.overconfident) > _SURER * len(smoothed.time_s):
        found.append(
            f"filter more certain than the smoother at {len(smoothed.overconfident)} of "
            f"{len(smoothed.time_s)} epochs"
        )
    return found
