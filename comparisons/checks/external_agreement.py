"""Whether an external estimate is plausible: as near to the optimum as that itself is certain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.motion import CLOCK_S
from comparisons.arrays import Array, Index
from comparisons.checks.accuracy import match_landmarks
from comparisons.checks.agreement import (
    LARGEST_DISTANCE,
    BlockAgreement,
    LandmarkAgreement,
    VarianceBand,
)
from comparisons.checks.grade import MOST_LATE_S, joint_rows, match_map
from comparisons.covariances import definite, eigenvalue_range, eigenvalue_ranges
from comparisons.errors import InputError
from comparisons.estimates.estimate import Estimate
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.estimates.trajectory_files import UNITS, in_seconds, retimed
from comparisons.plane import pose_difference, rms
from comparisons.shown import Brief
from comparisons.statistics import chi2_quantile, squared_distance

_SURE = 0.999
_MOST_OUTSIDE = 0.01
"""Share of poses that may lie beyond their 99.9 % region, or beyond any other bound."""
_GENEROUS = 2.0
_FLOOR_M = 0.05
"""Differences that one estimate may have from another of its kind, in RMS over all poses, where
the reference filter is no measure."""
_HOLE_S = (1.0, 10.0)
"""Least and greatest length of a hole in a path, and most of the interval of its poses' ends."""
_INTERVALS = 10.0
"""A hole is longer than so many of the estimate's own intervals, within these."""
_STEPS = 1.5
"""Within so many of the estimate's own steps a vehicle stands, or is between two keyframes."""
_STANDS = (0.1, 0.2)
"""So far [m], or turned by so much [rad], it does anyhow."""
_ENOUGH = 10
"""With fewer poses, or instants of the smoother's, steps say nothing."""
_SAME_LENGTH = 0.02
"""Share of the log's time by which an estimate's may differ, where a constant offset is named."""
_NARROW = 0.5
"""Least share of a justified variance that is plausible beyond what linearisation changes."""


@dataclass(frozen=True, kw_only=True)
class TimeCoverage:
    """How much of the log's time an estimate speaks of.

    span_s: begin and end of the smoother's path. first_s, last_s: of the poses given within it.
    holes_s: (H, 2) begin and end of what is not covered, in order. least: share of the log's time
    that is required. repeated: poses after last_s are that one again.
    """

    span_s: tuple[float, float]
    first_s: float
    last_s: float
    holes_s: Array
    least: float = 0.0
    repeated: bool = False

    @property
    def share(self) -> float:
        """Of the log's time; 1 of a log of one instant."""
        whole = self.span_s[1] - self.span_s[0]
        return 1.0 - self._missing_s / whole if whole > 0.0 else 1.0

    @property
    def short(self) -> bool:
        """Whether it is too little."""
        return self.share < self.least

    @property
    def _missing_s(self) -> float:
        return float(np.sum(self.holes_s[:, 1] - self.holes_s[:, 0]))

    @property
    def evidence(self) -> str:
        """How many seconds are covered, and where those that are not lie."""
        where, inner = [], []
        for start, stop in self.holes_s.tolist():
            if self.first_s == self.last_s:
                where = [f"it has a single pose, at {self.first_s:.1f} s"]
            elif stop <= self.first_s:
                where.append(f"it begins at {self.first_s:.1f} s")
            elif start >= self.last_s:
                ends = "its pose does not change after" if self.repeated else "it ends at"
                where.append(f"{ends} {self.last_s:.1f} s")
            else:
                inner.append((start, stop))
        if inner:
            start, stop = max(inner, key=lambda hole: hole[1] - hole[0])
            what = "no poses" if len(inner) == 1 else f"{len(inner)} gaps, the longest"
            where.append(f"it has {what} from {start:.1f} to {stop:.1f} s")
        whole = self.span_s[1] - self.span_s[0]
        seconds = f"the estimate covers {whole - self._missing_s:.1f} of {whole:.1f} s"
        return f"{seconds}: {', '.join(where)}" if where else seconds


def coverage(
    given: tuple[Array, Array], smoothed: tuple[Array, Array], observed_s: Array, least: float = 0.0
) -> TimeCoverage:
    """Return what an estimate's poses cover of the smoother's.

    Covered is what lies between two successive poses that are no farther apart than ten of the
    estimate's own intervals (median; at least 1 s, at most 10 s), or between which nothing is
    observed, or the smoother stands; and one interval (at most 10 s) before the first and after the
    last. given: times (K,) and poses (K, 3); poses that repeat the one before to the bit are none.
    smoothed: times (E,) and poses (E, 3). observed_s: (O,) instants that ask for a pose.
    """
    (time_s, pose), (epoch_s, path) = given, smoothed
    begin, end = float(epoch_s[0]), float(epoch_s[-1])
    new = np.ones(len(time_s), dtype=bool)
    new[1:] = (pose[1:] != pose[:-1]).any(axis=1)
    t = np.unique(np.clip(time_s[new], begin, end))
    own = min(float(np.median(np.diff(t))), _HOLE_S[1]) if len(t) > 1 else 0.0
    longest = float(np.clip(_INTERVALS * own, *_HOLE_S))
    far = np.diff(t) > longest + CLOCK_S
    between = np.column_stack((t[:-1][far], t[1:][far]))
    holes = np.vstack(((begin, t[0] - own), between, (t[-1] + own, end)))
    inner = np.searchsorted(observed_s, holes - (-CLOCK_S, CLOCK_S))
    holes = holes[inner[:, 1] > inner[:, 0]]  # no hole ends before it begins
    if len(t) >= _ENOUGH:
        moves = [not _stands(start, stop, t, epoch_s, path) for start, stop in holes.tolist()]
        holes = holes[np.array(moves, dtype=bool)]
    return TimeCoverage(
        span_s=(begin, end),
        first_s=float(t[0]),
        last_s=float(t[-1]),
        holes_s=holes,
        least=least,
        repeated=not new[-1],
    )


def _stands(start: float, stop: float, time_s: Array, epoch_s: Array, smoothed: Array) -> bool:
    """Whether the smoother (E, 3) stays within the steps that poses at times (K,) are apart."""
    at = np.searchsorted(epoch_s, time_s + CLOCK_S, side="right") - 1
    within = smoothed[(epoch_s >= start - CLOCK_S) & (epoch_s <= stop + CLOCK_S)]
    if not len(within):
        return False

    def lengths(from_to: Array) -> Array:
        return np.column_stack((np.linalg.norm(from_to[:, :2], axis=1), np.abs(from_to[:, 2])))

    step = np.median(lengths(pose_difference(smoothed[at[1:]], smoothed[at[:-1]])), axis=0)
    away = lengths(pose_difference(within, within[:1])).max(axis=0)
    return bool((away <= np.maximum(_STANDS, _STEPS * step)).all())


@dataclass(frozen=True, kw_only=True, repr=False)
class ExternalAgreement(Brief):
    """All that could be compared with the smoother.

    time_s: (K,) the given poses inside the log's time. rms_m, rms_heading_rad: of their differences
    from the smoother's. outside: share of them beyond the 99.9 % region of the given covariances;
    None without. last: the last pose; None where it lies before the log's last epoch. landmark_id:
    (M,) of those compared, landmarks: as many. unmatched: landmarks given that the smoother does
    not have. band: of variances. against: what is not plausible, in words.
    """

    time_s: Array
    rms_m: float
    rms_heading_rad: float
    outside: float | None
    last: BlockAgreement | None
    landmark_id: NDArray[np.int64]
    landmarks: tuple[LandmarkAgreement, ...]
    unmatched: int
    band: VarianceBand
    against: tuple[str, ...]


def within_log(given: ExternalEstimate, smoothed: Estimate) -> NDArray[np.bool_]:
    """Return which poses (K,) lie in the log's time. Raises InputError where none does."""
    first, last = smoothed.time_s[0], smoothed.time_s[-1]
    inside: NDArray[np.bool_] = (given.time_s >= first - 1e-4) & (given.time_s <= last + 1e-4)
    if not inside.any() or _unit(given.time_s, (first, last)):
        raise InputError(
            f"the estimate's times ({given.time_s[0]:.3f} to {given.time_s[-1]:.3f} s) lie outside "
            f"the log's ({first:.3f} to {last:.3f} s){clock_words(given.time_s, (first, last))}; "
            "expected times of the log's clock"
        )
    return inside


def clock_words(time_s: Array, span_s: tuple[float, float]) -> str:
    """What an estimate's times (K,) look like beside the log's, in words that follow them."""
    first, last = span_s
    whole, own = last - first, float(time_s[-1] - time_s[0])
    if unit := _unit(time_s, span_s):
        return f"; they look like {unit}; {in_seconds(unit)}"
    if abs(own - whole) <= _SAME_LENGTH * whole:
        offset = float(time_s[0]) - first
        side, back = ("late", "-") if offset > 0.0 else ("early", "+")
        command = retimed(f"{back} {abs(offset):.1f}")
        return f"; they look {abs(offset):.1f} s too {side}; on the log's clock: {command}"
    return ""


def _unit(time_s: Array, span_s: tuple[float, float]) -> str:
    """The unit other than seconds in which times (K,) are as long as the log, if any."""
    whole, own = span_s[1] - span_s[0], float(time_s[-1] - time_s[0])
    for unit, factor in UNITS.items():
        if abs(own - factor * whole) <= _SAME_LENGTH * factor * whole:
            return unit
    return ""


def compare_external(
    given: ExternalEstimate, smoothed: Reference, peers: Sequence[Reference], *, labelled: bool
) -> ExternalAgreement:
    """Compare all that is there.

    given: its poses at the references' times, and no others. smoothed: the smoother's optimum.
    peers: right estimates of the kinds that it may be; a path need be near one. labelled: ids are
    the log's.
    """
    difference = pose_difference(given.pose, smoothed.pose)
    rows, outside, end = match_map(given, smoothed, labelled=labelled), None, None
    if given.pose_covariance is not None:
        outside = _outside(difference, given.pose_covariance)
    band, trusted = VarianceBand(_NARROW, 1.0 / _NARROW), {}
    for peer in peers:
        whole = _whole(peer, smoothed, labelled=labelled)
        trusted[peer.name] = whole is None or whole.agrees
        band = _widened(band, whole)
    if smoothed.joint_s - given.time_s[-1] <= MOST_LATE_S:
        cover = None if given.pose_covariance is None else given.pose_covariance[-1]
        end = BlockAgreement.of(difference[-1], smoothed.joint_covariance[:3, :3], cover, band)
    agreement = ExternalAgreement(
        time_s=given.time_s,
        rms_m=rms(difference[:, :2]),
        rms_heading_rad=rms(difference[:, 2:]),
        outside=outside,
        last=end,
        landmark_id=smoothed.landmark_id[rows[1]],
        landmarks=tuple(_landmark_blocks(given, smoothed, rows, band)),
        unmatched=(0 if given.landmark is None else len(given.landmark)) - len(rows[0]),
        band=band,
        against=(),
    )
    paths = [
        _path_by_peer(given, peer, band)
        if trusted[peer.name] and peer.known.any()
        else _path_alone(agreement, rms((peer.pose - smoothed.pose)[:, :2]))
        for peer in peers
    ] or [_path_alone(agreement, 0.0)]
    against = [*_map_faults(given, smoothed, rows, agreement), *min(paths, key=len)]
    return replace(agreement, against=tuple(against))


def _whole(peer: Reference, smoothed: Reference, *, labelled: bool) -> BlockAgreement | None:
    """A reference's map against the optimum's; None where they share no landmark."""
    maps = (peer.landmark_id, peer.landmark), (smoothed.landmark_id, smoothed.landmark)
    ours, theirs = match_landmarks(*maps, labelled=labelled)
    rows, own = (joint_rows(which)[3:] for which in (ours, theirs))
    difference = (peer.landmark[ours] - smoothed.landmark[theirs]).ravel()
    if not len(difference):
        return None
    cover = peer.joint_covariance[np.ix_(rows, rows)]
    return BlockAgreement.of(difference, smoothed.joint_covariance[np.ix_(own, own)], cover)


def _widened(band: VarianceBand, peer: BlockAgreement | None) -> VarianceBand:
    """Linearisation may change variances by as much as it does in the reference filter."""
    widest = VarianceBand()
    if peer is None or not peer.ratios or not np.isfinite(peer.ratios[0]):
        return widest
    least, largest = peer.ratios
    return VarianceBand(
        max(widest.least, min(band.least, _NARROW * least)),
        min(widest.largest, max(band.largest, largest / _NARROW)),
    )


def _map_faults(
    given: ExternalEstimate,
    smoothed: Reference,
    rows: tuple[Index, Index],
    agreement: ExternalAgreement,
) -> list[str]:
    """What is not plausible of the last pose and the map."""
    parts, blocks = [], agreement.landmarks
    if agreement.unmatched and not blocks and len(smoothed.landmark):
        parts.append(
            f"none of the estimate's {agreement.unmatched} landmarks is a landmark of the log"
        )
    far = [k for k, block in enumerate(blocks) if not block.near]
    if far:
        worst = max(far, key=lambda k: blocks[k].distance_sigma)
        block, name = blocks[worst], smoothed.landmark_name(int(rows[1][worst]))
        parts.append(
            f"{len(far)} of {len(blocks)} landmarks are more than {block.limit_sigma:.2g} sigma "
            f"from the optimum, landmark {name} most, by {block.difference_m:.2f} m "
            f"({block.distance_sigma:.1f} sigma)"
        )
    last = agreement.last
    if last is not None and not last.near:
        parts.append(
            f"the last pose is {last.difference_m:.2f} m from the optimum "
            f"({last.distance_sigma:.1f} sigma)"
        )
    each = [(b.variance_ratio_least, b.variance_ratio_largest) for b in (*blocks, last) if b]
    unsure = [ratios for ratios in each if not agreement.band.holds(*ratios)]
    if not unsure and given.joint_covariance is not None and last is not None:
        ours, theirs = map(joint_rows, rows)
        pair = given.joint_covariance[np.ix_(ours, ours)], smoothed.joint_covariance
        whole = eigenvalue_range(pair[0], pair[1][np.ix_(theirs, theirs)])
        unsure = [] if agreement.band.holds(*whole) else [whole]
    if unsure:
        worst_ratio = max(
            (ratio for ratios in unsure for ratio in ratios if ratio is not None),
            key=lambda r: abs(float(np.log(max(r, 1e-300)))),
        )
        parts.append(
            f"the variances of last pose and map are up to {worst_ratio:.3g} times the optimum's, "
            f"expected {agreement.band.least:.2g} to {agreement.band.largest:.2g}"
        )
    return parts


def _path_by_peer(given: ExternalEstimate, peer: Reference, band: VarianceBand) -> list[str]:
    """What is not plausible of a path beside that of a right estimate of its kind."""
    at, parts = peer.known, []
    own = peer.pose_covariance[at]
    difference = pose_difference(given.pose[at], peer.pose[at])
    square = squared_distance(difference, own) / 3.0
    far = float(np.mean(square > LARGEST_DISTANCE**2))
    if far > _MOST_OUTSIDE:
        parts.append(
            f"{100.0 * far:.0f} % of the poses differ by more than 1 sigma from those of "
            f"{peer.name}, by {rms(difference[:, :2]):.2f} m and "
            f"{np.degrees(rms(difference[:, 2:])):.2f} degrees (RMS)"
        )
    if given.pose_covariance is not None:
        least, largest = eigenvalue_ranges(given.pose_covariance[at], own)
        bad = float(np.mean((least < band.least) | (largest > band.largest)))
        if bad > _MOST_OUTSIDE:
            parts.append(
                f"{100.0 * bad:.0f} % of the pose covariances are outside {band.least:.2g} to "
                f"{band.largest:.2g} times those of {peer.name}"
            )
    return parts


def _path_alone(agreement: ExternalAgreement, peer_rms_m: float) -> list[str]:
    """What is not plausible of a path where no right estimate of its kind is a measure."""
    expected_m = _GENEROUS * peer_rms_m + _FLOOR_M
    if agreement.outside is not None and agreement.outside > _MOST_OUTSIDE:
        return [
            f"{100.0 * agreement.outside:.0f} % of the poses lie outside their own 99.9 % region; "
            f"their RMS difference from the optimum is {agreement.rms_m:.2f} m"
        ]
    if agreement.outside is None and agreement.rms_m > expected_m:
        return [
            f"the RMS difference of the poses from the optimum is {agreement.rms_m:.2f} m, "
            f"expected at most {expected_m:.2f} m"
        ]
    return []


def _landmark_blocks(
    given: ExternalEstimate, smoothed: Reference, rows: tuple[Index, Index], band: VarianceBand
) -> Iterator[LandmarkAgreement]:
    if given.landmark is None:
        return
    every = smoothed.landmark_covariances(rows[1])
    for i, j, own in zip(*(row.tolist() for row in rows), every, strict=True):
        cover = None if given.landmark_covariance is None else given.landmark_covariance[i]
        apart, name = given.landmark[i] - smoothed.landmark[j], int(smoothed.landmark_id[j])
        yield LandmarkAgreement.of(apart, own, cover, band, len(rows[0]), id=name)


def _outside(difference: Array, covariance: Array) -> float:
    """Share of the poses beyond their own region; one without a usable covariance is."""
    limit = float(chi2_quantile(_SURE, 3))
    positive = definite(covariance)
    safe = np.where(positive[:, None, None], covariance, np.eye(3))
    return float(np.mean(~positive | (squared_distance(difference, safe) > limit)))
