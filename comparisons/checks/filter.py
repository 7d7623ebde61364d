"""The filter that a job has run: its settings, and what it used and rejected."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.check import About
from comparisons.checks.finding import JobPart
from comparisons.checks.position_gate import CheckPositions, PositionsFinding, RejectedFixes
from comparisons.figures import Exact, Model, Named, Same, percent, rows_of
from comparisons.words import Row

if TYPE_CHECKING:
    from comparisons.pipeline.known import Known
    from comparisons.pipeline.prepared import Prepared

_WHOLE = partial(percent, digits=0)


class EkfFigures(Model):
    """The filter: its settings, and what it used and rejected.

    Attributes:
        filter: value of `--filter`.
        association: value of `--association`.
        landmarks: landmarks in the map at the end.
        rejected: measurements that no landmark explains within the gate.
        ambiguous: measurements that several landmarks explain.
        candidate: measurements of landmarks that are not reliable enough for the map yet.
        dynamic: measurements that were discarded since something moves there.
        deactivated: landmarks that are no longer used, since something moves where they stand.
        cut_off: scans in which joint compatibility reached its limit of nodes and took the best set
            so far.
        attributes: whether diameters and intensities entered the association.
        gps: value of `--gps`.
        fixes_fused: absolute positions that were used.
        fixes_rejected: absolute positions that the gate rejected.
        fixes_outside_stretches: absolute positions left out, as they are in no stretch that agrees
            with itself and with SLAM; None where the settings ask for all.
        fixes_in_streaks: rejected positions that are one of five or more in a row.
        longest_streak: most rejected positions in a row.
        fixes_rejected_by_smoother: rejected positions that the same gate also rejects at the
            smoother's optimum.
        updates: updates by measurements of a compressed filter.
        updates_with_passive: those that left landmarks outside the local area passive; in the
            others it is the full filter.
        active_share: share of all states that was active, mean over the updates.
        global_updates: global updates of a compressed filter.
        global_update_spared: share of the passive covariance that they left unchanged (set I): less
            is exact, more is quick.
    """

    filter: Annotated[str, Named("filter", "{}")]
    association: Annotated[str, Named("association", "{}")]
    landmarks: Annotated[Exact[int], Named("point landmarks")]
    rejected: Annotated[int, Named("measurements rejected by the gate")]
    ambiguous: Annotated[int, Named("ambiguous measurements, not used")]
    candidate: Annotated[int, Named("measurements of landmark candidates")]
    dynamic: Annotated[int, Named("measurements of moving objects, left out")] = 0
    deactivated: Annotated[int, Named("landmarks on moving objects, deactivated")] = 0
    cut_off: int = 0
    attributes: Annotated[str, Named("landmark attributes in the association", "{}")] = "off"
    gps: str
    fixes_fused: Annotated[int, Named("GPS positions fused")]
    fixes_rejected: Annotated[int, Named("GPS positions rejected")]
    fixes_outside_stretches: Annotated[
        int | None, Named("GPS positions left out, in no stretch of good ones")
    ] = None
    fixes_in_streaks: Annotated[int, Named("GPS positions rejected five or more in a row")] = 0
    longest_streak: Annotated[int, Named("most GPS positions rejected in a row")] = 0
    fixes_rejected_by_smoother: Annotated[
        int, Named("GPS positions rejected that the smoother's optimum rejects as well")
    ] = 0
    updates: Annotated[int | None, Named("updates")] = None
    updates_with_passive: Annotated[int | None, Named("updates with passive landmarks")] = None
    active_share: Annotated[Same[float | None], Named("share of the state, active", _WHOLE)] = None
    global_updates: Annotated[int, Named("global updates")]
    global_update_spared: Annotated[
        Same[float],
        Named("passive covariance that a global update leaves unchanged", _WHOLE),
    ]

    def rows(self) -> list[Row]:
        """Return rows of the table: the filter, and which measurements it used."""
        names = ["filter", "association", "landmarks", "rejected", "ambiguous", "candidate"]
        if self.attributes != "off":
            names.append("attributes")
        if self.dynamic or self.deactivated:
            names += ["dynamic", "deactivated"]
        if self.updates is not None:
            names += ["updates", "updates_with_passive", "active_share"]
        if self.global_updates:
            names += ["global_updates", "global_update_spared"]
        if self.gps != "off":
            names += ["fixes_fused", "fixes_rejected"]
            if self.fixes_outside_stretches is not None:
                names.append("fixes_outside_stretches")
            if self.longest_streak:
                names += ["fixes_in_streaks", "longest_streak", "fixes_rejected_by_smoother"]
        return rows_of("EKF", self, names)


class AboutFilter(About):
    """What did the filter use, and what did it reject?"""

    name = "ekf"
    needs = "a filter that the job has run"
    figures = (("ekf", EkfFigures),)

    def find(self, known: Known) -> JobPart[EkfFigures]:
        """Return its settings and counts."""
        CheckPositions().ask(known)
        figures = filter_figures(known.ekf, known.prepared, known.value(PositionsFinding))
        return JobPart("ekf", figures)


def filter_figures(
    run: EkfRun, prepared: Prepared[Any], fixes: RejectedFixes | None = None
) -> EkfFigures:
    """Return the settings and counts of a filter.

    fixes: what its gate rejected, where a smoother judged it.
    """
    config, streaks = prepared.ekf, {}
    if fixes is not None:
        streaks = {
            "fixes_in_streaks": fixes.in_streaks,
            "longest_streak": fixes.longest,
            "fixes_rejected_by_smoother": fixes.unfit_count,
        }
    compression: dict[str, Any] = {"global_updates": 0, "global_update_spared": 0.0}
    if run.compression is not None:
        compression = run.compression._asdict()
    return EkfFigures(
        filter=config.filter,
        association=str(config.association),
        attributes=config.attributes,
        landmarks=len(run.estimate.landmark),
        **run.unused,
        deactivated=len(run.deactivated),
        cut_off=run.cut_off,
        gps=config.gps,
        fixes_fused=len(run.fix_number),
        fixes_rejected=run.rejected_fixes,
        fixes_outside_stretches=prepared.outside_stretches,
        **streaks,
        **compression,
    )
