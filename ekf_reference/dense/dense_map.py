"""DenseSLAM: everything a scanner sees, kept between the landmarks (Nieto 2005, chapter 3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ekf_reference.core.geometry import Array, Index
from ekf_reference.dense.delayed_initialisation import DelayedInitialisation, Released
from ekf_reference.dense.dynamic import DynamicLayer
from ekf_reference.dense.layers.layer import Hits, LateScan, Layer
from ekf_reference.dense.neglected_correlation import NeglectedCorrelation
from ekf_reference.dense.regions import LocalRegions, Potential
from ekf_reference.dense.regions_at_map import RegionsAtMap
from ekf_reference.dense.scan import Scan, ScanSensor
from ekf_reference.dense.view import FilterView


@dataclass
class ReturnTally:
    """What became of all returns; those not counted here wait, or are counted there.

    Attributes:
        scans: number of scans.
        returns: number of returns.
        fused: returns that entered the map at once.
        late: returns that entered it after a wait.
        outside: returns where no region can be.
    """

    scans: int = 0
    returns: int = 0
    fused: int = 0
    late: int = 0
    outside: int = 0


@dataclass(kw_only=True)
class DenseMap:
    """Regions between a filter's landmarks, and layers in them, fed scan by scan (eq. 3.24).

    At each instant call `predicted`, the filter's update, `updated`, `insert`.

    layers: by name; all are given the same scans. waiting: for returns outside all regions; None to
    leave these out, as the thesis' simulations do. delayed: fuse what has waited into its region
    (section 3.7.3); else it only shows where virtual corners are wanted. virtual: make these
    (section 3.5.1). reach_m: of the landmarks that may form regions.
    least_points: returns that are overdue before a region with a virtual corner is made for them.
    seek_every: scans after which regions are sought again, as with every new landmark. neglected:
    how far what the map leaves out may still move a region's data (section 3.6). dynamic: where
    things move, if that is wanted (section 6.3). landmark: (L, 2) [m] of the filter when it was
    last read. known_m: greatest standard deviation of a region, seen from the vehicle, at which
    its returns are fused; the others count as outside.
    """

    layers: Mapping[str, Layer]
    regions: LocalRegions = field(default_factory=LocalRegions)
    waiting: DelayedInitialisation | None = field(default_factory=DelayedInitialisation)
    reach_m: float = 35.0
    least_points: int = 10
    seek_every: int = 4
    dynamic: DynamicLayer | None = None
    known_m: float = math.inf
    delayed: bool = True
    virtual: bool = True
    tally: ReturnTally = field(default_factory=ReturnTally)
    neglected: NeglectedCorrelation = field(init=False)
    landmark: Array = field(default_factory=lambda: np.empty((0, 2)))
    _sought_among: int = 0
    _sought_until: int = 0
    _potential: Potential | None = None
    _sensor: ScanSensor | None = None
    _regions_at: list[int] = field(default_factory=list)
    _spoken: set[tuple[int, int]] = field(default_factory=set)

    def __post_init__(self) -> None:
        """The error layer follows the regions."""
        self.neglected = NeglectedCorrelation(self.regions)

    def predicted(self, view: FilterView) -> None:
        """The filter has predicted, and not yet fused anything there."""
        if self.waiting is not None:
            self.waiting.predicted(view)

    def updated(self, view: FilterView) -> None:
        """The filter has fused what it saw: new regions may be possible, and returns fit in."""
        self.place(view)
        if self.waiting is not None:
            self.waiting.updated(view)
        there = int(np.isfinite(self.landmark[:, 0]).sum())  # or were, before they left the map
        if there == self._sought_among and self.tally.scans < self._sought_until:
            return
        self._sought_among = there
        self._sought_until = self.tally.scans + self.seek_every
        landmark_index = view.near(self.reach_m)
        made = self.regions.extend(
            self.landmark, landmark_index, view.joint(landmark_index)[3:, 3:]
        )
        if self.waiting is not None:
            behind = self._make_virtual(view, landmark_index, self.waiting)
            if len(made) or behind:
                self._fuse_late(view, self.waiting)
            self._potential = self.regions.potential(
                self.landmark, landmark_index, view.pose, view.joint(landmark_index)
            )

    def insert(self, view: FilterView, scan: Scan, time_s: float = 0.0) -> None:
        """Take in a scan seen from the view's pose, at once and in every layer."""
        placed = self.place(view)
        found = placed.locate(scan.point)
        near = np.sort(placed.tree.meeting(scan.box()[None]).item)
        doubtful = np.zeros(len(found.region), dtype=bool)
        if math.isfinite(self.known_m):
            near = self._known(view, placed, near, self.known_m)
            doubtful = (found.region >= 0) & ~np.isin(found.region, near)
        inside = np.flatnonzero((found.region >= 0) & ~doubtful)
        self.tally.scans += 1
        self._sensor = scan.sensor
        self._regions_at.append(len(self.regions.base))
        self.tally.returns += len(scan.range_m)
        self.tally.fused += len(inside)
        self.tally.outside += int(np.count_nonzero(doubtful))
        hits = Hits(
            region=found.region[inside],
            local=found.local[inside],
            point=scan.point[inside],
            covariance=scan.covariance[inside],
        )
        for layer in self.layers.values():
            layer.fuse(hits, placed, scan, near)
        if self.dynamic is not None:
            known = self._known(view, placed, near, self.dynamic.rule.known_m)
            self.dynamic.fuse(hits, placed, scan, known, time_s)
        self._note_error(view, hits)
        self._let_wait(view, scan, np.flatnonzero(found.region < 0))

    def place(self, view: FilterView) -> RegionsAtMap:
        """Move the regions to a view's landmarks; one that has left the filter's map stays."""
        known = np.full_like(view.landmark, np.nan)
        known[: len(self.landmark)] = self.landmark
        self.landmark = np.where(np.isnan(view.landmark), known, view.landmark)
        return self.regions.placed(self.landmark)

    def _known(self, view: FilterView, placed: RegionsAtMap, near: Index, sigma_m: float) -> Index:
        """Those of the regions whose middle is known so well from here, all within reach."""
        middle, known = placed.triangle[near].mean(axis=1), replace(view, landmark=self.landmark)
        landmark_index = self.neglected.carriers(known, near, middle).landmark_index
        close = np.isin(landmark_index, view.near(self.reach_m)).all(axis=1)
        sigma = self.neglected.sigma_now(known, near, middle)
        return near[close & (sigma <= sigma_m)]

    def _note_error(self, view: FilterView, hits: Hits) -> None:
        """How well the regions were known from here, where they were hit."""
        region, row, count = np.unique(hits.region, return_inverse=True, return_counts=True)
        if len(region):
            sums = [np.bincount(row, hits.point[:, axis]) for axis in range(2)]
            mean = np.column_stack(sums) / count[:, None]
            known = replace(view, landmark=self.landmark)
            self.neglected.note(known, region, mean, count.astype(float))

    def _let_wait(self, view: FilterView, scan: Scan, outside: Index) -> None:
        if self.waiting is None or not len(outside):
            self.tally.outside += len(outside)
            return
        number = np.full(len(outside), -1)
        if self._potential is not None:
            self.waiting.predicted(view)  # a scan may come a little after the last epoch
            point, spread = scan.point[outside], scan.covariance[outside]
            number = self.waiting.add(
                view, point, spread, self.tally.scans, self._potential, scan.origin
            )
        self.tally.outside += int(np.count_nonzero(number < 0))

    def _make_virtual(
        self, view: FilterView, landmark_index: Index, waiting: DelayedInitialisation
    ) -> int:
        """Make regions with virtual corners for what has waited too long; how many."""
        overdue = waiting.overdue(view, self.tally.scans)
        if not self.virtual or len(overdue) < self.least_points:
            return 0
        joint, least = view.joint(landmark_index), self.least_points
        made = self.regions.extend_virtual(
            self.landmark, landmark_index, view.pose, joint, overdue, least
        )
        return len(made)

    def _fuse_late(self, view: FilterView, waiting: DelayedInitialisation) -> None:
        placed = self.place(view)
        out = waiting.release(view, placed)
        if not self.delayed:
            self.tally.outside += len(out.region)
            return
        if not len(out.region):
            return
        self.tally.late += len(out.region)
        late = tuple(self._late_scans(out, placed))
        hits = Hits(
            region=out.region,
            local=out.local,
            point=out.point,
            covariance=out.covariance,
            late=late,
        )
        for layer in self.layers.values():
            layer.fuse(hits, placed, None, np.unique(out.region))

    def _late_scans(self, out: Released, placed: RegionsAtMap) -> Iterator[LateScan]:
        """What each scan says by its late returns, in regions in which it has not spoken yet."""
        if self._sensor is None:
            return
        for number in np.unique(out.scan).tolist():
            rows = np.flatnonzero(out.scan == number)
            origin = out.origin[rows].mean(axis=0)
            ray = out.point[rows] - origin
            scan = Scan.of_ranges(
                np.append(origin, 0.0),
                np.arctan2(ray[:, 1], ray[:, 0]),
                np.hypot(ray[:, 0], ray[:, 1]),
                self._sensor,
            )
            met = np.sort(placed.tree.meeting(scan.box()[None]).item).tolist()
            since = self._regions_at[number - 1]
            near = [r for r in met if r >= since and (number, r) not in self._spoken]
            self._spoken.update((number, r) for r in near)
            yield LateScan(scan, np.array(near, dtype=np.intp))
