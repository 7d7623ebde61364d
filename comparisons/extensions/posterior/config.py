"""Settings of the draws of the posterior."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from comparisons.config import Configured, ExtensionConfig, RunConfig

if TYPE_CHECKING:
    from comparisons.extensions.posterior.extension import Posterior


class PosteriorConfig(ExtensionConfig):
    """Draws of the smoother's exact posterior, for short logs of point landmarks."""

    draws: int = Field(
        8000,
        ge=800,
        le=200_000,
        description="Draws of all 16 chains together; below 400 effective ones of any unknown the "
        "sampling is not converged, and judges nothing",
    )
    seed: int = Field(0, ge=0, description="Random seed of the draws")

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

    def build(self, config: Configured) -> Posterior:
        """Return the extension."""
        from comparisons.extensions.posterior.extension import Posterior

        return Posterior(self.draws, self.seed)
