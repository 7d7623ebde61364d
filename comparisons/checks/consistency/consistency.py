"""Whether the filter is as sure as it may be: by truth, by innovations, by the smoother."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.consistency.filter_smoother import (
    FilterAgainstSmoother,
    filter_against_smoother,
)
from comparisons.checks.consistency.innovations import Nis, SensorInnovations, check_innovations
from comparisons.checks.consistency.nees import TruthConsistency, against_truth
from comparisons.checks.consistency.normalised import WORDS, Band
from comparisons.estimates.estimate import Estimate
from comparisons.logs.log import Log


@dataclass(frozen=True)
class Consistency:
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
        told = [remark for sensor in self.sensors for remark in self._of(sensor)]
        told += [
            f"{sensor.unusable} of the {sensor.sensor} have no positive definite innovation "
            "covariance, and are not in its NIS"
            for sensor in self.sensors
            if sensor.unusable
        ]
        if self.smoothed is not None and len(surer := self.smoothed.surer):
            worst = int(np.argmin(self.smoothed.ratio))
            told.append(
                f"at {len(surer)} of {len(self.smoothed.time_s)} epochs, first at "
                f"{self.smoothed.time_s[surer[0]]:.1f} s, the filter is surer of its pose than the "
                f"smoother, who knows the future as well: by {self.smoothed.ratio[worst]:.2g} in "
                f"variance at {self.smoothed.time_s[worst]:.1f} s"
            )
        return told

    def _of(self, sensor: SensorInnovations) -> list[str]:
        """The components out of their bands, or both together where neither alone is."""
        found = [(nis, *nis.worded(self.outside)) for nis in sensor.nis]
        off = [one for one in found[1:] if one[1] != "plausible"] or [
            one for one in found[:1] if one[1] != "plausible"
        ]
        return [self._remark(sensor.sensor, *one) for one in off]

    def _remark(self, sensor: str, nis: Nis, reading: str, band: Band) -> str:
        of = nis.name if nis.name == sensor else f"{sensor}, {nis.name}"
        meaning = {
            "too high": "larger than the filter expects: a sigma is too small, or the filter too "
            "sure",
            "too low": "smaller than the filter expects: a sigma is too large",
        }[reading]
        if self.gated and reading == "too low" and sensor == "sightings":
            meaning += ", or association left out the large ones"
        return (
            f"NIS of {of} is {nis.mean:.3g} of {nis.dof} (all {self.bands} bands of a run hold "
            f"with 99.9 %, this one from {band.low:.3g} to {band.high:.3g}, {nis.count:,} "
            f"innovations): they are {meaning}"
        )


def check_consistency(
    log: Log, run: EkfRun, smoothed: Estimate, *, labelled: bool, robust: str = "none"
) -> Consistency:
    """Everything the log allows. labelled: see accuracy.assess. robust: the smoother's kernel."""
    e = run.estimate
    compared = None
    if smoothed.information == "smoothed" and robust == "none":
        compared = filter_against_smoother(
            e.time_s, e.pose, e.pose_covariance, smoothed.pose, smoothed.pose_covariance
        )
    return Consistency(
        against_truth(e, log, labelled=labelled),
        against_truth(smoothed, log, labelled=labelled),
        check_innovations(run),
        compared,
        not labelled,
    )
