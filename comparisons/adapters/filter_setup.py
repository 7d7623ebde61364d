"""What stands beside a filter while it runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from comparisons.adapters.filter_loop import FilterObserver, FilterObservers
from comparisons.adapters.pose_landmark_measurements import (
    GuardedSource,
    NoPoseLandmarkSource,
    PoseLandmarkSource,
)
from ekf_reference.core.ekf import Ekf
from ekf_reference.core.landmark_types import POINT, LandmarkKind

if TYPE_CHECKING:
    from ekf_reference.core.measurements import DynamicGuard

T = TypeVar("T")


@dataclass(kw_only=True)
class FilterSetup:
    """Filled before a run of the filter, anew for each.

    modify: may replace parts of the filter before it starts. observers: read the filter, in their
    order. source: of measurements of pose landmarks; one that is a FilterObserver observes,
    too, after the others. guard: knows where things move, so that the filter ignores these. kinds:
    of landmarks that maps are anchored to. offers: what extensions offer to those after them, and
    to their own checks.
    """

    modify: list[Callable[[Ekf], None]] = field(default_factory=list)
    observers: list[FilterObserver] = field(default_factory=list)
    source: PoseLandmarkSource = field(default_factory=NoPoseLandmarkSource)
    guard: DynamicGuard | None = None
    kinds: tuple[LandmarkKind, ...] = (POINT,)
    offers: list[object] = field(default_factory=list)

    def find(self, kind: type[T]) -> T | None:
        """Return the first offer of a class; None where there is none."""
        return next((offer for offer in self.offers if isinstance(offer, kind)), None)

    def apply(self, ekf: Ekf) -> set[int]:
        """Change the filter as asked. Return the set that will hold deactivated landmarks."""
        for modify in self.modify:
            modify(ekf)
        deactivated: set[int] = set()
        if self.guard is not None:
            from ekf_reference.association.dynamic_rejection import DynamicRejection

            ekf.association = DynamicRejection(ekf.association, self.guard, deactivated)
            if isinstance(self.source, GuardedSource):
                self.source.keep_from(self.guard)
        return deactivated

    def watcher(self) -> FilterObservers:
        """All that observe, as one."""
        both: Sequence[object] = (*self.observers, self.source)
        return FilterObservers(
            [observer for observer in both if isinstance(observer, FilterObserver)]
        )
