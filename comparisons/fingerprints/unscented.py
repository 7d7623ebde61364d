"""Which unscented Kalman filter an estimate is of: sigma points are fitted to its first poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from comparisons.adapters.filter_loop import FilterObserver
from comparisons.adapters.filter_variants import SigmaPoints, UnscentedEkf
from comparisons.arrays import Array
from comparisons.checks.grade import Likeness
from comparisons.config import SolveConfig
from comparisons.estimates.external import ExternalEstimate
from comparisons.estimates.reference import Reference
from comparisons.fingerprints.companion import EXPLAINED, NEAR, Companion, remainder
from comparisons.pipeline.prepared import Prepared
from comparisons.pipeline.references import filter_of

NAME = "an unscented Kalman filter with the estimate's sigma points"
_START = np.array((0.25, 1.0))
"""spread and central of SigmaPoints."""
_LOW, _HIGH = np.array((1e-6, -1.1)), np.array((1.1, 3.1))
_STEP = 1e-4
_POSES, _MOST = 20, 60
"""Fitted are the poses until the EKF has left the estimate, so many more, and at most so many."""
_ROUNDS = 6
_SLOW = 0.5
"""What a round of Gauss and Newton leaves of a wrong form; of the right one it leaves far less."""
_ROUNDING = 1e-8
_SCREENED = 4
"""Poses, from the first that differs from the EKF's, to which a form is fitted at first."""


def unscented_filters(
    given: ExternalEstimate, prepared: Prepared[SolveConfig], ekf: Likeness
) -> Iterator[Reference]:
    """Yield unscented filters whose sigma points explain the first poses of an estimate.

    Of each form: whether sigma points lie by kappa 0 or 3 - n, along Cholesky's root or the
    symmetric one, whether the control has some, and whether new landmarks are placed by them.
    given: its poses at the reference's times, and no others. ekf: it against the reference EKF.
    """
    fit = _Fit(given, prepared, ekf)
    both = (True, False)
    for symmetric, kappa, controls, starts in product((False, True), (0.0, None), both, both):
        form = SigmaPoints(kappa=kappa, symmetric=symmetric)
        kind = fit.fitted(form, {"controls": controls, "starts": starts})
        reference = None if kind is None else filter_of(NAME, kind, prepared, given.time_s)
        if reference is not None:
            yield reference


class _Fit:
    """The first poses of an estimate. ekf: as of `unscented_filters`."""

    def __init__(
        self, given: ExternalEstimate, prepared: Prepared[SolveConfig], ekf: Likeness
    ) -> None:
        self.given, self.prepared = given, prepared
        self.beside = Companion(given, ekf)
        self.count = min(self.beside.first(_POSES), _MOST, len(given.time_s))
        same = int(np.argmax(np.abs(self.beside.sound_rows).max(axis=1) > NEAR))
        self.few = min(same + _SCREENED, self.count)

    def fitted(self, form: SigmaPoints, options: dict[str, bool]) -> type[UnscentedEkf] | None:
        """Return the filter of a form that leaves the least; None where that is too much.

        It is fitted to the first poses that differ, then to all.
        """

        def kind(at: Array) -> type[UnscentedEkf]:
            points = form._replace(spread=float(at[0]), central=float(at[1]))
            return type("FittedUnscentedEkf", (UnscentedEkf,), {**options, "points": points})

        at: Array | None = _START
        for count in (self.few, self.count):
            at = None if at is None else self._nearest(kind, at, count)
        return None if at is None else kind(at)

    def _nearest(
        self, kind: Callable[[Array], type[UnscentedEkf]], at: Array, count: int
    ) -> Array | None:
        """Sigma points' numbers (2,) that leave the least of so many poses; None for too much."""
        best, last = at, np.inf
        for _ in range(_ROUNDS):
            tried = (at, *(at + _STEP * np.eye(2)))
            now, *beside = (self._left(kind(number), count) for number in tried)
            if now is None or beside[0] is None or beside[1] is None:
                return None
            left = float(np.abs(now).max())
            if left > _SLOW * last:
                break
            last, best = left, at
            if left <= _ROUNDING:
                break
            slope = np.column_stack([moved - now for moved in beside if moved is not None])
            at = np.clip(at - np.linalg.lstsq(slope / _STEP, now)[0], _LOW, _HIGH)
        enough = max((1.0 - EXPLAINED) * self.beside.sound_until(count), _ROUNDING)
        return best if last <= enough else None

    def _left(self, kind: type[UnscentedEkf], count: int) -> Array | None:
        """What is left of the first poses; None where the filter does not reach them all."""

        def run(observer: FilterObserver) -> None:
            filter_of(NAME, kind, self.prepared, self.given.time_s, lambda ekf: observer)

        return remainder(self.beside, count, run)
