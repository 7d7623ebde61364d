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
from comparisons.extensions.posterior.config import PosteriorConfig
from comparisons.pipeline.gaps import Known
from comparisons.pipeline.prepare import Prepared
from comparisons.words import Row
from graphslam.chain_diagnostics import Estimated
from graphslam.sampling import (
    LARGEST_DIMENSION,
    LARGEST_R_HAT,
    LEAST_ACCEPTANCE,
    LEAST_SAMPLE_SIZE,
    SamplingOptions,
    sample_posterior,
)

_GROUP = "Posterior (draws)"


class Posterior(Extension):
    """Asks what neither Gaussian can say: how good they are."""

    name = "posterior"
    settings: PosteriorConfig

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
        rng = np.random.default_rng(self.settings.seed)
        options = SamplingOptions(draws=self.settings.draws // SamplingOptions.chains)
        with prepared.clock.stage("posterior"):
            try:
                draws = sample_posterior(
                    gaps.result.problem,
                    gaps.result.poses,
                    gaps.result.landmarks,
                    rng,
                    options,
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
        self.entries = {"posterior": check}
        if check.smoother is None:
            self.remarks = [f"the draws of the posterior did not converge: {check.lacks}"]
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
        """Return the evidence of convergence, then both Gaussians."""
        one = self.check
        samples = {"bulk": one.bulk, "tails": one.tail}
        rows = [
            Row(_GROUP, "draws, unknowns", f"{one.draws:,}, {one.unknowns:,}"),
            _limited("acceptance", one.acceptance, LEAST_ACCEPTANCE, "at least", ".2f"),
            _limited("largest R-hat", one.r_hat, LARGEST_R_HAT, "at most", ".3f"),
            *(
                _limited(
                    f"least effective sample size, {part}", size, LEAST_SAMPLE_SIZE, "at least",
                    ".0f",
                )
                for part, size in samples.items()
            ),
        ]  # fmt: skip
        if one.moments is None:
            return [*rows, Row(_GROUP, "judgement of the Gaussians", "not converged")]
        skewness = np.abs(one.moments.skewness)
        rows.append(Row(_GROUP, "largest skewness", f"{skewness.max():.2f}"))
        for name, judged in (("EKF", one.ekf), ("smoother", one.smoother)):
            rows += _judged_rows(name, judged) if judged is not None else []
        return rows


def _limited(quantity: str, value: float | None, limit: float, side: str, form: str) -> Row:
    inside = value is not None and (value <= limit if side == "at most" else value >= limit)
    shown = "undefined" if value is None else format(value, form)
    return Row(_GROUP, quantity, shown, f"{side} {limit:g}", inside)


def _judged_rows(name: str, judged: Judged) -> list[Row]:
    blocks = [("last pose", judged.pose), ("whole", judged.whole)]
    if judged.landmarks:
        blocks.insert(1, ("worst landmark", judged.landmarks[judged.worst_landmark()]))
    rows = []
    for block, one in blocks:
        held = f"{100.0 * one.coverage.value:.1f} +- {100.0 * one.coverage.error:.1f} %"
        ratios = f"{_shown(one.least)} to {_shown(one.largest)}"
        rows += [
            Row(_GROUP, f"{name}, {block}: posterior in the 95 % ellipsoid", held),
            Row(_GROUP, f"{name}, {block}: variance ratio (1 is exact)", ratios),
        ]
    return rows


def _shown(figure: Estimated) -> str:
    return f"{figure.value:.2f} +- {figure.error:.2f}"


def _line(ekf: Judged, smoother: Judged) -> str:
    held = (100.0 * judged.whole.coverage.value for judged in (ekf, smoother))
    of_ekf, of_smoother = (f"{share:.0f} %" for share in held)
    return f"95 % ellipsoids hold {of_ekf} (EKF) and {of_smoother} (smoother) of the draws"
