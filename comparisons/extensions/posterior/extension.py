"""Draws of the smoother's exact posterior, which judge the Gaussians of both estimators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comparisons.adapters.ekf_run import EkfRun
from comparisons.checks.check import Finding
from comparisons.errors import InputError
from comparisons.extensions.interface import Extension
from comparisons.extensions.posterior.check import (
    Judged,
    PosteriorCheck,
    check_posterior,
    failures,
)
from comparisons.extensions.posterior.result import posterior_result, posterior_rows
from comparisons.pipeline.gaps import Known
from comparisons.pipeline.prepare import Prepared
from comparisons.words import Row
from graphslam.sampling import LARGEST_DIMENSION, SamplingOptions, sample_posterior


class Posterior(Extension):
    """Asks what neither Gaussian can say: how good they are."""

    name = "posterior"

    def __init__(self, draws: int, seed: int) -> None:
        """draws: of all chains together. seed: of the draws."""
        self._options = SamplingOptions(draws=draws // SamplingOptions.chains)
        self._seed = seed

    def start(self, prepared: Prepared[Any], run: EkfRun) -> None:
        """Refuse a log that is too long before the smoother runs. Raises InputError."""
        unknowns = 3 * len(run.timeline.epoch_time_s) + 2 * len(run.estimate.landmark)
        if unknowns > LARGEST_DIMENSION:
            raise InputError(
                f"{prepared.log.name}: --posterior samples draws at most {LARGEST_DIMENSION:,} "
                f"unknowns (3 a pose, 2 a landmark), not {unknowns:,}; --end S takes a shorter "
                "stretch"
            )

    def find(self, known: Known) -> PosteriorFinding:
        """Draw around the smoother's optimum and judge. Raises InputError."""
        prepared, gaps = known.prepared, known.gaps
        rng = np.random.default_rng(self._seed)
        with prepared.clock.stage("posterior"):
            try:
                draws = sample_posterior(
                    gaps.result.problem,
                    gaps.result.poses,
                    gaps.result.landmarks,
                    rng,
                    self._options,
                    lambda done, total: prepared.progress("posterior", done, total),
                )
            except ValueError as error:
                raise InputError(f"{prepared.log.name}: --posterior samples: {error}") from None
            found = check_posterior(draws, known.ekf.estimate, gaps.smoothed)
        return PosteriorFinding(found, gaps.smoothed.landmark_id)


class PosteriorFinding(Finding):
    """What the draws say of both Gaussians."""

    def __init__(self, check: PosteriorCheck, landmark_id: NDArray[np.int64]) -> None:
        """Only remarks: what the draws say changes no verdict. landmark_id: (L,)."""
        self.check = check
        self.result = posterior_result(check)
        self.entries = {"posterior": self.result}
        if check.smoother is None:
            self.remarks = [f"the draws of the posterior did not converge: {check.draws.lacks}"]
            return
        if check.ekf is not None:
            self.line = ("posterior", _line(check.ekf, check.smoother))
        failed = failures(check.smoother, landmark_id)
        if failed:
            self.remarks = [
                "the smoother's own covariance is too small for its exact posterior: "
                f"{', '.join(failed)}; the filter is compared with a Gaussian that fails there"
            ]

    def rows(self) -> Sequence[Row]:
        """Return the evidence of convergence, and both Gaussians."""
        return posterior_rows(self.check, self.result)


def _line(ekf: Judged, smoother: Judged) -> str:
    held = (100.0 * judged.whole.coverage.value for judged in (ekf, smoother))
    of_ekf, of_smoother = (f"{share:.0f} %" for share in held)
    return f"95 % ellipsoids hold {of_ekf} (EKF) and {of_smoother} (smoother) of the draws"
