"""Settings of the draws of the posterior."""

from __future__ import annotations

from comparisons.config import Configured, ExtensionConfig, RunConfig, setting
from comparisons.options import ABSENT, Option


class PosteriorConfig(ExtensionConfig):
    """Draws of the smoother's exact posterior, for short logs of point landmarks."""

    extension = "comparisons.extensions.posterior.extension:Posterior"
    switch = Option("--posterior", jobs=("run",), settings={"none": ABSENT, "samples": {}})
    draws: int = setting(
        8000,
        "Draws of all 16 chains together; below 400 effective ones of any unknown the "
        "sampling is not converged, and judges nothing",
        ge=800,
        le=200_000,
    )
    seed: int = setting(0, "Random seed of the draws", ge=0)

    def check_with(self, config: Configured) -> None:
        """The posterior must be that of the batch smoother, of points, and of Gaussian noise."""
        if "scan_landmarks" in config.extensions:
            raise ValueError("--posterior samples goes with landmarks that are points")
        if not isinstance(config, RunConfig):
            return
        if config.smoother.method != "batch" or config.smoother.robust != "none":
            raise ValueError(
                "--posterior samples goes with the batch smoother without a robust kernel"
            )
